"""A pair under conditions that changed since it learned: limits in force, the true force until it is at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.pair.bus_gap import gap_rig
from benchmarks.pair.bus_rig import BACK_SPEED, PairRig, inline_rig
from drives.errors import DriveError
from gateway.errors import GatewayError
from gateway.pair.controller import EMBODIMENTS, with_gains
from gateway.pair.pair_motion import PairMotionOptions
from gateway.pair.pair_run import PairRun
from gateway.pair.session import cell_gains
from gateway.pair.transform_function import TransformFunction

Array = NDArray[np.float64]
Row = dict[str, Any]

SPEED = 1.5
CYCLES = 3
#: How far the part slips or is gripped beside where it was taught [m], and in what time it slips [s].
BESIDE_M, SLIP_S = 2e-3, 0.02
#: Where on the path the part slips, share of its time, and how long the arms take to begin it [s].
SLIP_AT, BEGINS_S = 0.4, 1.6


@dataclass(frozen=True, slots=True)
class Trouble:
    """One condition.

    Attributes
    ----------
    name : of its row
    before : done to the rig before the part is gripped
    held : done to the rig and a run that has gone once, the part still held
    word : what the reason of the stop has to name; "" = the pair shall carry on
    """

    name: str
    before: Callable[[PairRig], None] | None = None
    held: Callable[[PairRig, PairRun], PairRun] | None = None
    word: str = ""


def _set_friction(rig: PairRig, coulomb: tuple[float, float], viscous: tuple[float, float]) -> None:
    rig.world.motors.rub(np.repeat(coulomb, 6), np.repeat(viscous, 6))


def _soften(rig: PairRig) -> None:
    rig.world.part.stiffness *= 0.5


def _slips(rig: PairRig, run: PairRun) -> PairRun:
    """The part slips in the grip of arm 2, along itself, in the middle of the next path."""
    part = rig.world.part
    begin_s = rig.world.time_s + BEGINS_S + SLIP_AT * len(run.path) * run.path.dt_s
    before = part.grasp.copy()

    def slip(time_s: float) -> None:
        share = float(np.clip((time_s - begin_s) / SLIP_S, 0.0, 1.0))
        part.grasp = before.copy()
        part.grasp[0, 3] += share * BESIDE_M

    rig.world.after.append(slip)
    return run


def _beside(rig: PairRig, run: PairRun) -> PairRun:
    """The same part, still held, with a function whose grasp is beside the true one."""
    function = run.controller.function
    knots = function.knots.copy()
    knots[:, 0, 3] += BESIDE_M
    shifted = TransformFunction(function.s_m, knots[:, :3, 3], knots[:, :3, :3])
    return PairRun(rig.cell, run.motion.stream, run.config, shifted, run.motion.options)


TROUBLES = (
    Trouble("as it was learned"),
    Trouble("friction of another day, 20 % more", lambda rig: _set_friction(rig, (1.2, 1.2), (1.2, 1.2))),
    Trouble("friction of another day, 20 % less", lambda rig: _set_friction(rig, (0.8, 0.8), (0.8, 0.8))),
    Trouble("arm 1 warm, arm 2 cold", lambda rig: _set_friction(rig, (0.9, 1.1), (0.6, 1.4))),
    Trouble("part of half the stated stiffness", _soften),
    Trouble("part slips by 2 mm in 20 ms", held=_slips, word="slipped"),
    Trouble("grasp wrong by 2 mm", held=_beside, word="grasp"),
)


def hostile(
    seed: int, laws_s: NDArray[np.float64] | None, learned: TransformFunction, back: TransformFunction
) -> list[Row]:
    """Every condition in a rig of its own, with the functions of C8 at the usual speed; then sensors swapped."""
    return [_met(seed, trouble, laws_s, learned, back) for trouble in TROUBLES] + [_swapped(seed)]


def _met(
    seed: int,
    trouble: Trouble,
    laws_s: NDArray[np.float64] | None,
    learned: TransformFunction,
    back: TransformFunction,
) -> Row:
    with inline_rig(seed) as rig:
        if trouble.before is not None:
            trouble.before(rig)
        options = PairMotionOptions(speed=SPEED, back_speed=BACK_SPEED, laws_s=laws_s)
        run = rig.run(with_gains(EMBODIMENTS["C8"], cell_gains(rig.cell)), learned, options, back)
        rig.world.recording = True
        why = ""
        try:
            for number in range(CYCLES):
                if number == 1 and trouble.held is not None:
                    run = trouble.held(rig, run)
                rig.power.attempt(run.cycle)
                rig.power.attempt(run.back)
        except (GatewayError, DriveError) as error:
            why = str(error)
        rig.world.catch_up(0)
        force = np.linalg.norm(np.array(rig.world.record)[:, 1:4], axis=1)
        rig.power.off()
    return _row(seed, trouble, why, float(force.max()))


def _row(seed: int, trouble: Trouble, why: str, force_n: float) -> Row:
    return {
        "tier": "bus",
        "row": "hostile",
        "seed": seed,
        "speed": SPEED,
        "trouble": trouble.name,
        "goes_on": not trouble.word,
        "force_n": force_n,
        "stopped": bool(why),
        "named": bool(trouble.word) and trouble.word in why,
        "why": why,
    }


def _swapped(seed: int) -> Row:
    """Two sensors of the gap are connected inverted; returns how far any gap deviates [m]."""
    trouble = Trouble("two distance sensors swapped", word="swapped")
    with gap_rig(seed) as rig:
        plain = rig.device.measure

        def measure() -> list[float]:
            found = list(plain())
            found[0], found[3] = found[3], found[0]
            return found

        rig.device.measure = measure
        off: list[float] = []
        rig.world.after.append(lambda _time_s: off.append(float(np.abs(rig.sensors.true_m() - rig.demanded_m).max())))
        why = ""
        try:
            run = rig.run("E5", SPEED)
            for _ in range(CYCLES):
                rig.power.attempt(run.cycle)
                run.back()
        except (GatewayError, DriveError) as error:
            why = str(error)
        rig.power.off()
    return _row(seed, trouble, why, 0.0) | {"gap_m": max(off)}
