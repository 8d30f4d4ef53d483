"""Endurance: the arm swings slowly by the clock; memory stays flat, no epoch is incomplete."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

from drives.bus import BusSpec, open_bus
from drives.drive import DriveCommand
from drives.group import DriveGroup
from gateway.motion.opening import axis_setups
from tests.chaos.figure import figure
from tests.chaos.processes import drives
from tests.chaos.rig import with_real_pacing

PERIOD_S = 0.01
SWING_RAD = 2.0
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
    with (
        tempfile.TemporaryDirectory(prefix="soak-") as folder,
        drives(Path(folder), with_real_pacing(PERIOD_S)) as served,
    ):
        setups = axis_setups(served.loaded, served.loaded.cell.arm[0])
        bus_spec = BusSpec.parse(served.bus)
        with open_bus(bus_spec) as bus, DriveGroup(bus, setups, PERIOD_S, "real") as group:
            group.connect()
            group.configure()
            start = [reading.position_rad for reading in group.enable().readings if reading is not None]
            began_s = time.monotonic()
            warm: int | None = None
            cycles = incomplete = 0
            while (passed_s := time.monotonic() - began_s) < seconds:
                swing = SWING_RAD * (1.0 - math.cos(2.0 * math.pi * cycles * PERIOD_S / 10.0))
                epoch = group.exchange([DriveCommand(angle + swing) for angle in start])
                cycles += 1
                incomplete += not epoch.complete
                if warm is None and passed_s >= min(WARM_UP_S, seconds / 2):
                    warm = resident_bytes()
                if cycles % 100 == 0:
                    bar.step(100 * PERIOD_S)
            grown = resident_bytes() - (warm or resident_bytes())
            late = group.statistics.overruns
    return {
        "soak SYNC cycles": figure(cycles, f">= {round(0.95 * seconds / PERIOD_S)}", f"in {seconds / 60:.1f} min"),
        "soak incomplete epochs": figure(incomplete, "== 0"),
        "soak memory grown": figure(grown / 1e6, "<= 5", "MB"),
        "soak periods missed by the clock": figure(late, ">= 0"),
    }
