"""Diagnosis of moving runs: what the model lacks, judged on blocks of time or on a run that no fit has seen.

The noise floor of a moving run is unknown, so the best verdict is `improved`. Errors are those of rows in which the
axis moves (friction at a standstill is a set); how many those are stands in the provenance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.diagnose.moving.deflection import elastic_joints
from gateway.diagnose.moving.fit import MovingNoise, MovingProblem, blocks
from gateway.diagnose.moving.mistakes import MovingMistake, find_mistakes, undo
from gateway.diagnose.moving.outcome import MovingOutcome, result_of, too_little
from gateway.diagnose.moving.parameters import certain
from gateway.diagnose.moving.select import select, weigh
from gateway.diagnose.moving.state import MovingState, state_of, with_noise_of
from gateway.diagnose.moving.structure import structured_axes
from gateway.diagnose.moving.thresholds import MOVING
from gateway.diagnose.moving.trial import Trial
from gateway.diagnose.moving.trust import choose_trust
from gateway.diagnose.options import DiagnoseOptions
from gateway.errors import DataUnusable
from gateway.identify.links import has_inertials, parse_inertials
from gateway.identify.loads import BARE_LABEL, unknown_labels
from gateway.identify.moving_baseline import EXACT, baseline
from gateway.model.motion import MovingRows, prepare
from gateway.model.robot import Robot
from gateway.result.result import Result

Floats = NDArray[np.float64]


def diagnose_motion(table: Table, robot: Robot, options: DiagnoseOptions) -> Result:
    """Find what the model lacks on moving rows.

    Parameters
    ----------
    table : Table
        Rows that do not move are ignored.
    robot : Robot
    options : DiagnoseOptions

    Raises
    ------
    DataUnusable
        No axis moves while its torque is measured, or the hold-out has only loads nothing is known of.
    InputError
        A known load that is not in the data.
    ConfigError
        `inertials` is not understood.
    """
    motion = prepare(table, options.holdout, robot, np.asarray(options.gravity_m_s2))
    known = _known(motion, options.known)
    motion = _foretold(motion, known)
    trust, free = _trust(robot, options.inertials)
    allowed = options.allowed
    if "current_rms_peak" in options.only and "current_rms_peak" not in options.without:
        allowed |= {"torque_constant_scale"}
    problem = _problem(motion, trust, known)
    if (~motion.given).sum() < MOVING.fewest_rows or motion.duration_s < MOVING.shortest_s:
        return too_little(problem, state_of(problem, ()))
    mistakes = find_mistakes(problem, allowed)
    as_read = None
    if mistakes:
        as_read = state_of(problem, ())
        problem = _problem(undo(motion, mistakes), trust, known)
    problem, state, left = select(problem, allowed)
    if free and problem.base.trust is not None:
        chosen = choose_trust(problem, state.terms, known)
        if chosen != problem.base.trust:
            again = replace(problem, base=baseline(problem.motion, chosen, known))
            start = () if chosen is None else state.terms
            problem, state, left = select(with_noise_of(again, start, None), allowed, start)
    outcome = _outcome(problem, state, left, allowed, mistakes, as_read, known)
    wound = elastic_joints(problem, outcome.after) if "joint_elasticity" in allowed else ()
    if wound and as_read is None:
        stiff = replace(table, q2nd_rad=np.full_like(table.q2nd_rad, np.nan))
        held = options.holdout and replace(options.holdout, q2nd_rad=np.full_like(options.holdout.q2nd_rad, np.nan))
        by_motor = prepare(stiff, held, robot, np.asarray(options.gravity_m_s2))
        as_read = state_of(_problem(_foretold(by_motor, known), problem.base.trust, known), ())
    return result_of(replace(outcome, wound=wound, as_read=as_read))


def _outcome(  # noqa: PLR0913 - gathers what the stages left
    problem: MovingProblem,
    state: MovingState,
    left: list[Trial],
    allowed: frozenset[str],
    mistakes: list[MovingMistake],
    as_read: MovingState | None,
    known: Mapping[str, tuple[float, Floats]],
) -> MovingOutcome:
    chosen = weigh(problem, state, allowed)
    sure = tuple(item for item in chosen if not item.contested and certain(problem, state, item.terms))
    doubtful = tuple(item for item in chosen if item not in sure)
    if doubtful and sure:
        state = state_of(problem, [term for item in sure for term in item.terms])
    return MovingOutcome(
        problem=problem,
        before=state_of(problem, ()),
        after=state,
        effects=sure,
        doubtful=doubtful,
        rejected=tuple(left),
        mistakes=tuple(mistakes),
        as_read=as_read,
        structure=structured_axes(problem, state),
        known=known,
    )


def _foretold(motion: MovingRows, known: Mapping[str, tuple[float, Floats]]) -> MovingRows:
    """Hold-out rows under a load that is neither fitted nor known cannot be foretold: they are not judged."""
    seen = [BARE_LABEL, *known, *np.unique(motion.load[~motion.given])]
    strange = motion.given & ~np.isin(motion.load, seen)
    if not strange.any():
        return motion
    rest = motion.given & ~strange
    if not rest.any():
        raise DataUnusable(
            f"--holdout: load {motion.load[strange][0]} is not in the data that are fitted; give it with --known, or"
            " hold out rows under a load that is"
        )
    return replace(motion, judged=motion.judged & ~strange[:, None])


def _problem(motion: MovingRows, trust: float | None, known: Mapping[str, tuple[float, Floats]]) -> MovingProblem:
    problem = MovingProblem(
        motion, baseline(motion, trust, known), MovingNoise(*np.ones((2, motion.axes))), blocks(motion, MOVING.blocks)
    )
    return with_noise_of(problem, (), None)


def _known(
    motion: MovingRows, known: Mapping[str, tuple[float, float, float, float]]
) -> dict[str, tuple[float, Floats]]:
    unknown_labels(np.unique(motion.load), known)
    return {label: (float(values[0]), np.asarray(values[1:], dtype=float)) for label, values in known.items()}


def _trust(robot: Robot, inertials: str | None) -> tuple[float | None, bool]:
    """Trust of the CAD values to start with, and whether the data may change it."""
    if inertials == "ignore" or not has_inertials(robot):
        return None, False
    if inertials is None:
        return MOVING.first_trust, True
    return max(parse_inertials(inertials), EXACT), False
