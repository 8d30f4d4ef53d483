"""Two arms are stopped with one part between them: the largest true force inside the part, over PyBullet in lockstep.

Row B (one relation, hands that yield) at speed 1.5, stopped at three instants of its path. Causes are an operator, a
quick stop of healthy drives, a drive that faults and one that stops responding.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Final

import numpy as np

from benchmarks.figure import figure
from benchmarks.pair.bus_rig import NO_LIMIT_N, PairRig, inline_rig
from drives.errors import DriveError
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson
from gateway.pair.controller import EMBODIMENTS, with_gains
from gateway.pair.pair_motion import PairMotionOptions
from gateway.pair.pair_run import PairRun
from gateway.pair.session import cell_gains
from gateway.pair.transform_function import constant_function
from sim.fake_drive import FakeDrive

ROW, SPEED, SEEDS, JOBS = "B", 1.5, 10, 2
#: Instants of the path [s]: getting faster, in the middle, and where the force of the row is largest.
INSTANTS_S: Final = (0.9, 1.5, 2.1)
BEFORE_S = 0.2
#: Axis that fails, counted over both arms.
FAILING = 8
#: SYNCs from the last answer of a drive to the stop of the others: five unanswered, one to command, one to act.
UNANSWERED_SYNCS = 7


@dataclass(frozen=True, slots=True)
class PairStop:
    """One stop.

    Attributes
    ----------
    kind, seed, at_s : what stopped the pair, and when
    before_n, after_n : largest force in the 0.2 s before it, and from then until all twelve brakes have closed [N]
    off_before_m, off_after_m : largest deviation of the hands from how they gripped the part, in the same times
    bound_n : what stiffness, ramps and speeds at that instant allow [N]
    """

    kind: str
    seed: int
    at_s: float
    before_n: float
    after_n: float
    off_before_m: float
    off_after_m: float
    bound_n: float


def _by_person(desk: StopDesk, _drive: FakeDrive) -> None:
    desk.ask(StoppedByPerson("stopped"))


def _quickly(desk: StopDesk, _drive: FakeDrive) -> None:
    desk.ask(StoppedByPerson("stopped"), StopKind.QUICK_STOP)


def _fault(_desk: StopDesk, drive: FakeDrive) -> None:
    drive.raise_fault(0x3210)


def _stop_responding(_desk: StopDesk, drive: FakeDrive) -> None:
    drive.node.unpowered = True


STOPS: dict[str, Callable[[StopDesk, FakeDrive], None]] = {
    "along the path": _by_person,
    "quick stop": _quickly,
    "drive in fault": _fault,
    "drive does not respond": _stop_responding,
}


def stopped(kind: str, seed: int, at_s: float, row: str = ROW) -> PairStop:
    """Stop a fresh pair once."""
    with inline_rig(seed) as rig:
        drives = [drive for unit in rig.simulation.arms for drive in unit.drives]
        config = with_gains(EMBODIMENTS[row], cell_gains(rig.cell))
        run = rig.run(
            config,
            constant_function(rig.cell.nominal_relation),
            PairMotionOptions(speed=SPEED, force_limit_n=NO_LIMIT_N),
        )
        desk, world, asked = run.motion.stream.options.desk, rig.world, []
        begin_s = world.time_s + at_s

        def stop(time_s: float) -> None:
            if not asked and time_s >= begin_s:
                delay = UNANSWERED_SYNCS if kind == "drive does not respond" else 1
                asked.append((time_s, bound_n(rig, drives, delay * rig.cell.sync_period_s)))
                STOPS[kind](desk, drives[FAILING])

        world.after.append(stop)
        _run_until_stopped(rig, run)
        record = np.array(world.record)
        (time_s, bound), time = asked[0], record[:, 0]
        drives[FAILING].node.unpowered = False
    force = record[:, 1:4]
    size, off = np.linalg.norm(force, axis=1), np.linalg.norm(force, axis=1) / world.part.stiffness[0]
    before, after = (time > time_s - BEFORE_S) & (time <= time_s), time > time_s
    largest = [float(values[when].max()) for values in (size, off) for when in (before, after)]
    return PairStop(kind, seed, at_s, *largest, bound_n=bound + largest[0])


def _run_until_stopped(rig: PairRig, run: PairRun) -> None:
    world = rig.world
    world.record.clear()
    world.recording = True
    try:
        rig.power.attempt(run.cycle)
    except (StoppedByPerson, DriveError):
        world.catch_up(0)
        world.recording = False
        return
    raise AssertionError("the pair was not stopped")


def bound_n(rig: PairRig, drives: list[FakeDrive], delay_s: float) -> float:
    """Force that a stop adds at most: each axis ends anywhere between here and its ramp's end, lag and delay included.

    The distances of all joints are added as if each moved the hands in one direction, times the stiffness of the chain
    of gears and part.
    """
    world = rig.world
    speed = np.abs(world.motors.omega)
    ramps = np.array([drive.motion.joint_speed(drive.store.number((0x6085, 0))) for drive in drives])
    lag_s = np.asarray(world.motors.train.lag_s)
    distance = speed**2 / (2.0 * ramps) + speed * (lag_s + delay_s)
    lever_m = np.linalg.norm(world.part.at(world.q).jacobian[:3], axis=0)
    return rig.cell.config.force.stiffness.straight * float(lever_m @ distance)


def figures(scope: Any) -> dict[str, dict]:
    """All stops of all seeds; each one is printed."""
    jobs = [(kind, seed, at_s) for seed in range(scope.count(SEEDS)) for kind in STOPS for at_s in INSTANTS_S]
    bar = scope.bar("stops of a pair", len(jobs))
    found: list[PairStop] = []
    with ProcessPoolExecutor(JOBS, mp_context=get_context("spawn")) as pool:
        for done in pool.map(stopped, *zip(*jobs, strict=True)):
            found.append(done)
            bar.step()
            scope.print(in_words(done), markup=False)
    return judged(found)


def in_words(done: PairStop) -> str:
    """One line."""
    return (
        f"seed {done.seed}, {done.kind} at {done.at_s:.1f} s: {done.before_n:.0f} N before, {done.after_n:.0f} N after"
        f" ({done.after_n / done.before_n:.2f} times; bound {done.bound_n:.0f} N), part"
        f" {1e3 * done.off_before_m:.3f} to {1e3 * done.off_after_m:.3f} mm"
    )


def judged(found: list[PairStop]) -> dict[str, dict]:
    """Figures with their goals."""
    out: dict[str, dict] = {}
    along = [done for done in found if done.kind == "along the path"]
    if along:
        ratio = [done.after_n / done.before_n for done in along]
        spread = (min(ratio), max(ratio))
        out["pair stopped along the path, force over the force before"] = figure(max(ratio), "<= 1.2", "", spread)
        most = max(done.after_n for done in along)
        out["pair stopped along the path, largest force"] = figure(most, "<= 120", "N")
    quick = [done.after_n for done in found if done.kind == "quick stop"]
    if quick:
        spread = (min(quick), max(quick))
        out["pair, quick stop of healthy drives, largest force"] = figure(max(quick), "<= 120", "N", spread)
    for kind in ("drive in fault", "drive does not respond"):
        share = [done.after_n / done.bound_n for done in found if done.kind == kind]
        if share:
            spread = (min(share), max(share))
            out[f"pair, {kind}: largest force over its bound"] = figure(max(share), "<= 1", "", spread)
    return out
