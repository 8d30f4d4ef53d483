"""What the cyclic part costs: epochs in lockstep, jitter in real time, function evaluation."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.pair.bus_rig import CELL, pair_rig
from drives.errors import DriveError
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions
from gateway.pair.pair_cell import PairCell, load_pair
from gateway.pair.session import PairLink, open_link
from gateway.pair.transform_function import function_of_knots
from sim.pair.cell import PLANTS
from sim.pair.two_arms import TwoArms
from sim.serve import free_bus
from sim.simulation import ServeOptions, Simulation
from tests.support.rigs.pacing import by_the_clock as by_the_clock_text

CYCLES = 100_000
REAL_S = 20.0


class Still(TwoArms):
    """Arms that do not move, whatever time passes."""

    def _stretch(self, ticks: float) -> None:
        self.time_s = round(self.time_s + 0.001 * ticks, 6)


#: The plant of PyBullet without its physics.
STILL = mock.patch.dict(PLANTS, bullet=Still)


def _serve(cell_file: Path, bus: str, ready: Any, stop: Any) -> None:
    """Simulated drives in a process of their own, without physics, until `stop`."""
    with STILL:
        simulation = Simulation(cell_file, ServeOptions(bus=bus), plant="bullet")
    thread = threading.Thread(target=simulation.run)
    thread.start()
    ready.set()
    stop.wait()
    simulation.stop()
    thread.join()
    simulation.close()


@contextmanager
def _served(cell_file: Path, bus: str) -> Iterator[None]:
    context = multiprocessing.get_context("spawn")
    ready, stop = context.Event(), context.Event()
    process = context.Process(target=_serve, args=(cell_file, bus, ready, stop))
    process.start()
    try:
        if not ready.wait(60.0):
            raise RuntimeError("the simulated drives did not start")
        yield
    finally:
        stop.set()
        process.join(10.0)


def lockstep(cycles: int = CYCLES) -> dict[str, Any]:
    """Twelve drives, both buses in lockstep, the arms held: the physics is left out, the drives are not."""
    with STILL, pair_rig(None) as rig, powered(rig.link.stream(rig.cell, MoveOptions())) as stream:
        before = rig.link.statistics().incomplete
        began = time.perf_counter()
        for cycle in range(cycles):
            stream.hold("hold", cycle, cycles)
        took_s = time.perf_counter() - began
        after = rig.link.statistics().incomplete
    return {"cycles": cycles, "incomplete": sum(after) - sum(before), "cycle_s": took_s / cycles}


def by_the_clock(seconds: float = REAL_S) -> dict[str, Any]:
    """Both arms held at a 4 ms SYNC in real time; the simulated drives in another process, without physics."""
    with TemporaryDirectory() as folder:
        for name in ("robot.urdf", "path.csv", "drive.toml"):
            (Path(folder) / name).write_text((CELL.parent / name).read_text())
        cell_file = Path(folder) / "cell.toml"
        cell_file.write_text(by_the_clock_text(CELL.read_text()))
        bus = f"left={free_bus()};right={free_bus()}"
        with _served(cell_file, bus):
            cell = load_pair(cell_file, bus)
            with open_link(cell) as link:
                return _clocked(cell, link, round(seconds / cell.sync_period_s))


def _clocked(cell: PairCell, link: PairLink, wanted: int) -> dict[str, Any]:
    """Hold both arms for some cycles; a machine that is too busy for 4 ms ends it early, and that is reported."""
    cycles, delayed, ended = 0, 0, ""
    try:
        with powered(link.stream(cell, MoveOptions())) as stream:
            link.together.skew_s.clear()
            for _ in range(wanted):
                samples = stream.hold("hold", cycles, wanted)
                delayed += not all(sample.complete for sample in samples)
                cycles += 1
    except DriveError as error:
        ended = str(error)
    groups = [opened.group.statistics for opened in link.opened]
    skew = np.abs(link.together.skew_s) if link.together.skew_s else np.full(1, np.nan)
    return {
        "cycles": cycles,
        "wanted": wanted,
        "ended": ended,
        "late_share": delayed / max(cycles, 1),
        "jitter_p50_s": max(group.jitter_p50_s or 0.0 for group in groups),
        "jitter_p99_s": max(group.jitter_p99_s or 0.0 for group in groups),
        "skew_p50_s": float(np.median(skew)),
        "skew_p99_s": float(np.percentile(skew, 99.0)),
        "load_percent": max(group.bus_load_planned_percent for group in groups),
    }


def evaluation_s(count: int = 20, times: int = 20_000) -> float:
    """One evaluation of a transform function with `count` knots."""
    shares = np.linspace(0.0, 1.0, count)
    function = function_of_knots(shares, np.tile(np.eye(4), (count, 1, 1)))
    at = np.random.default_rng(0).uniform(0.0, 1.0, times).tolist()
    began = time.perf_counter()
    for share in at:
        function.at(share)
    return (time.perf_counter() - began) / times
