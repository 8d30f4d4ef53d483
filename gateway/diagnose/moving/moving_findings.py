"""What is found on moving rows, and what is said of it in words: findings, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.moving.judge import Judges
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_mistakes import MovingMistake
from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.ratio import HeldRatio
from gateway.diagnose.moving.select import Chosen
from gateway.diagnose.moving.state import MovingState
from gateway.model.effects import LIBRARY, MISTAKES
from gateway.model.term import Label
from gateway.result.result import EffectResult, Finding, NextMeasurement

Floats = NDArray[np.float64]


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
    held_before: Held
    held_after: Held
    judges: Judges
    refuted: frozenset[Label] = frozenset()
    wound: tuple[EffectResult, ...] = ()


def rms_of(state: MovingState) -> Floats:
    """RMS (N,) [Nm] of what a model leaves of the fitted rows; NaN where there are none."""
    counted = state.full.weight > 0
    count = counted.sum(axis=0)
    square = (state.full.residual_nm**2 * counted).sum(axis=0)
    return np.sqrt(np.where(count > 0, square, np.nan) / np.maximum(count, 1))


def does_not_carry(outcome: MovingOutcome) -> bool:
    """The model fits the rows but not those held out: the motion is too poor for what is to be estimated."""
    fitted, held = rms_of(outcome.after), outcome.held_after.rms_nm
    there = (fitted > 0) & np.isfinite(held)
    return bool(there.any() and np.median(held[there] / fitted[there]) > MOVING.overfitted)


def above_floor(outcome: MovingOutcome) -> Mapping[int, float]:
    """Axes (from 0) whose held-out RMS is more than what differs between periods, with the ratio of both.

    Empty where nothing repeats: the noise is unknown there.
    """
    problem, held = outcome.problem, outcome.held_after
    floor = problem.motion.floor_nm
    rows = np.maximum(problem.noise.share * held.counted.sum(axis=0), 1.0)
    allowed = MOVING.near_floor + 2.0 / np.sqrt(2.0 * rows)
    ratio = np.divide(held.rms_nm, floor, out=np.full_like(floor, np.nan), where=floor > 0)
    return {int(axis): float(ratio[axis]) for axis in np.flatnonzero(ratio > allowed)}


def floor_known(outcome: MovingOutcome) -> bool:
    """Whether the noise of every axis that is judged is known from motion that repeats."""
    motion = outcome.problem.motion
    return bool(np.isfinite(motion.floor_nm[motion.measured]).all())


def _where(item: Chosen) -> str:
    return ", ".join(f"J{joint}" for joint in item.terms[0].joints) or "the arm"


def tell_apart(item: Chosen) -> NextMeasurement:
    """A run that tells an effect from its runner-up."""
    names = [item.terms[0].name]
    if item.runner_up is not None:
        names.append(item.runner_up.term.name)
    axes = _where(item)
    what = f"a moving run in which {axes} pass the same postures at several speeds, in both directions, bare and loaded"
    return NextMeasurement(what, tells_apart=tuple(names))


def richer(outcome: MovingOutcome, any_effect: bool) -> tuple[NextMeasurement, ...]:
    """A longer run, where nothing was found and the rows held out are not foretold."""
    if any_effect or not does_not_carry(outcome):
        return ()
    what = "a longer moving run over the whole range of every axis; the rows held out are not foretold by the others"
    return (NextMeasurement(what),)


def faults(effects: tuple[EffectResult, ...]) -> tuple[Finding, ...]:
    """A failing finding for every commissioning mistake."""
    return tuple(
        Finding("fail", " ".join(f"J{joint}" for joint in effect.joints), *MISTAKES[effect.name], effect.name)
        for effect in effects
        if effect.name in MISTAKES
    )


def remarks(outcome: MovingOutcome) -> tuple[Finding, ...]:
    """What else has to be known: axes that say nothing, structure that is left, what was not borne out."""
    motion = outcome.problem.motion
    found = [
        Finding("warn", f"J{axis + 1}", "the axis does not move or is not measured: nothing is said about it")
        for axis in np.flatnonzero(~motion.measured)
    ]
    found += [
        Finding("info", f"J{axis + 1}", f"the residual still hangs on the motion (held-out ratio {ratio:.2f})")
        for axis, ratio in outcome.structure.items()
    ]
    found += [
        Finding(
            "info",
            f"J{axis + 1}",
            f"the error on unseen motion is {ratio:.2f} times what differs between two periods of the same motion: the"
            " model lacks something there that repeats",
        )
        for axis, ratio in above_floor(outcome).items()
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
    if motion.held_out.any() and does_not_carry(outcome):
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
                f"undecided: {' or '.join(tell_apart(item).tells_apart)}",
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
