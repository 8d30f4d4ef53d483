"""Choice of a model of moving rows, and its validation on rows that took no part in the choice.

User-given hold-out rows validate the model chosen without them. Without such rows, outer blocks of time are held out in
turn, each validating a model chosen without it. An effect of the final model then counts to the extent that the block's
own choice contains it. Held-out rows can only reject: they choose no effect, shape or parameter.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held, HeldRatio, held_ratio
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_mistakes import MovingMistake, find_mistakes, undo
from gateway.diagnose.moving.moving_rows import choosing
from gateway.diagnose.moving.null_model import MovingNoise, null_model
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit, prior_of
from gateway.diagnose.moving.select import select, without_idle
from gateway.diagnose.moving.trial import MovingState, state_of, trials_of, with_noise_of
from gateway.identify.knowledge import Knowledge
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.spread import counting_share
from gateway.model.effects import DRAWN
from gateway.model.motion import MovingRows
from gateway.model.term import Label, Term

Floats = NDArray[np.float64]

#: Relative errors of a drawing [-] that are weighed: a factor of two apart, from weighed links to none at all.
LEVELS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
#: Precision that stands for no opinion on an effect's parameter.
WIDE = 1e-8


def log_evidence(problem: MovingProblem, terms: Sequence[Term]) -> float:
    """Log marginal likelihood of the fitted rows, up to a constant common to all models."""
    everything = ~problem.motion.held_out
    solved = fit(problem, terms, everything, problem.motion.held_out)
    prior = problem.null.columns.prior.beside(prior_of(terms)).precision
    return 0.5 * (_log_det(prior + WIDE * np.eye(len(prior))) + _log_det(solved.inverse) - solved.cost)


def _log_det(matrix: Floats) -> float:
    """Log determinant of a matrix whose rows differ much in size."""
    size = np.sqrt(np.diag(matrix))
    return float(np.linalg.slogdet(matrix / size / size[:, None])[1] + 2.0 * np.log(size).sum())


def choose_trust(problem: MovingProblem, terms: Sequence[Term]) -> float | None:
    """Choose the relative standard deviation of the CAD values; None = CAD values are not usable."""
    # The problem with the noise scale and correlation of the model with the effects
    motion = problem.motion
    everything = ~motion.held_out
    left = fit(problem, terms, everything, motion.held_out).residual_nm
    sigma, share = problem.noise.sigma_nm.copy(), problem.noise.share.copy()
    for axis in np.flatnonzero(motion.measured):
        rest = left[motion.judged[:, axis] & everything, axis]
        if len(rest):
            sigma[axis] = max(sigma[axis], float(np.sqrt(np.mean(rest**2))))
            share[axis] = min(share[axis], counting_share(rest))
    problem = replace(problem, noise=MovingNoise(sigma, share))
    explanations = [list(terms)]
    without = [term for term in terms if term.name not in DRAWN]
    if len(without) < len(terms):
        explanations.append(without)
    scores = np.array([[_score(problem, explanation, level) for level in LEVELS] for explanation in explanations])
    best = scores[int(np.argmax(scores.max(axis=1)))]
    level = LEVELS[int(np.argmax(best >= best.max() - MOVING.contradicted))]
    return None if level >= MOVING.worthless else level


def _score(problem: MovingProblem, terms: Sequence[Term], level: float) -> float:
    worse = np.log(max(level / MOVING.usual_trust, 1.0)) / np.log(MOVING.usual_factor)
    trusting = replace(problem, null=problem.null.trusting(level))
    return log_evidence(trusting, terms) - 0.5 * float(worse) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Chosen model: the problem with its noise, the fits, the corrected mistakes, and the uncorrected rows."""

    problem: MovingProblem
    state: MovingState
    mistakes: tuple[MovingMistake, ...]
    as_read: MovingProblem


def problem_of(motion: MovingRows, trust: float | None, knowledge: Knowledge) -> MovingProblem:
    """Build the problem of rows without effects, for a relative standard deviation of the CAD values."""
    splits = choosing(motion, MOVING.blocks, frozenset(knowledge.known) | {BARE_LABEL})
    null = null_model(motion, trust, knowledge)
    return with_noise_of(MovingProblem(motion, null, MovingNoise(*np.ones((2, motion.axes))), splits), (), None)


def choose(
    motion: MovingRows,
    trust: float | None,
    knowledge: Knowledge,
    allowed: frozenset[str],
    refuted: frozenset[Label] = frozenset(),
) -> Choice:
    """Choose mistakes, CAD uncertainty and effects from all rows except the held-out ones.

    Parameters
    ----------
    motion : MovingRows
    trust : float or None
        Initial relative standard deviation of the CAD values, None = CAD values unknown.
    knowledge : Knowledge
        Gravity, known loads and torque constants. The rows may change `trust` if no standard deviation is stated.
    allowed : names of effects that may be tried
    refuted : mistakes that the held-out rows do not confirm
    """
    problem = as_read = problem_of(motion, trust, knowledge)
    mistakes = find_mistakes(problem, allowed, refuted)
    if mistakes:
        problem = problem_of(undo(motion, mistakes), trust, knowledge)
    problem, state = select(problem, allowed)
    if knowledge.link_std is None and trust is not None:
        chosen = choose_trust(problem, state.terms)
        if chosen != trust:
            problem, state = _under(chosen, problem, state, knowledge, allowed)
    return Choice(problem, state, tuple(mistakes), as_read)


