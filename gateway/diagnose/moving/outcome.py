"""The result file of a diagnosis of moving runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held import Held, listed
from gateway.diagnose.moving.fit import MovingProblem
from gateway.diagnose.moving.judge import Judges
from gateway.diagnose.moving.loads import friction_level, loads_of, nuisances
from gateway.diagnose.moving.mistakes import MovingMistake
from gateway.diagnose.moving.parameters import figures_of, parameters_of
from gateway.diagnose.moving.pictures import pictures
from gateway.diagnose.moving.ratio import HeldRatio, held_ratio
from gateway.diagnose.moving.select import Chosen
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.moving.thresholds import MOVING
from gateway.model.effects import LIBRARY, MISTAKES
from gateway.model.term import Label
from gateway.result.result import (
    EffectResult,
    Evidence,
    Finding,
    FitSummary,
    LoadResult,
    NextMeasurement,
    Rejected,
    Result,
    Rows,
    Verdict,
)

Floats = NDArray[np.float64]

ROWS_KEPT = 600
#: What the figures on rows held out speak of.
HELD_OUT = {
    "given": "rows that were given, and chose nothing",
    "blocks": "blocks of time of the same runs, each judged by a choice without it; they say little about another run",
}


@dataclass(frozen=True, slots=True, eq=False)
class MovingOutcome:
    """Everything the result file is written from.

    `doubtful` effects are contested, `unproven` ones were not borne out by the rows that judge; `rejected` have their
    held-out ratio. `told` is the model that loads and parameters are read from. `held_before`, `held_after`: what is
    left of rows that chose nothing.
    """

    told: tuple[MovingProblem, MovingState]
    problem: MovingProblem
    before: MovingState
    after: MovingState
    effects: tuple[Chosen, ...]
    doubtful: tuple[Chosen, ...]
    unproven: tuple[Chosen, ...]
    rejected: tuple[tuple[Label, float], ...]
    mistakes: tuple[tuple[MovingMistake, HeldRatio], ...]
    as_read: MovingState | None
    structure: Mapping[int, float]
    known: Mapping[str, tuple[float, Floats]]
    held_before: Held
    held_after: Held
    judges: Judges
    refuted: frozenset[Label] = frozenset()
    wound: tuple[EffectResult, ...] = ()


def result_of(outcome: MovingOutcome) -> Result:
    """Write up a finished diagnosis."""
    problem, after = outcome.problem, outcome.after
    effects = (
        *_mistakes(outcome),
        *outcome.wound,
        *(_effect(*outcome.told, item, _tried(outcome)) for item in outcome.effects),
    )
    doubtful = outcome.doubtful
    undecided = bool(doubtful) and not effects
    if undecided:
        effects = tuple(part for item in doubtful for part in _rivals(outcome, item))
    drawn = [item.terms for item in outcome.effects]
    before = outcome.as_read if outcome.as_read is not None else outcome.before
    loads = loads_of(*outcome.told, outcome.known)
    return Result(
        robot=problem.motion.robot.name,
        loads=loads,
        verdict=_verdict(outcome, undecided, bool(effects)),
        effects=effects,
        before=_summary(before, outcome.held_before, loads_of(problem, outcome.before, outcome.known)),
        after=_summary(after, outcome.held_after, loads),
        holdout_kind="given" if problem.motion.given.any() else "blocks",
        noise_floor_nm=_unknown(problem),
        friction_band_nm=listed(friction_level(problem, after)),
        rejected=_rejected(outcome),
        next=(*(_tell_apart(item) for item in doubtful), *_richer(outcome, bool(effects))),
        findings=(*_faults(() if undecided else effects), *_remarks(outcome), *edge_findings(effects)),
        nuisance=nuisances(*outcome.told),
        provenance=_provenance(problem, outcome),
        quality={"holdout_ratio": _axis_ratios(outcome)},
        rows=_rows(problem, after),
        data=pictures(problem, outcome.before, after, drawn, _kept(problem)),
    )


def too_little(problem: MovingProblem, state: MovingState) -> Result:
    """Too little motion to hold any of it out."""
    unknown = _unknown(problem)
    summary = FitSummary(rms_nm=listed(_rms(state)), holdout_rms_nm=unknown)
    step = NextMeasurement("a moving run of at least 10 s in which every axis changes its direction several times")
    what = f"{int((~problem.motion.given).sum())} moving rows over {problem.motion.duration_s:.1f} s"
    return Result(
        robot=problem.motion.robot.name,
        verdict="undecided",
        before=summary,
        after=summary,
        noise_floor_nm=unknown,
        friction_band_nm=unknown,
        holdout_kind="blocks",
        next=(step,),
        findings=(Finding("warn", "data", f"{what} are too few to hold any out", "record a longer run"),),
    )


def _unknown(problem: MovingProblem) -> tuple[float, ...]:
    return (np.nan,) * problem.motion.axes


def _rms(state: MovingState) -> Floats:
    counted = state.full.weight > 0
    count = counted.sum(axis=0)
    square = (state.full.residual_nm**2 * counted).sum(axis=0)
    return np.sqrt(np.where(count > 0, square, np.nan) / np.maximum(count, 1))


def _summary(state: MovingState, held: Held, loads: tuple[LoadResult, ...]) -> FitSummary:
    return FitSummary(listed(_rms(state)), listed(held.rms_nm), loads)


def _effect(problem: MovingProblem, state: MovingState, item: Chosen, tried: int) -> EffectResult:
    """`p_value` counts every candidate that was tried (Bonferroni)."""
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
    """Both effects that explain the same rows."""
    problem = outcome.problem
    found = [_effect(*outcome.told, item, _tried(outcome))]
    rival = item.runner_up
    if rival is not None:
        values, std = figures_of(rival)
        axes = list(rival.term.enters(problem.motion.axes))
        held = outcome.judges.effect(item.label, axes, problem.noise.sigma_nm, [rival.term])
        evidence = Evidence(held.value, max(rival.p_demand, 1e-300), item.terms[0].name, 1.0 / item.odds)
        found.append(EffectResult(rival.term.name, rival.term.joints, values, std, evidence))
    return found


def _mistakes(outcome: MovingOutcome) -> tuple[EffectResult, ...]:
    return tuple(
        EffectResult(item.name, item.joints, evidence=Evidence(holdout_rms_ratio=ratio.value))
        for item, ratio in outcome.mistakes
    )


def _verdict(outcome: MovingOutcome, undecided: bool, any_effect: bool) -> Verdict:
    if undecided:
        return "undecided"
    if any_effect:
        return "improved"
    if outcome.structure:
        return "unexplained"
    return "undecided" if _does_not_carry(outcome) else "none_needed"


def _does_not_carry(outcome: MovingOutcome) -> bool:
    """The model fits the rows but not those held out: the motion is too poor for what is to be estimated."""
    fitted, held = _rms(outcome.after), outcome.held_after.rms_nm
    there = (fitted > 0) & np.isfinite(held)
    return bool(there.any() and np.median(held[there] / fitted[there]) > MOVING.overfitted)


def _rejected(outcome: MovingOutcome) -> tuple[Rejected, ...]:
    found = dict(outcome.rejected) | {item.label: item.held.value for item in outcome.unproven}
    if outcome.effects:
        found |= {item.label: item.held.value for item in outcome.doubtful}
    for item in outcome.effects:
        found.pop(item.label, None)
    order = sorted(found, key=lambda label: found[label])
    return tuple(Rejected(*label, found[label]) for label in order)


def _where(item: Chosen) -> str:
    return ", ".join(f"J{joint}" for joint in item.terms[0].joints) or "the arm"


def _tell_apart(item: Chosen) -> NextMeasurement:
    names = [item.terms[0].name]
    if item.runner_up is not None:
        names.append(item.runner_up.term.name)
    axes = _where(item)
    what = f"a moving run in which {axes} pass the same postures at several speeds, in both directions, bare and loaded"
    return NextMeasurement(what, tells_apart=tuple(names))


def _richer(outcome: MovingOutcome, any_effect: bool) -> tuple[NextMeasurement, ...]:
    if any_effect or not _does_not_carry(outcome):
        return ()
    what = "a longer moving run over the whole range of every axis; the rows held out are not foretold by the others"
    return (NextMeasurement(what),)


def _faults(effects: tuple[EffectResult, ...]) -> tuple[Finding, ...]:
    return tuple(
        Finding("fail", " ".join(f"J{joint}" for joint in effect.joints), *MISTAKES[effect.name])
        for effect in effects
        if effect.name in MISTAKES
    )


def _remarks(outcome: MovingOutcome) -> tuple[Finding, ...]:
    motion = outcome.problem.motion
    found = [
        Finding("warn", f"J{axis + 1}", "the axis does not move or is not measured: nothing is said about it")
        for axis in np.flatnonzero(~motion.measured)
    ]
    found += [
        Finding("info", f"J{axis + 1}", f"the residual still hangs on the motion (held-out ratio {ratio:.2f})")
        for axis, ratio in outcome.structure.items()
    ]
    found += [Finding("info", _where(item), f"{_why_not(item)}: not believed") for item in outcome.unproven]
    found += [
        Finding(
            "warn",
            " ".join(f"J{joint}" for joint in joints),
            f"{MISTAKES[name][0]}: suspected, and not borne out by the rows that chose nothing",
            "check the sign and the place of its torque",
        )
        for name, joints in sorted(outcome.refuted)
    ]
    if motion.given.any() and _does_not_carry(outcome):
        found.append(
            Finding(
                "warn",
                "--holdout",
                f"its rows are left by more than {MOVING.overfitted:g} times what the fitted ones are: another robot,"
                " another load or state, or too poor a motion; no figure on them speaks for the model",
                "hold out a run of the same robot under a load that is fitted",
            )
        )
    if outcome.effects:
        found += [
            Finding(
                "info",
                _where(item),
                f"undecided: {' or '.join(_tell_apart(item).tells_apart)}",
            )
            for item in outcome.doubtful
        ]
    return tuple(found)


def edge_findings(effects: Sequence[EffectResult]) -> list[Finding]:
    """Parameters with no standard deviation because they lie at the edge of what is tried."""
    return [
        Finding(
            "info",
            " ".join(f"J{joint}" for joint in effect.joints),
            f"{key} of {LIBRARY[effect.name].words} lies at the edge of what was tried, the true one perhaps beyond it",
        )
        for effect in effects
        for key, std in effect.std.items()
        if np.isnan(std)
    ]


def _why_not(item: Chosen) -> str:
    """Why an effect that the fitted rows want is not named."""
    words, held = LIBRARY[item.terms[0].name].words, item.held
    if not held.below_one:
        return (
            f"{words} fits the rows, but does not foretell those that chose nothing (held-out ratio {held.value:.2f},"
            f" 95 % {held.low:.2f} to {held.high:.2f})"
        )
    if item.runner_up is None:
        return f"{words} is not worth what it has to be beforehand (odds {item.odds:.2g})"
    other = LIBRARY[item.runner_up.term.name].words
    return f"{words} fits the rows hardly better than {other}, which is not believed itself (odds {item.odds:.2g})"


def _provenance(problem: MovingProblem, outcome: MovingOutcome) -> dict[str, object]:
    motion, trust = problem.motion, problem.base.trust
    return {
        "kind": "moving",
        "rows": len(motion),
        "rows_judged": [int(x) for x in motion.judged.sum(axis=0)],
        "holdout_blocks": len(outcome.judges.choices),
        "held_out": HELD_OUT["given" if motion.given.any() else "blocks"],
        "inertials": "ignore" if trust is None else f"prior:{trust:g}",
        "rows_that_count": listed(problem.noise.share * motion.judged.sum(axis=0)),
        "candidates_tried": _tried(outcome),
    }


def _axis_ratios(outcome: MovingOutcome) -> list[tuple[float, float, float]]:
    """Held-out RMS after over before of every axis, with its 95 % interval."""
    sigma = np.ones(outcome.problem.motion.axes)
    found = (held_ratio(outcome.held_before, outcome.held_after, [axis], sigma) for axis in range(len(sigma)))
    return [(ratio.value, ratio.low, ratio.high) for ratio in found]


def _kept(problem: MovingProblem) -> NDArray[np.int_]:
    """Rows that the result file keeps."""
    return np.arange(0, len(problem.motion), max(1, int(np.ceil(len(problem.motion) / ROWS_KEPT))))


def _rows(problem: MovingProblem, state: MovingState) -> Rows:
    motion = problem.motion
    kept = _kept(problem)

    def matrix(values: Floats) -> tuple[tuple[float, ...], ...]:
        return tuple(listed(row) for row in values[kept])

    tau = np.where(motion.measured, motion.tau_nm, np.nan)
    unknown = np.full((len(motion), motion.axes), np.nan)
    return Rows(
        run=tuple(str(number) for number in motion.run[kept]),
        load=tuple(str(label) for label in motion.load[kept]),
        pose=(-1,) * len(kept),
        time_s=listed(motion.time_s[kept]),
        q_rad=matrix(motion.q_rad),
        direction=tuple(tuple(int(x) for x in row) for row in np.sign(motion.sign[kept].round(6)).astype(int)),
        tau_nm=matrix(tau),
        model_nm=matrix(motion.tau_nm - state.full.residual_nm),
        band_nm=matrix(unknown),
        std_nm=matrix(unknown),
    )
