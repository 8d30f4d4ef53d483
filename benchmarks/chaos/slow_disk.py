"""A recording to a disk that is slow: motion goes on until the queue is full, then it stops along its path."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.chaos.killing import few_samples, visits_on_disk
from benchmarks.chaos.processes import FORK, drives, poses
from benchmarks.chaos.programs import disturbed
from benchmarks.chaos.rig import with_real_pacing
from benchmarks.chaos.witness import Ending, Track
from drives.bus import BusSpec
from drives.errors import DriveError
from gateway.acquire import session
from gateway.acquire.events import Event, VisitDone
from gateway.acquire.planning import plan_of_poses
from gateway.acquire.session import record
from gateway.cell.config import load_cell
from gateway.data.recording.queue import CAPACITY, VisitQueue
from gateway.data.recording.writer import write_recording
from gateway.errors import GatewayError
from gateway.motion.opening import open_arm

SYNC = 0x080
#: How often it is tried again where this computer was too busy with something else.
TRIES = 4
COMPLETE = "all poses measured"


def slow_write(write_s: float, path: Path, content: bytes) -> None:
    """Put content in the place of a file, as a disk does that has other things to do; takes `write_s` longer."""
    time.sleep(write_s)
    write_recording(path, content)


@dataclass(slots=True)
class SlowDisk:
    """What came of a recording to a slow disk.

    Attributes
    ----------
    taken, announced, lost : visits that were finished, reported to be on disk, and of those missing at the end
    went_on : most visits that were waiting for the disk
    said : why it ended
    full : the arm was stopped because the disk is too slow
    latest_s : largest time between two SYNCs less the period
    ending : how the axes came to rest
    """

    taken: int = 0
    announced: int = 0
    lost: int = 0
    went_on: int = 0
    said: str = ""
    full: bool = False
    latest_s: float = 0.0
    ending: Ending | None = None
    complaints: list[str] = field(default_factory=list)


def record_on_slow_disk(write_s: float, period_s: float = 0.01, capacity: int = CAPACITY, visits: int = 24) -> SlowDisk:
    """Record in real time to a slow disk.

    Parameters
    ----------
    write_s : float
        What a write takes [s].
    period_s : float
        SYNC period.
    capacity : int
        Visits that may wait for the disk.
    visits : int
        How many are asked for.
    """
    result = _tried(write_s, period_s, capacity, visits)
    for _ in range(TRIES - 1):
        if not disturbed(result.said):
            break
        result = _tried(write_s, period_s, capacity, visits)
    return result


def _tried(write_s: float, period_s: float, capacity: int, visits: int) -> SlowDisk:
    result = SlowDisk()
    real = with_real_pacing(period_s)
    with tempfile.TemporaryDirectory(prefix="slow-disk-") as name:
        folder = Path(name)
        with drives(folder, lambda text: real(few_samples(text))) as served:
            ours, theirs = FORK.Pipe()
            process = FORK.Process(target=_record, args=(folder, served.bus, (write_s, capacity, visits), theirs))
            process.start()
            theirs.close()
            announced: set[tuple[int, int]] = set()
            while not result.said and ours.poll(120.0):
                kind, value = ours.recv()
                if kind == "visit":
                    announced.add(value)
                elif kind == "end":
                    result.said, result.taken, result.went_on = value
            process.join(10.0)
            _judge(served.ask("log"), period_s, result)
            kept = visits_on_disk(folder / "run.h5")
        result.announced, result.lost = len(announced), len(announced - kept) + max(0, result.taken - len(kept))
    if result.lost:
        result.complaints.append(f"{result.taken} visits were finished, {len(kept)} are on disk: {result.said}")
    result.full = "wait for the disk" in result.said
    if not result.full and result.said != COMPLETE:
        result.complaints.append(result.said or "no end")
    return result


def _judge(track: Track, period_s: float, result: SlowDisk) -> None:
    syncs = [at for at, number, _ in track.frames if number == SYNC]
    powered = track.time_s[track.energised.all(axis=1)]
    gaps = [
        after - before
        for before, after in zip(syncs, syncs[1:], strict=False)
        if len(powered) and powered[0] < before < powered[-1]
    ]
    result.latest_s = max(gaps, default=0.0) - period_s
    result.ending = track.ending(0.0)
    if not result.ending.over or result.ending.dropped_moving:
        result.complaints.append(f"axes: {result.ending}")


def _record(folder: Path, bus: str, how: tuple[float, int, int], pipe: Connection) -> None:
    write_s, capacity, visits = how
    counted: list[VisitQueue] = []
    most: list[int] = [0]

    def queue(*arguments: Any) -> VisitQueue:
        counted.append(VisitQueue(*arguments, capacity=capacity, write=partial(slow_write, write_s)))
        return counted[-1]

    def notify(event: Event) -> None:
        most[0] = max(most[0], counted[-1].waiting)
        if isinstance(event, VisitDone):
            pipe.send(("visit", (event.pose, event.direction)))

    session.VisitQueue = queue  # type: ignore[misc, assignment]
    loaded = load_cell(folder / "cell.toml")
    said = COMPLETE
    try:
        with open_arm(loaded, BusSpec.parse(bus), ledger=folder / "ledger.json") as opened:
            near = [replace(pose, number=number) for number, pose in enumerate(poses(visits // 2), start=1)]
            plan = plan_of_poses(loaded, opened.config, opened.workspace, near)
            record(opened, plan, "none", folder / "run.h5", None, (notify,))
    except (DriveError, GatewayError) as error:
        said = " ".join([str(error), *getattr(error, "__notes__", [])])
    except BaseException as error:
        said = f"DEFECT: {type(error).__name__}: {error}"
    pipe.send(("end", (said, counted[-1].visits if counted else 0, most[0])))
    pipe.close()
