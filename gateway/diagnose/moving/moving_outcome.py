"""Result file of a diagnosis of moving runs, with the loads that `estimate` reports and plot data.

The noise floor is the difference between two periods of the same motion. Without repeats it is unknown, and the best
verdict is `improved`. The points of a plot are measured torque minus the model without the effect, other parameters as
fitted. The curve is the effect; its confidence band follows from the covariance of its coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gateway.cell.quantities import inertials_text
from gateway.data.table import Table
from gateway.diagnose.held_out_residuals import Held, held_ratio
from gateway.diagnose.moving.moving_findings import (
    MovingOutcome,
    above_floor,
    does_not_carry,
    edge_findings,
    faults,
    floor_known,
    remarks,
    richer,
    rms_of,
    separating_run,
)
from gateway.diagnose.moving.moving_rows import prepare_in_step
from gateway.diagnose.moving.parameters import figures_of, parameters_of
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.select import Chosen
from gateway.diagnose.moving.trial import MovingState, spread_of
from gateway.errors import DataUnusable
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import load_result, refused_findings, refused_load
from gateway.identify.motion.columns import Effects, MovingSetup
from gateway.identify.motion.moving_fit import fit_motion
from gateway.identify.motion.moving_results import loads_of, nuisances
from gateway.identify.prior_loads import unknown_labels
from gateway.model.effect import Over
from gateway.model.effects import LIBRARY
from gateway.model.effects.velocity_friction import Stribeck
from gateway.model.robot import Robot
from gateway.model.term import Term
from gateway.result.data_roles import CHOSEN_ON, HELD_ROLE, VALIDATION
from gateway.result.drawn import Curve, Drawn
from gateway.result.result import (
    EffectResult,
    Evidence,
    Finding,
    FitSummary,
    LoadResult,
    NextMeasurement,
    NuisanceResult,
    Rejected,
    Result,
    Rows,
    Verdict,
)
from gateway.result.values import matrix, numbers

Floats = NDArray[np.float64]

#: Rows [-] that a result keeps for its pictures: some hundred kilobytes.
ROWS_KEPT = 600
#: Meaning of the held-out rows by their kind.
HELD_OUT = {
    "given": "rows given by the user, not used to choose the model",
    "blocks": "blocks of time of the same runs, each validating a model chosen without it; no evidence for another run",
    "phases": "parts of the period, held out of every period, each validating a model chosen without it",
}
#: Points of a drawn cloud [-]: more hide each other at the width of a page.
MOST_POINTS = 300


@dataclass(frozen=True, slots=True)
class MovingAnswer:
    """Loads and nuisance parameters as the result file has them."""

    loads: tuple[LoadResult, ...]
    nuisance: Mapping[str, NuisanceResult]
    findings: tuple[Finding, ...] = ()


def answer_of(table: Table, robot: Robot, knowledge: Knowledge, terms: Sequence[Term], delay_s: Floats) -> MovingAnswer:
    """Fit the moving rows of a table with the effects `terms` and torque delays `delay_s` (N,).

    If the table cannot be fitted, every load is refused with the reason.
    """
    moving = table.take(table.moving)
    knowledge, effects = knowledge.of_loads(moving.load), None
    if terms:
        gravity_m_s2 = np.asarray(knowledge.gravity_m_s2)
        rows_of = partial(
            prepare_in_step, holdout=None, robot=robot, gravity_m_s2=gravity_m_s2, delay_s=delay_s, largest=np.inf
        )
        effects = Effects(tuple(terms), rows_of)
    try:
        found = fit_motion(moving, robot, knowledge, MovingSetup(), effects=effects)
    except DataUnusable as error:
        labels = unknown_labels(moving.load, knowledge.known)
        return MovingAnswer(tuple(load_result(refused_load(label, str(error)), robot) for label in labels), {})
    usual = {} if found.fit is None else nuisances(found.fit)
    return MovingAnswer(tuple(load_result(load, robot) for load in loads_of(found, robot)), usual, found.findings)


def result_of(outcome: MovingOutcome, plain: MovingAnswer, answer: MovingAnswer) -> Result:
    """Build the result of a finished diagnosis, with residuals and loads without and with the effects."""
    problem, after, motion = outcome.problem, outcome.after, outcome.problem.motion
    kept = np.arange(0, len(motion), max(1, int(np.ceil(len(motion) / ROWS_KEPT))))
    unknown = np.full((len(kept), motion.axes), np.nan)
    effects = (
        *(
            EffectResult(item.name, item.joints, evidence=Evidence(holdout_rms_ratio=ratio.value))
            for item, ratio in outcome.mistakes
        ),
        *outcome.wound,
        *(_effect(*outcome.reported, item, _tried(outcome)) for item in outcome.effects),
    )
    contradicted = any(finding.severity == "fail" for finding in answer.findings)
    effects, doubtful = ((), ()) if contradicted else (effects, outcome.doubtful)
    undecided = bool(doubtful) and not effects
    if undecided:
        effects = tuple(part for item in doubtful for part in _rivals(outcome, item))
    drawn = [item.terms for item in outcome.effects]
    before = outcome.as_read if outcome.as_read is not None else outcome.before
    return Result(
        robot=problem.motion.robot.name,
        loads=answer.loads,
        verdict="unexplained" if contradicted else _verdict(outcome, undecided, bool(effects)),
        effects=effects,
        before=_summary(before, outcome.held_before, plain),
        after=_summary(after, outcome.held_after, answer),
        holdout_kind="given" if problem.motion.held_out.any() else "blocks",
        noise_floor_nm=numbers(problem.motion.floor_nm),
        friction_band_nm=numbers(_friction_level(problem, after)),
        rejected=_rejected(outcome),
        next=(*(separating_run(item) for item in doubtful), *richer(outcome, bool(effects))),
        findings=(
            *answer.findings,
            *faults(() if undecided else effects),
            *remarks(outcome),
            *edge_findings(effects),
            *refused_findings(answer.loads),
        ),
        nuisance=answer.nuisance,
        provenance=_provenance(problem, outcome),
        quality={"holdout_ratio": _axis_ratios(outcome)},
        rows=Rows.of(
            run=motion.run[kept].astype(str),
            load=motion.load[kept].astype(str),
            pose=np.full(len(kept), -1),
            time_s=motion.time_s[kept],
            q_rad=motion.q_rad[kept],
            direction=np.sign(motion.sign[kept].round(6)).astype(int),
            tau_nm=np.where(motion.measured, motion.tau_nm, np.nan)[kept],
            model_nm=(motion.tau_nm - after.full.residual_nm)[kept],
            band_nm=unknown,
            std_nm=unknown,
        ),
        data=pictures(problem, outcome.before, after, drawn, kept),
    )


def too_little(problem: MovingProblem, state: MovingState, answer: MovingAnswer) -> Result:
    """Build the result for a run that is too short to hold out any rows."""
    unknown = (np.nan,) * problem.motion.axes
    summary = FitSummary(rms_nm=numbers(rms_of(state)), holdout_rms_nm=unknown, loads=answer.loads)
    step = NextMeasurement("a moving run of at least 10 s in which every axis changes its direction several times")
    what = f"{int((~problem.motion.held_out).sum())} moving rows over {problem.motion.duration_s:.1f} s"
    return Result(
        robot=problem.motion.robot.name,
        loads=answer.loads,
        verdict="undecided",
        before=summary,
        after=summary,
        noise_floor_nm=unknown,
        friction_band_nm=unknown,
        holdout_kind="blocks",
        next=(step,),
        findings=(
            *answer.findings,
            Finding("warn", "data", f"{what} are too few to hold out any of them", "record a longer run"),
        ),
    )


def _summary(state: MovingState, held: Held, answer: MovingAnswer) -> FitSummary:
    return FitSummary(numbers(rms_of(state)), numbers(held.rms_nm), answer.loads)


def _effect(problem: MovingProblem, state: MovingState, item: Chosen, tried: int) -> EffectResult:
    """Entry of an effect; `p_value` is corrected for all tried candidates (Bonferroni)."""
    name, parameters, std = parameters_of(problem, state, item.terms)
    runner = item.runner_up
    evidence = Evidence(
        holdout_rms_ratio=item.held.value,
        p_value=min(1.0, max(item.trial.p_demand * tried, 1e-300)),
        runner_up=runner.term.name if runner is not None else None,
        odds=item.odds,
    )
    return EffectResult(name, item.terms[0].joints, parameters, std, evidence)


def _tried(outcome: MovingOutcome) -> int:
    return len(outcome.rejected) + len(outcome.effects) + len(outcome.doubtful) + len(outcome.unproven)


def _rivals(outcome: MovingOutcome, item: Chosen) -> list[EffectResult]:
    """Entries of both effects that explain the same rows."""
    problem = outcome.problem
    found = [_effect(*outcome.reported, item, _tried(outcome))]
    rival = item.runner_up
    if rival is not None:
        values, std = figures_of(rival)
        axes = list(rival.term.enters(problem.motion.axes))
        held = outcome.judges.effect(item.label, axes, problem.noise.sigma_nm, [rival.term])
        evidence = Evidence(held.value, max(rival.p_demand, 1e-300), item.terms[0].name, 1.0 / item.odds)
        found.append(EffectResult(rival.term.name, rival.term.joints, values, std, evidence))
    return found


def _verdict(outcome: MovingOutcome, undecided: bool, any_effect: bool) -> Verdict:
    if undecided:
        return "undecided"
    # a shape without a cause that is smaller than the noise is reported, and changes no verdict
    left = bool(above_floor(outcome)) if floor_known(outcome) else bool(outcome.structure)
    if any_effect:
        return "explained" if floor_known(outcome) and not left else "improved"
    if left:
        return "unexplained"
    return "undecided" if does_not_carry(outcome) else "none_needed"


def _rejected(outcome: MovingOutcome) -> tuple[Rejected, ...]:
    found = dict(outcome.rejected) | {item.label: item.held.value for item in outcome.unproven}
    if outcome.effects:
        found |= {item.label: item.held.value for item in outcome.doubtful}
    for item in outcome.effects:
        found.pop(item.label, None)
    order = sorted(found, key=lambda label: found[label])
    return tuple(Rejected(*label, found[label]) for label in order)


def _provenance(problem: MovingProblem, outcome: MovingOutcome) -> dict[str, object]:
    motion, trust = problem.motion, problem.null.trust
    # a held-out block of time is a part of a period, or of a run
    blocks = "phases" if np.isfinite(motion.floor_nm).any() else "blocks"
    return {
        "kind": "moving",
        "rows": len(motion),
        "delay_s": numbers(motion.delay_s),
        "rows_judged": [int(x) for x in motion.judged.sum(axis=0)],
        "holdout_blocks": len(outcome.judges.choices),
        "held_out": HELD_OUT["given" if motion.held_out.any() else blocks],
        "inertials": inertials_text(np.inf if trust is None else trust),
        "rows_that_count": numbers(problem.noise.share * motion.judged.sum(axis=0)),
        "candidates_tried": _tried(outcome),
        HELD_ROLE: CHOSEN_ON if outcome.refuted or outcome.unproven else VALIDATION,
    }


def _axis_ratios(outcome: MovingOutcome) -> list[tuple[float, float, float]]:
    """Held-out RMS with effects over that without, of every axis, with its 95 % interval."""
    sigma = np.ones(outcome.problem.motion.axes)
    found = (held_ratio(outcome.held_before, outcome.held_after, [axis], sigma) for axis in range(len(sigma)))
    return [(ratio.value, ratio.low, ratio.high) for ratio in found]


def _friction_level(problem: MovingProblem, state: MovingState) -> Floats:
    """Coulomb friction (N,) [Nm] near standstill; NaN for an axis without held-out rows."""
    level = state.full.value[problem.null.friction[:, 0]].copy()
    for term in state.terms:
        if isinstance(term, Stribeck):
            level[term.axis] += state.full.value[state.full.part([term])[0]]
    return np.where(problem.motion.measured, np.abs(level), np.nan)


def pictures(
    problem: MovingProblem,
    before: MovingState,
    after: MovingState,
    effects: Sequence[tuple[Term, ...]],
    kept: NDArray[np.int_],
) -> Drawn:
    """Build the plot data.

    Parameters
    ----------
    problem : MovingProblem
    before, after : MovingState
        Without and with the effects.
    effects : sequence of tuples of Term
        The terms of each effect.
    kept : int array of shape (k,)
        Rows that the result file keeps.
    """
    motion = problem.motion
    role = tuple("held out" if stated else "fit" for stated in motion.held_out[kept])
    if not effects:
        return Drawn(role=role)
    return Drawn(
        role=role,
        model_before_nm=matrix((motion.tau_nm - before.full.residual_nm)[kept]),
        curves=tuple(_curve(problem, after, terms) for terms in effects),
    )


def _curve(problem: MovingProblem, state: MovingState, terms: tuple[Term, ...]) -> Curve:
    """One effect on the axis where it is largest."""
    motion, full = problem.motion, state.full
    where = full.part(terms)
    columns, value = full.columns_of(where), full.value[where]
    effect = columns @ value
    axes = sorted({axis for term in terms for axis in term.enters(motion.axes)})
    axis = max(axes, key=lambda number: float(np.mean((effect * motion.judged)[:, number] ** 2)))
    rows = np.flatnonzero(motion.judged[:, axis])
    rows = rows[:: max(1, int(np.ceil(len(rows) / MOST_POINTS)))]
    part = columns[rows, axis]
    variance = np.einsum("nk,kl,nl->n", part, spread_of(problem, state, where), part)
    y, points = effect[rows, axis], effect[rows, axis] + full.residual_nm[rows, axis]
    over = _abscissa(problem, state, terms[0], axis, y, rows)
    order = np.argsort(over[0], kind="stable")
    return Curve.of(
        name=terms[0].name,
        axis=axis,
        y_label=f"J{axis + 1} torque [Nm]",
        over=over,
        y=y,
        std=np.sqrt(np.maximum(variance, 0.0)),
        points=(over[0][order], points[order]),
    )


def _abscissa(
    problem: MovingProblem, state: MovingState, term: Term, axis: int, effect: Floats, rows: NDArray[np.int_]
) -> tuple[Floats, str, str]:
    """Independent variable of an effect; the effect itself if no single quantity describes it."""
    motion = problem.motion
    over = LIBRARY[term.name].over
    if over is Over.ANGLE:
        return motion.q_rad[rows, axis], f"q{axis + 1}", "rad"
    if over is Over.SPEED:
        return motion.qd_rad_s[rows, axis], f"speed of J{axis + 1}", "rad/s"
    if over is Over.TORQUE_BY_DIRECTION:
        torque = np.abs(state.full.modelled.rigid_nm[:, axis]) * motion.sign[:, axis]
        return torque[rows], f"size of the modelled torque of J{axis + 1}, by direction", "Nm"
    return effect, "the effect at each instant, modelled", "Nm"
