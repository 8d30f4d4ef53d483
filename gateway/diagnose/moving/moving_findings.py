"""Findings and recommended measurements of a diagnosis in motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held, HeldRatio
from gateway.diagnose.moving.choice import Judges
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_mistakes import MovingMistake
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.select import Chosen
from gateway.diagnose.moving.trial import MovingState
from gateway.model.effects import LIBRARY, MISTAKES
from gateway.model.term import Label
from gateway.result.result import EffectResult, Finding, NextMeasurement

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MovingOutcome:
    """All inputs of the result file.

    `doubtful` effects are contested by a rival; `unproven` ones were not confirmed by the held-out rows; `rejected`
    have their held-out ratio. `reported` is the model of the reported loads and parameters. `held_before`, `held_after`
    are the held-out residuals.
    """

    reported: tuple[MovingProblem, MovingState]
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
    held_before: Held
    held_after: Held
    judges: Judges
    refuted: frozenset[Label] = frozenset()
    wound: tuple[EffectResult, ...] = ()


def rms_of(state: MovingState) -> Floats:
    """RMS (N,) [Nm] of the residual of a model on the fitted rows; NaN where there are none."""
    counted = state.full.weight > 0
    count = counted.sum(axis=0)
    square = (state.full.residual_nm**2 * counted).sum(axis=0)
    return np.sqrt(np.where(count > 0, square, np.nan) / np.maximum(count, 1))


def does_not_carry(outcome: MovingOutcome) -> bool:
    """Return True if the model fits the fitted rows but not the held-out ones: the motion is not rich enough."""
    fitted, held = rms_of(outcome.after), outcome.held_after.rms_nm
    there = (fitted > 0) & np.isfinite(held)
    return bool(there.any() and np.median(held[there] / fitted[there]) > MOVING.overfitted)


def above_floor(outcome: MovingOutcome) -> Mapping[int, float]:
    """Axes (from 0) whose held-out RMS exceeds the difference between periods, with the ratio of both.

    Empty if nothing repeats, because the noise is then unknown.
    """
    problem, held = outcome.problem, outcome.held_after
    floor = problem.motion.floor_nm
    rows = np.maximum(problem.noise.share * held.counted.sum(axis=0), 1.0)
    allowed = MOVING.near_floor + 2.0 / np.sqrt(2.0 * rows)
    ratio = np.divide(held.rms_nm, floor, out=np.full_like(floor, np.nan), where=floor > 0)
    return {int(axis): float(ratio[axis]) for axis in np.flatnonzero(ratio > allowed)}


def floor_known(outcome: MovingOutcome) -> bool:
    """Return True if the noise of every tested axis is known from repeated motion."""
    motion = outcome.problem.motion
    return bool(np.isfinite(motion.floor_nm[motion.measured]).all())


def _where(item: Chosen) -> str:
    return ", ".join(f"J{joint}" for joint in item.terms[0].joints) or "the arm"


def separating_run(item: Chosen) -> NextMeasurement:
    """Recommend a run that separates an effect from its runner-up."""
    names = [item.terms[0].name]
    if item.runner_up is not None:
        names.append(item.runner_up.term.name)
    axes = _where(item)
    what = f"a moving run in which {axes} pass the same postures at several speeds, in both directions, bare and loaded"
    return NextMeasurement(what, tells_apart=tuple(names))


def richer(outcome: MovingOutcome, any_effect: bool) -> tuple[NextMeasurement, ...]:
    """Recommend a longer run if no effect was found and held-out rows are not predicted."""
    if any_effect or not does_not_carry(outcome):
        return ()
    what = "a longer moving run over the whole range of every axis; the held-out rows are not predicted by the others"
    return (NextMeasurement(what),)


def faults(effects: tuple[EffectResult, ...]) -> tuple[Finding, ...]:
    """A failing finding for every commissioning mistake."""
    return tuple(
        Finding("fail", " ".join(f"J{joint}" for joint in effect.joints), *MISTAKES[effect.name], effect.name)
        for effect in effects
        if effect.name in MISTAKES
    )


def remarks(outcome: MovingOutcome) -> tuple[Finding, ...]:
    """Report unmeasured axes, remaining structure and unconfirmed effects."""
    motion = outcome.problem.motion
    found = [
        Finding("warn", f"J{axis + 1}", "the axis does not move or is not measured: no result for it")
        for axis in np.flatnonzero(~motion.measured)
    ]
    found += [
        Finding("info", f"J{axis + 1}", f"the residual still depends on the motion (held-out ratio {ratio:.2f})")
        for axis, ratio in outcome.structure.items()
    ]
    found += [
        Finding(
            "info",
            f"J{axis + 1}",
            f"the error on unseen motion is {ratio:.2f} times the difference between periods of the same motion: the"
            " model lacks an effect that repeats",
        )
        for axis, ratio in above_floor(outcome).items()
    ]
    found += [Finding("info", _where(item), f"{_why_not(item)}: not reported") for item in outcome.unproven]
    found += [
        Finding(
            "warn",
            " ".join(f"J{joint}" for joint in joints),
            f"{MISTAKES[name][0]}: suspected, but not confirmed by the held-out rows",
            "check the torque sign and the wiring of these axes",
        )
        for name, joints in sorted(outcome.refuted)
    ]
    if motion.held_out.any() and does_not_carry(outcome):
        found.append(
            Finding(
                "warn",
                "--holdout",
                f"the residual of its rows is more than {MOVING.overfitted:g} times that of the "
                "fitted rows: another robot,"
                " another load or state, or too little motion; the model is not validated on them",
                "hold out a run of the same robot under a fitted load",
            )
        )
    if outcome.effects:
        found += [
            Finding(
                "info",
                _where(item),
                f"undecided: {' or '.join(separating_run(item).tells_apart)}",
            )
            for item in outcome.doubtful
        ]
    return tuple(found)


def edge_findings(effects: Sequence[EffectResult]) -> list[Finding]:
    """Report parameters without standard deviation because they are at a limit of the tried range."""
    return [
        Finding(
            "info",
            " ".join(f"J{joint}" for joint in effect.joints),
            f"{key} of {LIBRARY[effect.name].words} is at the limit of the tried range; the true "
            "value may be beyond it",
        )
        for effect in effects
        for key, std in effect.std.items()
        if np.isnan(std)
    ]


def _why_not(item: Chosen) -> str:
    """Reason why an effect that the fitted rows support is not reported."""
    words, held = LIBRARY[item.terms[0].name].words, item.held
    if not held.below_one:
        return (
            f"{words} fits the rows, but does not predict the held-out rows (held-out ratio {held.value:.2f},"
            f" 95 % {held.low:.2f} to {held.high:.2f})"
        )
    if item.runner_up is None:
        return f"{words} has too little evidence for its prior probability (odds {item.odds:.2g})"
    other = LIBRARY[item.runner_up.term.name].words
    return f"{words} fits the rows barely better than {other}, which is not accepted either (odds {item.odds:.2g})"
