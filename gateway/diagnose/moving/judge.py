"""Validation of a chosen model on rows that took no part in the choice.

User-given hold-out rows validate the model chosen without them. Without such rows, outer blocks of time are held out in
turn, each validating a model chosen without it. An effect of the final model then counts to the extent that the block's
own choice contains it. Held-out rows can only reject: they choose no effect, shape or parameter.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.moving.choice import Choice
from gateway.diagnose.moving.moving_mistakes import MovingMistake, undo
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit
from gateway.diagnose.moving.ratio import HeldRatio, held_ratio
from gateway.diagnose.moving.trial import trials_of
from gateway.model.term import Label, Term

Floats = NDArray[np.float64]


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
