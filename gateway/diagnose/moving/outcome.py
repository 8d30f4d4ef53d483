"""The result file of a diagnosis of moving runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held import listed
from gateway.diagnose.moving.fit import MovingProblem
from gateway.diagnose.moving.loads import friction_level, loads_of
from gateway.diagnose.moving.mistakes import MovingMistake
from gateway.diagnose.moving.parameters import figures_of, parameters_of
from gateway.diagnose.moving.pictures import pictures
from gateway.diagnose.moving.select import Chosen
from gateway.diagnose.moving.state import MovingState
from gateway.diagnose.moving.thresholds import MOVING
from gateway.diagnose.moving.trial import Trial
from gateway.model.effects import MISTAKES
from gateway.result.result import (
    EffectResult,
    Evidence,
    Finding,
    FitSummary,
    NextMeasurement,
    Rejected,
    Result,
    Rows,
    Verdict,
)

Floats = NDArray[np.float64]

#: Rows [-] that a result keeps for its pictures: some hundred kilobytes.
ROWS_KEPT = 600


@dataclass(frozen=True, slots=True, eq=False)
class MovingOutcome:
    """Everything the result file is written from."""

    problem: MovingProblem
    before: MovingState
    after: MovingState
    effects: tuple[Chosen, ...]
    doubtful: tuple[Chosen, ...]
    rejected: tuple[Trial, ...]
    mistakes: tuple[MovingMistake, ...]
    as_read: MovingState | None
    structure: Mapping[int, float]
    known: Mapping[str, tuple[float, Floats]]
    wound: tuple[EffectResult, ...] = ()


def result_of(outcome: MovingOutcome) -> Result:
    """Write up a finished diagnosis."""
    problem, after = outcome.problem, outcome.after
    effects = (
        *_mistakes(outcome),
        *outcome.wound,
        *(_effect(problem, after, item, _tried(outcome)) for item in outcome.effects),
    )
    doubtful = outcome.doubtful
    undecided = bool(doubtful) and not effects
    if undecided:
        effects = tuple(part for item in doubtful for part in _rivals(problem, after, item, _tried(outcome)))
    drawn = [item.terms for item in outcome.effects]
    before = outcome.as_read if outcome.as_read is not None else outcome.before
    loads = loads_of(problem, after, outcome.known)
    return Result(
        robot=problem.motion.robot.name,
        loads=loads,
        verdict=_verdict(outcome, undecided, bool(effects)),
        effects=effects,
        before=_summary(problem, before, outcome, first=True),
        after=_summary(problem, after, outcome, first=False),
        holdout_kind="given" if problem.motion.given.any() else "blocks",
        noise_floor_nm=_unknown(problem),
        friction_band_nm=listed(friction_level(problem, after)),
        rejected=_rejected(outcome),
        next=(*(_tell_apart(item) for item in doubtful), *_richer(outcome, bool(effects))),
        findings=(*_faults(() if undecided else effects), *_remarks(outcome)),
        provenance=_provenance(problem, outcome),
        rows=_rows(problem, after),
        data=pictures(problem, outcome.before, after, drawn, _kept(problem)),
    )


def too_little(problem: MovingProblem, state: MovingState) -> Result:
    """Too little motion to hold any of it out."""
    unknown = _unknown(problem)
    summary = FitSummary(rms_nm=listed(_rms(problem, state)), holdout_rms_nm=unknown)
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


def _rms(problem: MovingProblem, state: MovingState) -> Floats:
    judged = problem.motion.judged & ~problem.motion.given[:, None]
    count = judged.sum(axis=0)
    square = (state.full.residual_nm**2 * judged).sum(axis=0)
    return np.sqrt(np.where(count > 0, square, np.nan) / np.maximum(count, 1))


def _summary(problem: MovingProblem, state: MovingState, outcome: MovingOutcome, *, first: bool) -> FitSummary:
    loads = loads_of(problem, outcome.before if first else state, outcome.known)
    return FitSummary(listed(_rms(problem, state)), listed(state.held.rms_nm), loads)


def _effect(problem: MovingProblem, state: MovingState, item: Chosen, tried: int) -> EffectResult:
    """`p_value` counts every candidate that was tried (Bonferroni)."""
    name, parameters, std = parameters_of(problem, state, item.terms)
    runner = item.runner_up
    evidence = Evidence(
        holdout_rms_ratio=item.trial.ratio,
        p_value=min(1.0, max(item.trial.p_demand * tried, 1e-300)),
        runner_up=runner.term.name if runner is not None else None,
        odds=item.odds,
    )
    return EffectResult(name, item.terms[0].joints, parameters, std, evidence)


def _tried(outcome: MovingOutcome) -> int:
    return len(outcome.rejected) + len(outcome.effects) + len(outcome.doubtful)


def _rivals(problem: MovingProblem, state: MovingState, item: Chosen, tried: int) -> list[EffectResult]:
    """Both effects that explain the same rows."""
    found = [_effect(problem, state, item, tried)]
    rival = item.runner_up
    if rival is not None:
        values, std = figures_of(rival)
        evidence = Evidence(rival.ratio, max(rival.p_demand, 1e-300), item.terms[0].name, 1.0 / item.odds)
        found.append(EffectResult(rival.term.name, rival.term.joints, values, std, evidence))
    return found


def _mistakes(outcome: MovingOutcome) -> tuple[EffectResult, ...]:
    return tuple(
        EffectResult(item.name, item.joints, evidence=Evidence(holdout_rms_ratio=item.ratio))
        for item in outcome.mistakes
    )


def _verdict(outcome: MovingOutcome, undecided: bool, any_effect: bool) -> Verdict:
    if undecided:
        return "undecided"
    if any_effect:
        return "improved"
    if _does_not_carry(outcome):
        return "undecided"
    return "unexplained" if outcome.structure else "none_needed"


def _does_not_carry(outcome: MovingOutcome) -> bool:
    """The model fits the rows but not those held out: the motion is too poor for what is to be estimated."""
    fitted, held = _rms(outcome.problem, outcome.after), outcome.after.held.rms_nm
    there = fitted > 0
    return bool(there.any() and np.median(held[there] / fitted[there]) > MOVING.overfitted)


def _rejected(outcome: MovingOutcome) -> tuple[Rejected, ...]:
    accepted = {item.terms[0].label for item in outcome.effects}
    best: dict[tuple[str, tuple[int, ...]], float] = {}
    trials: list[Trial] = list(outcome.rejected)
    if outcome.effects:
        trials += [item.trial for item in outcome.doubtful]
    for trial in trials:
        key = trial.term.label
        if key not in accepted:
            best[key] = min(best.get(key, np.inf), trial.ratio)
    order = sorted(best, key=lambda key: best[key])
    return tuple(Rejected(name, joints, best[(name, joints)]) for name, joints in order)


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


def _provenance(problem: MovingProblem, outcome: MovingOutcome) -> dict[str, object]:
    motion, trust = problem.motion, problem.base.trust
    return {
        "kind": "moving",
        "rows": len(motion),
        "rows_judged": [int(x) for x in motion.judged.sum(axis=0)],
        "holdout_blocks": len(problem.splits),
        "inertials": "ignore" if trust is None else f"prior:{trust:g}",
        "rows_that_count": listed(problem.noise.share * motion.judged.sum(axis=0)),
        "candidates_tried": _tried(outcome),
    }


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
