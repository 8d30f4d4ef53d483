"""A master that is stalled in real time at random instants while it records, and what the drives saw of it."""

from __future__ import annotations

import itertools
import os
import random
import re
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from benchmarks.chaos.processes import FORK, Drives, drives
from benchmarks.chaos.rig import with_real_pacing
from benchmarks.chaos.witness import REST_RAD_S, Track
from drives.bus import BusSpec
from drives.errors import DriveError
from gateway.acquire.planning import plan_of_poses
from gateway.acquire.session import record
from gateway.cell.config import load_cell
from gateway.data.recording.reader import read
from gateway.data.visit import RestPose
from gateway.errors import GatewayError
from gateway.motion.opening import open_arm
from gateway.motion.stops import StopDesk, StoppedByPerson, signals_ask
from gateway.motion.stream import MoveOptions

#: The drives give up after this share of their heartbeat time at the latest in what is tried here.
LONGEST_SHARE = 0.9
LEAST_PERIODS = 2.5
#: Overrun that has to be a stop, and within how many periods of waking the stop word has to be out.
OVERRUN_PERIODS = 2.0
STOP_PERIODS = 2.0
#: Most that measuring may add to a speed.
MEASURING = 1.05
#: One stall in so many comes while the arm is measured, standing; those are no part of what was asked for.
AT_REST_EVERY = 4
#: Looks at the drives, 10 ms apart, in which nothing turns, until the arm counts as standing.
AT_REST_CHECKS = 20
#: Speeds of any joint at which the waiting for a random instant of motion begins.
SLOW_RAD_S, FAST_RAD_S = 0.05, 0.4
RPDO1, SYNC = 0x200, 0x080
#: Longest wait for anything.
PATIENCE_S = 40.0
#: Wide swings: the arm is in motion most of the time.
POSES = [
    RestPose(n + 1, (sign * 0.7, 0.35 * sign, -0.25 * sign, 0.8 * sign, 0.5 * sign, 1.2 * sign), "fit")
    for n, sign in enumerate((1, -1, 1, -1, 1, -1))
]


@dataclass(slots=True)
class Stalls:
    """What came of many stalls.

    Attributes
    ----------
    stalls : how many
    moving : of them, with setpoints being sent and an overrun that has to be a stop
    delayed : of those, without a stop word for every axis within two periods of waking
    share : largest true speed afterwards, as a share of its axis's limit
    fast : stalls after which a joint went beyond its speed limit
    visits, rows, foreign : finished visits, rows in them, values in them that are no answer to their SYNC
    words_s : time from waking to the last axis's stop word, of each that had to stop
    """

    stalls: int = 0
    moving: int = 0
    delayed: int = 0
    share: float = 0.0
    fast: int = 0
    visits: int = 0
    rows: int = 0
    foreign: int = 0
    words_s: list[float] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)


class Recorder:
    """A master process that records into one file after the other, whatever happens, until it is closed."""

    def __init__(self, folder: Path, bus: str) -> None:
        self._pipe, theirs = FORK.Pipe()
        self.process: BaseProcess = FORK.Process(target=_record, args=(folder, bus, theirs))
        self.process.start()
        theirs.close()
        self.files: list[Path] = []
        self.said: list[str] = []
        self.end = ""

    @property
    def pid(self) -> int:
        """Process id."""
        return self.process.pid or 0

    def listen(self) -> None:
        """Take in what it has said."""
        try:
            while self._pipe.poll(0.0):
                kind, text = self._pipe.recv()
                if kind == "file":
                    self.files.append(Path(text))
                elif kind == "end":
                    self.end = text
                else:
                    self.said.append(text)
        except (EOFError, ConnectionError):
            self.end = self.end or "gone"

    def close(self) -> None:
        """Let it end after its present recording."""
        try:
            self._pipe.send("quit")
            os.kill(self.pid, signal.SIGTERM)
        except OSError:
            pass
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.listen()


def _record(folder: Path, bus: str, pipe: Connection) -> None:
    loaded = load_cell(folder / "cell.toml")
    end = "done"
    try:
        while not pipe.poll(0.0):
            _many(loaded, folder, bus, pipe)
    except BaseException as error:
        end = f"DEFECT: {type(error).__name__}: {error}"
    pipe.send(("end", end))
    os._exit(0)


def _many(loaded: Any, folder: Path, bus: str, pipe: Connection) -> None:
    """Open the arm, record again and again; an error that says so has it opened again."""
    try:
        with open_arm(loaded, BusSpec.parse(bus), ledger=folder / "ledger.json") as opened:
            turns = itertools.cycle(
                plan_of_poses(loaded, opened.config, opened.workspace, poses) for poses in (POSES, POSES[1:])
            )
            while not pipe.poll(0.0):
                plan = next(turns)
                path = folder / f"run-{time.monotonic_ns()}.h5"
                desk = StopDesk()
                try:
                    with signals_ask(desk):
                        record(opened, plan, "none", path, None, (), MoveOptions(desk))
                    pipe.send(("said", "finished"))
                except (DriveError, GatewayError) as error:
                    pipe.send(("said", f"{type(error).__name__}: {error}"))
                finally:
                    pipe.send(("file", str(path)))
    except (DriveError, GatewayError) as error:
        pipe.send(("said", f"opened again: {type(error).__name__}: {error}"))
    except StoppedByPerson:
        return


