"""Diagnosis of moving runs: effects are chosen with some rows and validated with rows that took no part.

The noise floor of a moving run is unknown unless its motion repeats; without repeats the best verdict is `improved`.
Errors are evaluated on rows in which the axis moves, because static friction has no unique value. The provenance states
the number of these rows. Joints with a secondary encoder show their elasticity by the wind-up, which is proportional to
the torque.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.diagnose.moving.choice import Choice, Judges, choose, plain_choice, problem_of
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_findings import MovingOutcome
from gateway.diagnose.moving.moving_mistakes import undo
from gateway.diagnose.moving.moving_outcome import answer_of, result_of, too_little
from gateway.diagnose.moving.moving_rows import judging, lags, prepare_in_step
from gateway.diagnose.moving.parameters import certain
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.select import left_over, structured_axes, weigh
from gateway.diagnose.moving.trial import MovingState, state_of
from gateway.diagnose.wind_up import design_of, elastic, wind_up
from gateway.errors import DataUnusable
from gateway.identify.knowledge import EXACT, Knowledge
from gateway.identify.links import has_inertials
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.spread import counting_share
from gateway.model.effects import BY_ODDS, LIBRARY
from gateway.model.motion import Mask, MovingRows
from gateway.model.robot import Robot
from gateway.model.term import Label
from gateway.result.result import EffectResult, Evidence, Result

Floats = NDArray[np.float64]


def diagnose_motion(
    table: Table,
    robot: Robot,
    knowledge: Knowledge,
    *,
    holdout: Table | None = None,
    only: frozenset[str] = frozenset(),
    without: frozenset[str] = frozenset(),
) -> Result:
    """Find the effects that the model lacks on moving rows.

    Parameters
    ----------
    table : Table
        Torque behind the gears; rows that do not move are ignored.
    robot : Robot
    knowledge : Knowledge
    holdout, only, without : as of `diagnose`

    Raises
    ------
    DataUnusable
        No axis moves while its torque is measured, or the hold-out rows have unknown loads only.
    InputError
        A known load that is not in the data.
    """
    delay_s, known = lags(table, robot, knowledge), knowledge.known
    gravity_m_s2 = np.asarray(knowledge.gravity_m_s2)
    motion = prepare_in_step(table, holdout, robot, gravity_m_s2, delay_s)
    motion = _predictable(motion, known)
    allowed = (only or frozenset(LIBRARY)) - without
    if "current_rms_peak" in only - without:
        allowed |= {"torque_constant_scale"}  # a factor between peak and rms current is found as a scale
    # the search allows for the usual changes of the torque readings, also of a warm arm
    trust, searched = _trust(robot, knowledge), replace(knowledge, change=1.0)
    if (~motion.held_out).sum() < MOVING.fewest_rows or motion.duration_s < MOVING.shortest_s:
        problem = problem_of(motion, trust, searched)
        answer = answer_of(table, robot, _knowledge_for_fit(robot, knowledge, MOVING.usual_trust), (), delay_s)
        return too_little(problem, state_of(problem, ()), answer)
    found, judges = _judged(motion, trust, searched, allowed)
    refuted = frozenset(item.label for item in found.mistakes if not judges.mistake(item).below_one)
    if refuted:
        found, judges = _judged(motion, trust, searched, allowed, refuted)
    outcome = replace(_outcome(found, judges, allowed, free=knowledge.link_std is None), refuted=refuted)
    if "joint_elasticity" not in allowed:
        return _written(outcome, table, robot, knowledge)
    wound = elastic_joints(outcome.problem, outcome.after, judges.pairs)
    if wound and not found.mistakes:
        stiff = replace(table, q2nd_rad=np.full_like(table.q2nd_rad, np.nan))
        held = holdout and replace(holdout, q2nd_rad=np.full_like(holdout.q2nd_rad, np.nan))
        by_motor = _predictable(prepare_in_step(stiff, held, robot, gravity_m_s2, delay_s), known)
        as_read = problem_of(by_motor, outcome.problem.null.trust, searched)
        parts = judging(by_motor, MOVING.judged_blocks)
        read = Judges(tuple(plain_choice(part, outcome.problem.null.trust, searched) for part in parts))
        outcome = replace(outcome, as_read=state_of(as_read, ()), held_before=read.before())
    return _written(replace(outcome, wound=wound), table, robot, knowledge)


def _written(outcome: MovingOutcome, table: Table, robot: Robot, stated: Knowledge) -> Result:
    """Build the result, with loads from an estimate without effects and from one with the named effects."""
    problem, state = outcome.reported
    sound = undo(table, [mistake for mistake, _ in outcome.mistakes])
    knowledge, delay_s = _knowledge_for_fit(robot, stated, problem.null.trust), problem.motion.delay_s
    plain = answer_of(sound, robot, knowledge, (), delay_s)
    return result_of(outcome, plain, answer_of(sound, robot, knowledge, state.terms, delay_s) if state.terms else plain)


def _knowledge_for_fit(robot: Robot, stated: Knowledge, trust: float | None) -> Knowledge:
    """Knowledge for a fit: CAD uncertainty as stated, else as chosen from the rows."""
    if trust == MOVING.usual_trust or not has_inertials(robot):
        return stated.of_robot(robot)
    return replace(stated, link_std=np.inf if trust is None else trust) if stated.link_std is None else stated


def _judged(
    motion: MovingRows,
    trust: float | None,
    knowledge: Knowledge,
    allowed: frozenset[str],
    refuted: frozenset[Label] = frozenset(),
) -> tuple[Choice, Judges]:
    """Return the model chosen from all fitted rows, and the choices that the held-out rows validate."""
    found = choose(motion, trust, knowledge, allowed, refuted)
    if motion.held_out.any():
        return found, Judges((found,))
    near, parts = found.problem.null.trust, judging(motion, MOVING.judged_blocks)
    return found, Judges(tuple(choose(part, near, knowledge, allowed, refuted) for part in parts))


def _outcome(found: Choice, judges: Judges, allowed: frozenset[str], *, free: bool) -> MovingOutcome:
    """Divide the effects into those that odds and held-out rows confirm, and others.

    `free` is True if the rows may choose the standard deviation of the links.
    """
    problem, state = found.problem, found.state
    chosen = [
        replace(item, held=judges.effect(item.label, item.axes(problem.motion.axes), problem.noise.sigma_nm))
        for item in weigh(problem, state, allowed)
    ]
    below = {item.label for item in chosen if item.held.below_one or item.label[0] in BY_ODDS}
    refuted = tuple(item for item in chosen if item.label not in below or (item.contested and not item.rival))
    open_ones = [item for item in chosen if item not in refuted]
    accepted = tuple(item for item in open_ones if not item.contested and certain(problem, state, item.terms))
    doubtful = tuple(item for item in open_ones if item not in accepted)
    if len(accepted) < len(chosen) and (accepted or refuted):
        state = state_of(problem, [term for item in accepted for term in item.terms])
    kept = {term.label for term in state.terms}
    rejected = left_over(problem, state, allowed)
    if problem.motion.held_out.any():
        judges = Judges((replace(found, state=state),))
    as_read = state_of(found.as_read, ()) if found.mistakes else None
    return MovingOutcome(
        reported=_reported_model(problem, state) if free else (problem, state),
        problem=problem,
        before=state_of(problem, ()),
        after=state,
        effects=accepted,
        doubtful=doubtful,
        unproven=refuted,
        rejected=tuple(zip((term.label for term in rejected), judges.ratios(rejected), strict=True)),
        mistakes=tuple((item, judges.mistake(item)) for item in found.mistakes),
        as_read=as_read,
        structure=structured_axes(problem, state),
        held_before=judges.before(),
        held_after=judges.after(kept),
        judges=judges,
    )


def _reported_model(problem: MovingProblem, state: MovingState) -> tuple[MovingProblem, MovingState]:
    """Return the model for the reported values, with the usual CAD uncertainty if the rows do not contradict it."""
    trust = problem.null.trust
    if trust is None or trust >= MOVING.usual_trust:
        return problem, state
    usual = replace(problem, null=problem.null.trusting(MOVING.usual_trust))
    return usual, state_of(usual, state.terms)


def _predictable(motion: MovingRows, known: Collection[str]) -> MovingRows:
    """Exclude hold-out rows whose load is neither fitted nor known: they cannot be predicted."""
    seen = [BARE_LABEL, *known, *np.unique(motion.load[~motion.held_out])]
    strange = motion.held_out & ~np.isin(motion.load, seen)
    if not strange.any():
        return motion
    rest = motion.held_out & ~strange
    if not rest.any():
        raise DataUnusable(
            f"--holdout: load {motion.load[strange][0]} is not in the fitted data; state it with --known, or"
            " hold out rows under a fitted load"
        )
    return replace(motion, judged=motion.judged & ~strange[:, None])


def _trust(robot: Robot, knowledge: Knowledge) -> float | None:
    """Initial relative standard deviation of the CAD values, None = CAD values unknown."""
    if np.isinf(knowledge.trust) or not has_inertials(robot):
        return None
    return MOVING.first_trust if knowledge.link_std is None else max(knowledge.link_std, EXACT)


def elastic_joints(
    problem: MovingProblem, state: MovingState, pairs: Sequence[tuple[Mask, Mask]]
) -> tuple[EffectResult, ...]:
    """Report elastic joints among those with a secondary encoder.

    The wind-up is regressed on the modelled torque of the links, with a constant for the zeros of the two encoders. A
    joint is reported if the slope is significant and predicts the wind-up of rows that were not in its fit; `pairs` are
    fitted and held-out rows.
    """
    motion = problem.motion
    found = []
    for axis in range(motion.axes):
        bend, torque = motion.wind_up_rad[:, axis], state.full.modelled.rigid_nm[:, axis]
        if not np.isfinite(bend).all() or not motion.measured[axis]:
            continue
        fitted = ~motion.held_out
        compliance, std, p_value = wind_up(torque[fitted], bend[fitted], counting_share, motion.axes)
        # Ratio of the held-out RMS of the wind-up with the torque to that without it
        design = design_of(torque)
        squares = np.zeros(2)
        for train, test in pairs:
            for place, columns in enumerate((design, design[:, 1:])):
                value, *_ = np.linalg.lstsq(columns[train], bend[train], rcond=None)
                squares[place] += float(((bend - columns @ value)[test] ** 2).sum())
        ratio = float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 1.0
        bent = compliance * float(np.abs(torque).max())
        if compliance < MOVING.wind_up * std or ratio > MOVING.wind_up_ratio or bent > MOVING.largest_wind_up_rad:
            continue
        found.append(elastic(axis, compliance, std, Evidence(holdout_rms_ratio=ratio, p_value=p_value)))
    return tuple(found)
