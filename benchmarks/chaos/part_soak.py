"""Endurance: the arm swings slowly in real time; memory stays flat, no epoch is incomplete but by the computer's doing.

Master and drives have a core each, and a bare real-time sleeper beside them on it. An incomplete epoch is the
computer's doing where a sleeper was not woken for more than half a period, within one period of it.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.chaos.processes import Drives, drives
from benchmarks.chaos.rig import with_real_pacing
from benchmarks.chaos.sleeper import Sleeper, joined
from benchmarks.figure import figure
from drives.bus import BusSpec, open_bus
from drives.drive import DriveCommand
from drives.errors import DriveError, MasterStalled
from drives.group import DriveGroup
from drives.realtime import RealTime
from gateway.motion.opening import axis_setups

PERIOD_S = 0.01
SWING_RAD = 2.0
#: Share of a period without waking from which a sleeper has seen a stall.
STALL_PERIODS = 0.5
#: What is loaded and cached in the first minute does not count.
WARM_UP_S = 30.0


def resident_bytes() -> int:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def figures(scope: Any) -> dict[str, dict]:
    """Swing for so many minutes."""
    seconds = 60.0 * scope.minutes
    bar = scope.bar("soak [s]", seconds)
    cores = sorted(os.sched_getaffinity(0))
    own, other = cores[0], cores[-1]
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        os.sched_setaffinity(0, {other})
        sleepers = [Sleeper(core, STALL_PERIODS * PERIOD_S) for core in (own, other)]
        try:
            with drives(Path(folder), with_real_pacing(PERIOD_S), watch=False) as served:
                os.sched_setaffinity(0, {own})
                swung = _swing(served, seconds, bar.step)
        finally:
            os.sched_setaffinity(0, set(cores))
            beside, far = (sleeper.end() for sleeper in sleepers)
    both = joined(beside, far)
    unseen = [at_s for at_s in swung.incomplete_s if not both.near(at_s, PERIOD_S)]
    here = [at_s for at_s in swung.incomplete_s if not beside.near(at_s, PERIOD_S)]
    scope.complain(swung.stops, "soak, stopped")
    for minute, count in sorted(Counter(int((at_s - swung.began_s) / 60.0) for at_s in unseen).items()):
        scope.print(f"soak, minute {minute + 1}: {count} incomplete epochs without a stall", markup=False)
    kind = "SCHED_FIFO" if both.real_time else "default scheduler: real time not permitted"
    return {
        "soak SYNC cycles": figure(
            swung.cycles, f">= {round(0.95 * seconds / PERIOD_S)}", f"in {scope.minutes:.1f} min"
        ),
        "soak incomplete epochs, all": figure(len(swung.incomplete_s), ">= 0"),
        "soak incomplete epochs without a stall that a sleeper sees": figure(
            len(unseen), "== 0", f"({len(here)} by the sleeper on the master's core alone; {kind})"
        ),
        "soak stalls of the sleeper on the master's core": figure(
            len(beside.stalls), ">= 0", f"longest {1e3 * beside.longest_s:.1f} ms"
        ),
        "soak stalls of the sleeper on the drives' core": figure(
            len(far.stalls), ">= 0", f"longest {1e3 * far.longest_s:.1f} ms"
        ),
        "soak memory grown": figure(swung.grown_bytes / 1e6, "<= 5", "MB"),
        "soak stops of the arm": figure(len(swung.stops), ">= 0"),
        "soak periods missed in real time": figure(swung.overruns, ">= 0"),
    }


@dataclass(slots=True)
class Swung:
    """What a long swing has shown.

    Attributes
    ----------
    cycles : SYNCs
    incomplete_s : monotonic time of the SYNC of each incomplete epoch
    grown_bytes : memory since the warm-up
    overruns : periods missed
    stops : why the arm had to be enabled again, each time
    warm_bytes : memory after the warm-up
    began_s : monotonic time
    """

    cycles: int = 0
    incomplete_s: list[float] = field(default_factory=list)
    grown_bytes: int = 0
    overruns: int = 0
    stops: list[str] = field(default_factory=list)
    warm_bytes: int = 0
    began_s: float = field(default_factory=time.monotonic)


def _swing(served: Drives, seconds: float, on_progress: Callable[[float], None]) -> Swung:
    swung = Swung()
    with RealTime():
        while time.monotonic() - swung.began_s < seconds:
            _swing_once(served, swung.began_s + seconds, swung, on_progress)
    swung.grown_bytes = resident_bytes() - (swung.warm_bytes or resident_bytes())
    return swung


def _swing_once(served: Drives, until_s: float, swung: Swung, on_progress: Callable[[float], None]) -> None:
    """Swing until the time is over, or until the arm was stopped because this computer was stalled."""
    setups = axis_setups(served.loaded, served.loaded.cell.arm[0])
    try:
        with open_bus(BusSpec.parse(served.bus)) as bus, DriveGroup(bus, setups, PERIOD_S, "real") as group:
            group.connect()
            group.configure()
            start = [reading.position_rad for reading in group.enable().readings if reading is not None]
            try:
                _swing_on(group, start, until_s, swung, on_progress)
            finally:
                swung.overruns += group.statistics.overruns
    except MasterStalled:
        swung.stops.append("stalled")
        swung.incomplete_s.append(time.monotonic())
    except DriveError as error:
        swung.stops.append(str(error))
        served.ask("renew")


def _swing_on(
    group: DriveGroup, start: list[float], until_s: float, swung: Swung, on_progress: Callable[[float], None]
) -> None:
    row = 0
    warm_s = time.monotonic() + min(WARM_UP_S, (until_s - time.monotonic()) / 2)
    while (now_s := time.monotonic()) < until_s:
        swing = SWING_RAD * (1.0 - math.cos(2.0 * math.pi * row * PERIOD_S / 10.0))
        epoch = group.exchange([DriveCommand(angle + swing) for angle in start])
        row += 1
        swung.cycles += 1
        if not epoch.complete:
            swung.incomplete_s.append(group.sync_sent_s)
        if not swung.warm_bytes and now_s > warm_s:
            swung.warm_bytes = resident_bytes()
        if row % 100 == 0:
            on_progress(100 * PERIOD_S)