def stall_masters(
    stalls: int, seed: int = 1, period_s: float = 0.01, progress: Callable[[], None] = lambda: None
) -> Stalls:
    """Hold a recording master up at random instants and judge what the drives did.

    Parameters
    ----------
    stalls : int
        How many.
    seed : int
        Of the instants and lengths.
    period_s : float
        SYNC period.
    progress : callable
        Called after each.
    """
    result = Stalls()
    rng = random.Random(f"stalls {seed}")
    real = with_real_pacing(period_s)
    with tempfile.TemporaryDirectory(prefix="stalls-") as name:
        folder = Path(name)
        with drives(folder, lambda text: real(short_visits(text))) as served:
            recorder = Recorder(folder, served.bus)
            try:
                for number in range(stalls):
                    _wait(recorder, served, rng, at_rest=number % AT_REST_EVERY == AT_REST_EVERY - 1)
                    _one(recorder, served, rng, period_s, result)
                    progress()
                    if recorder.end:
                        result.complaints.append(f"the master ended: {recorder.end}")
                        break
            finally:
                recorder.close()
            if recorder.end != "done":
                result.complaints.append(f"the master ended: {recorder.end}")
            result.complaints += [said for said in recorder.said if "MasterStalled" not in said and said != "finished"]
            _judge_rows(recorder.files, served.ask("answers"), result)
    return result


def short_visits(text: str) -> str:
    """Edit of a cell's text: short visits; the period stays."""
    return re.sub(r"samples = \d+", "samples = 60", text)


def _wait(recorder: Recorder, served: Drives, rng: random.Random, *, at_rest: bool) -> None:
    """Until a random instant at which the arm is in motion, or rests and is measured."""
    least_rad_s = rng.choice((SLOW_RAD_S, FAST_RAD_S))
    _until(recorder, lambda: served.ask("speed") > least_rad_s)
    if at_rest:
        looks = [True] * AT_REST_CHECKS

        def is_at_rest() -> bool:
            looks.append(served.ask("speed") > REST_RAD_S)
            return not any(looks[-AT_REST_CHECKS:])

        _until(recorder, is_at_rest)
        time.sleep(rng.uniform(0.0, 0.3))
    else:
        time.sleep(rng.uniform(0.0, 0.8))


def _until(recorder: Recorder, seen: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not seen() and time.monotonic() < until_s and not recorder.end:
        time.sleep(0.01)
        recorder.listen()


def _one(recorder: Recorder, served: Drives, rng: random.Random, period_s: float, result: Stalls) -> None:
    """One stall while the arm is in motion."""
    length_s = rng.uniform(LEAST_PERIODS * period_s, LONGEST_SHARE * heartbeat_time_s(served))
    served.ask("log")
    time.sleep(0.1)
    os.kill(recorder.pid, signal.SIGSTOP)
    asleep_s = time.monotonic()
    time.sleep(length_s)
    woken_s = time.monotonic()
    os.kill(recorder.pid, signal.SIGCONT)
    time.sleep(1.0)
    track: Track = served.ask("log")
    recorder.listen()
    result.stalls += 1
    _judge(track, asleep_s, woken_s, period_s, result)


def heartbeat_time_s(served: Drives) -> float:
    """Return the time after which the drives of a rig stop for a missing master."""
    text = (served.loaded.folder / "drive.toml").read_text()
    found = re.search(r"consumer_ms = (\d+)", text)
    if found is None:
        raise ValueError("the profile states no heartbeat time")
    return 1e-3 * int(found.group(1))


def _judge(track: Track, asleep_s: float, woken_s: float, period_s: float, result: Stalls) -> None:
    share = track.share(asleep_s)
    result.share = max(result.share, share)
    result.fast += share > MEASURING
    syncs = [at for at, number, _ in track.frames if number == SYNC and at < woken_s]
    overrun = (woken_s - syncs[-1]) / period_s - 1.0 if syncs else 0.0
    if overrun <= OVERRUN_PERIODS or not _is_moving(track, woken_s):
        return
    result.moving += 1
    words = [
        min((at for at, data in track.sent(RPDO1 + node, woken_s) if stops(data)), default=float("inf"))
        for node in range(1, 7)
    ]
    took_s = max(words) - woken_s
    result.words_s.append(took_s)
    if took_s > STOP_PERIODS * period_s:
        result.delayed += 1
        result.complaints.append(
            f"stalled for {woken_s - asleep_s:.3f} s, overrun {overrun:.2f} periods: stop word after {took_s:.4f} s"
        )


def stops(data: bytes) -> bool:
    """Whether a controlword takes OPERATION ENABLED away: quick stop or disable voltage."""
    return data[0] & 0x06 != 0x06


def _is_moving(track: Track, before_s: float) -> bool:
    """Whether the last two setpoints of an axis before a time differ."""
    for node in range(1, 7):
        frames = [data for at, number, data in track.frames if number == RPDO1 + node and at < before_s]
        if len(frames) >= 2 and all(data[0] & 0x0F == 0x0F for data in frames[-2:]) and frames[-1] != frames[-2]:
            return True
    return False


def _judge_rows(files: list[Path], answers: dict[tuple[int, int], tuple[int, int]], result: Stalls) -> None:
    """Every value of a finished visit has to be what its drive had answered to that SYNC."""
    for path in files:
        if not path.exists():
            continue
        for arm in read(path).arms:
            for visit in arm.visits:
                if not visit.complete:
                    continue
                result.visits += 1
                for row, sync in enumerate(visit.sync_index.tolist()):
                    result.rows += 1
                    for axis in range(6):
                        value = (int(visit.position_count[row, axis]), int(visit.torque_word[row, axis]))
                        result.foreign += answers.get((sync, axis + 1)) != value