def plain_choice(motion: MovingRows, trust: float | None, knowledge: Knowledge) -> Choice:
    """Return the choice without effects."""
    problem = problem_of(motion, trust, knowledge)
    return Choice(problem, state_of(problem, ()), (), problem)


def _under(
    trust: float | None, problem: MovingProblem, state: MovingState, knowledge: Knowledge, allowed: frozenset[str]
) -> tuple[MovingProblem, MovingState]:
    """Repeat the choice with another CAD uncertainty: drop unneeded effects; all are open if the links are unknown."""
    if trust is None:
        null = null_model(problem.motion, None, knowledge)
        return select(with_noise_of(replace(problem, null=null), (), None), allowed)
    problem = replace(problem, null=problem.null.trusting(trust))
    problem = with_noise_of(problem, state.terms, state.full)
    return problem, without_idle(problem, state_of(problem, state.terms))


@dataclass(frozen=True, slots=True, eq=False)
class Judges:
    """Choices with the rows that validate them: one for user-given rows, else one per outer block."""

    choices: tuple[Choice, ...]

    @property
    def pairs(self) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
        """(fitted, held-out) rows of each choice."""
        motions = [choice.problem.motion for choice in self.choices]
        return [(~motion.held_out & motion.judged.any(axis=1), motion.held_out) for motion in motions]

    def before(self) -> Held:
        """Held-out residuals of the model without effects, with uncorrected mistakes."""
        return _joined([(choice.as_read, _residual(choice.as_read, ())) for choice in self.choices])

    def plain(self) -> Held:
        """Held-out residuals of the model without effects, with corrected mistakes."""
        return _joined([(choice.problem, _residual(choice.problem, ())) for choice in self.choices])

    def after(self, labels: Collection[Label]) -> Held:
        """Held-out residuals of the choices, with those of their effects that have these labels."""
        parts = []
        for choice in self.choices:
            kept = [term for term in choice.state.terms if term.label in labels]
            same = len(kept) == len(choice.state.terms)
            left = choice.state.full.residual_nm if same else _residual(choice.problem, kept)
            parts.append((choice.problem, left))
        return _joined(parts)

    def effect(
        self, label: Label, axes: Sequence[int], sigma_nm: Floats, instead: Sequence[Term] | None = None
    ) -> HeldRatio:
        """Held-out RMS ratio with one effect, or others `instead`, to that without it."""
        with_it, without = [], []
        for choice in self.choices:
            problem, complete = choice.problem, choice.state.full.residual_nm
            rest = [term for term in choice.state.terms if term.label != label]
            left = _residual(problem, rest) if len(rest) < len(choice.state.terms) else complete
            with_it.append((problem, complete if instead is None else _residual(problem, [*rest, *instead])))
            without.append((problem, left))
        return held_ratio(_joined(without), _joined(with_it), axes, sigma_nm)

    def ratios(self, terms: Sequence[Term]) -> list[float]:
        """Held-out RMS ratio of each effect that no choice contains; NaN where it cannot be determined."""
        squares = np.zeros((len(terms), 2))
        for choice in self.choices:
            problem, full = choice.problem, choice.state.full
            trials = trials_of(problem, [full], full, terms)
            before = _joined([(problem, full.residual_nm)])
            for place, (term, trial) in enumerate(zip(terms, trials, strict=True)):
                own = list(term.enters(problem.motion.axes))
                for side, held in enumerate((before, before if trial is None else trial.held)):
                    squares[place, side] += (held.square / problem.noise.sigma_nm**2)[own].sum()
        return [float(np.sqrt(now / was)) if was > 0 else 1.0 for was, now in squares]

    def mistake(self, mistake: MovingMistake) -> HeldRatio:
        """Residual ratio of the torque with one mistake corrected to that without the correction."""
        as_read, undone = [], []
        for choice in self.choices:
            others = [other for other in choice.mistakes if other.label != mistake.label]
            read = replace(choice.as_read, motion=undo(choice.as_read.motion, others))
            complete = choice.problem if len(others) < len(choice.mistakes) else read
            as_read.append((read, _share_left(read)))
            undone.append((complete, _share_left(complete)))
        first = self.choices[0].problem.motion
        axes = mistake.axes if len(mistake.joints) > 1 else range(first.axes)
        return held_ratio(_joined(as_read), _joined(undone), axes, np.ones(first.axes))


def _residual(problem: MovingProblem, terms: Sequence[Term]) -> Floats:
    motion = problem.motion
    return fit(problem, terms, ~motion.held_out, motion.held_out).residual_nm


def _share_left(problem: MovingProblem) -> Floats:
    """Residual (n, N) over the RMS torque of its axis."""
    motion = problem.motion
    size = np.sqrt((motion.tau_nm**2 * motion.judged).sum(axis=0) / np.maximum(motion.judged.sum(axis=0), 1))
    return _residual(problem, ()) / np.where(size > 0, size, 1.0)


def _joined(parts: Sequence[tuple[MovingProblem, Floats]]) -> Held:
    """Join the residuals of the held-out rows, each from its own choice."""
    first = parts[0][0].motion
    residual, counted = np.zeros_like(first.tau_nm), np.zeros_like(first.judged)
    for problem, left in parts:
        rows = problem.motion.held_out
        counted[rows] = problem.motion.judged[rows]
        residual[rows] = left[rows]
    return Held(residual * counted, counted)
