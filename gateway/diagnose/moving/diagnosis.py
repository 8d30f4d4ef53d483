"""Diagnosis of moving runs: effects are chosen with some rows and validated with rows that took no part.

The noise floor of a moving run is unknown unless its motion repeats; without repeats the best verdict is `improved`.
Errors are evaluated on rows in which the axis moves, because static friction has no unique value. The provenance states
the number of these rows.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.diagnose.moving.choice import Choice, MovingKnowledge, choose, plain_choice, problem_of
from gateway.diagnose.moving.deflection import elastic_joints
from gateway.diagnose.moving.judge import Judges
from gateway.diagnose.moving.lag import lags, prepare_in_step
from gateway.diagnose.moving.moving_answer import answer_of
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_findings import MovingOutcome
from gateway.diagnose.moving.moving_mistakes import undo
from gateway.diagnose.moving.moving_outcome import result_of, too_little
from gateway.diagnose.moving.parameters import certain
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.residual_motion_dependence import structured_axes
from gateway.diagnose.moving.select import left_over, weigh
from gateway.diagnose.moving.splits import judging
from gateway.diagnose.moving.state import MovingState, state_of
from gateway.diagnose.options import DiagnoseOptions
from gateway.errors import DataUnusable
from gateway.identify.links import default_inertials, has_inertials, parse_inertials
from gateway.identify.prior_loads import BARE_LABEL, unknown_labels
from gateway.identify.rest.problem import EXACT, Knowledge
from gateway.model.motion import MovingRows
from gateway.model.robot import Robot
from gateway.result.result import Result

Floats = NDArray[np.float64]


def diagnose_motion(table: Table, robot: Robot, options: DiagnoseOptions) -> Result:
    """Find the effects that the model lacks on moving rows.

    Parameters
    ----------
    table : Table
        Rows that do not move are ignored.
    robot : Robot
    options : DiagnoseOptions

    Raises
    ------
    DataUnusable
        No axis moves while its torque is measured, or the hold-out rows have unknown loads only.
    InputError
        A known load that is not in the data.
    ConfigError
        `inertials` is not understood.
    """
    delay_s = lags(table, robot, options)
    gravity_m_s2 = np.asarray(options.gravity_m_s2)
    motion = prepare_in_step(table, options.holdout, robot, gravity_m_s2, delay_s)
    unknown_labels(np.unique(motion.load), options.known)
    motion = _predictable(motion, options.known)
    trust, free = _trust(robot, options.inertials)
    stated = Knowledge(known=options.known, gravity_m_s2=options.gravity_m_s2, gain_std=options.gain_std)
    knowledge = MovingKnowledge(_allowed(options), trust, free, stated)
    if (~motion.held_out).sum() < MOVING.fewest_rows or motion.duration_s < MOVING.shortest_s:
        problem = problem_of(motion, trust, knowledge)
        answer = answer_of(table, robot, _knowledge_for_fit(robot, options, MOVING.usual_trust), (), delay_s)
        return too_little(problem, state_of(problem, ()), answer)
    found, judges = _judged(motion, knowledge)
    refuted = frozenset(item.label for item in found.mistakes if not judges.mistake(item).below_one)
    if refuted:
        found, judges = _judged(motion, replace(knowledge, refuted=refuted))
    outcome = replace(_outcome(found, judges, knowledge), refuted=refuted)
    if "joint_elasticity" not in knowledge.allowed:
        return _written(outcome, table, robot, options)
    wound = elastic_joints(outcome.problem, outcome.after, judges.pairs)
    if wound and not found.mistakes:
        stiff = replace(table, q2nd_rad=np.full_like(table.q2nd_rad, np.nan))
        held = options.holdout and replace(options.holdout, q2nd_rad=np.full_like(options.holdout.q2nd_rad, np.nan))
        by_motor = _predictable(prepare_in_step(stiff, held, robot, gravity_m_s2, delay_s), options.known)
        as_read = problem_of(by_motor, outcome.problem.null.trust, knowledge)
        parts = judging(by_motor, MOVING.judged_blocks)
        read = Judges(tuple(plain_choice(part, outcome.problem.null.trust, knowledge) for part in parts))
        outcome = replace(outcome, as_read=state_of(as_read, ()), held_before=read.before())
    return _written(replace(outcome, wound=wound), table, robot, options)


def _written(outcome: MovingOutcome, table: Table, robot: Robot, options: DiagnoseOptions) -> Result:
    """Build the result, with loads from an estimate without effects and from one with the named effects."""
    problem, state = outcome.reported
    sound = undo(table, [mistake for mistake, _ in outcome.mistakes])
    knowledge, delay_s = _knowledge_for_fit(robot, options, problem.null.trust), problem.motion.delay_s
    plain = answer_of(sound, robot, knowledge, (), delay_s)
    return result_of(outcome, plain, answer_of(sound, robot, knowledge, state.terms, delay_s) if state.terms else plain)


def _knowledge_for_fit(robot: Robot, options: DiagnoseOptions, trust: float | None) -> Knowledge:
    """Knowledge for a fit: CAD uncertainty from the options, else as chosen from the rows."""
    inertials = options.inertials
    if inertials is None:
        usual = trust == MOVING.usual_trust or not has_inertials(robot)
        inertials = default_inertials(robot) if usual else "ignore" if trust is None else f"prior:{trust:g}"
    return Knowledge(
        inertials,
        options.known,
        gravity_m_s2=options.gravity_m_s2,
        gain_std=options.gain_std,
        change=options.change,
    )


def _judged(motion: MovingRows, knowledge: MovingKnowledge) -> tuple[Choice, Judges]:
    """Return the model chosen from all fitted rows, and the choices that the held-out rows validate."""
    found = choose(motion, knowledge)
    if motion.held_out.any():
        return found, Judges((found,))
    near = replace(knowledge, trust=found.problem.null.trust) if knowledge.free else knowledge
    return found, Judges(tuple(choose(part, near) for part in judging(motion, MOVING.judged_blocks)))


def _outcome(found: Choice, judges: Judges, knowledge: MovingKnowledge) -> MovingOutcome:
    """Divide the effects into those that odds and held-out rows confirm, and others."""
    problem, state = found.problem, found.state
    chosen = [
        replace(item, held=judges.effect(item.label, item.axes(problem.motion.axes), problem.noise.sigma_nm))
        for item in weigh(problem, state, knowledge.allowed)
    ]
    refuted = tuple(item for item in chosen if not item.held.below_one or (item.contested and not item.rival))
    open_ones = [item for item in chosen if item not in refuted]
    accepted = tuple(item for item in open_ones if not item.contested and certain(problem, state, item.terms))
    doubtful = tuple(item for item in open_ones if item not in accepted)
    if len(accepted) < len(chosen) and (accepted or refuted):
        state = state_of(problem, [term for item in accepted for term in item.terms])
    kept = {term.label for term in state.terms}
    rejected = left_over(problem, state, knowledge.allowed)
    if problem.motion.held_out.any():
        judges = Judges((replace(found, state=state),))
    as_read = state_of(found.as_read, ()) if found.mistakes else None
    return MovingOutcome(
        reported=_reported_model(problem, state, knowledge),
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


def _reported_model(
    problem: MovingProblem, state: MovingState, knowledge: MovingKnowledge
) -> tuple[MovingProblem, MovingState]:
    """Return the model for the reported values, with the usual CAD uncertainty if the rows do not contradict it."""
    trust = problem.null.trust
    if not knowledge.free or trust is None or trust >= MOVING.usual_trust:
        return problem, state
    usual = replace(problem, null=problem.null.trusting(MOVING.usual_trust))
    return usual, state_of(usual, state.terms)


def _allowed(options: DiagnoseOptions) -> frozenset[str]:
    """Names of effects to try; a factor between peak and rms current is found as a scale."""
    peak = "current_rms_peak" in options.only and "current_rms_peak" not in options.without
    return options.allowed | {"torque_constant_scale"} if peak else options.allowed


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


def _trust(robot: Robot, inertials: str | None) -> tuple[float | None, bool]:
    """Initial relative standard deviation of the CAD values, and True if the data may change it."""
    if inertials == "ignore" or not has_inertials(robot):
        return None, False
    if inertials is None:
        return MOVING.first_trust, True
    return max(parse_inertials(inertials), EXACT), False
