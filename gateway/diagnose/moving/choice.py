"""Choice of a model of moving rows; the rows that validate it take no part in the choice."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_mistakes import MovingMistake, find_mistakes, undo
from gateway.diagnose.moving.moving_noise import MovingNoise
from gateway.diagnose.moving.null_model import null_model
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.select import select, without_idle
from gateway.diagnose.moving.splits import choosing
from gateway.diagnose.moving.state import MovingState, state_of, with_noise_of
from gateway.diagnose.moving.trust import choose_trust
from gateway.identify.knowledge import Knowledge
from gateway.identify.prior_loads import BARE_LABEL
from gateway.model.motion import MovingRows
from gateway.model.term import Label


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
