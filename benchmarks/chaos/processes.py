"""Drives and master in processes of their own, forked from one that has imported everything, so that a kill is cheap.

Nothing here may start a thread before it forks; the drives' process has threads of its own.
"""

from __future__ import annotations

import errno
import multiprocessing
import os
import resource
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import can

from benchmarks.chaos.rig import Rig, adapters
from benchmarks.chaos.witness import Witness
from drives.bus import BusSpec, open_bus
from drives.errors import DriveError
from drives.group import DriveGroup, GroupOptions
from gateway.acquire.events import Event, VisitDone
from gateway.acquire.planning import plan_of_poses
from gateway.acquire.session import record
from gateway.cell.config import LoadedCell, load_cell
from gateway.data.recording.reader import read
from gateway.data.visit import RestPose
from gateway.errors import GatewayError
from gateway.model.arm_model import arm_named
from gateway.motion.opening import axis_setups, open_arm
from sim.serve import free_bus
from sim.simulation import ServeOptions, Simulation
from sim.states import PdsState

PAIR_EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "pair"
FORK = multiprocessing.get_context("fork")
POSES = 6
#: Below the motion loop's, so that a process on the same core does not delay it.
DRIVES_PRIORITY = 30
ENABLED = PdsState.OPERATION_ENABLED


@contextmanager
def undisturbed() -> Iterator[None]:
    """Processes that are started here run under a real-time scheduler, where that is permitted.

    Drives are devices of their own: other work on this computer does not hold them up.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(DRIVES_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


class Drives:
    """The drives' process, as seen from here.

    Attributes
    ----------
    bus : INTERFACE:CHANNEL[,..] for a master
    loaded : the cell
    """

    def __init__(
        self,
        folder: Path,
        edit: Callable[[str], str],
        bus: str | None = None,
        patience_s: float = 30.0,
        serve: Callable[..., None] | None = None,
        **options: Any,
    ) -> None:
        self.bus = bus or free_bus()
        self._patience_s = patience_s
        self._pipe, theirs = FORK.Pipe()
        self._process = FORK.Process(target=serve or _serve, args=(folder, edit, self.bus, theirs, options))
        with undisturbed():
            self._process.start()
        self.ask("hello")
        self.loaded: LoadedCell = load_cell(folder / "cell.toml")

    def ask(self, *question: Any) -> Any:
        """Have something done there and wait for the answer."""
        self._pipe.send(question)
        if not self._pipe.poll(self._patience_s):
            raise TimeoutError(f"the drives' process does not answer {question}")
        return self._pipe.recv()

    def enabled(self) -> bool:
        """Whether any axis is enabled."""
        return ENABLED in self.ask("states")

    def close(self) -> None:
        """End the process."""
        self._pipe.send(("quit",))
        self._process.join(10.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()


def _serve(folder: Path, edit: Callable[[str], str], bus: str, pipe: Connection, options: Mapping[str, Any]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rig = Rig(folder, edit, bus, **options)
    witness = Witness(rig.server)
    server = rig.server

    def power_off() -> None:
        for drive in server.drives:
            drive.automaton.disable_voltage()

    answers: dict[str, Callable[..., Any]] = {
        "hello": lambda: None,
        "states": lambda: [drive.automaton.state for drive in server.drives],
        "renew": rig.renew,
        "power off": lambda: rig.call(power_off),
        "values": lambda: [dict(drive.store.values) for drive in server.drives],
        "arm": rig.wire.arm_in,
        "begin": rig.arm,
        "sync": lambda: rig.wire.sync,
        "speed": lambda: witness.speed_rad_s,
        "powered": lambda: witness.powered,
        "log": witness.cut,
        "logs": lambda: [witness.cut()],
        "answers": lambda: dict(rig.seen.answers),
    }
    with rig:
        answer(pipe, answers)


def answer(pipe: Connection, answers: Mapping[str, Callable[..., Any]]) -> None:
    """Do what the other end asks for by name, until it says quit."""
    while True:
        name, *arguments = pipe.recv()
        if name == "quit":
            return
        pipe.send(answers[name](*arguments))


def pair_cell(folder: Path, edit: Callable[[str], str]) -> None:
    """The example of two arms in a folder of its own, its text passed through `edit`."""
    for name in ("robot.urdf", "drive.toml", "path.csv"):
        shutil.copy(PAIR_EXAMPLE / name, folder / name)
    (folder / "cell.toml").write_text(edit((PAIR_EXAMPLE / "cell.toml").read_text()))


def serve_pair(
    folder: Path, edit: Callable[[str], str], bus: str, pipe: Connection, options: Mapping[str, Any]
) -> None:
    """Serve two arms with a part between them, as `_serve` serves one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pair_cell(folder, edit)
    simulation = Simulation(folder / "cell.toml", ServeOptions(bus=bus, **options))
    witnesses = [Witness(server) for server in simulation.servers]
    thread = threading.Thread(target=simulation.run, name="pair-rig")
    thread.start()
    try:
        answer(
            pipe,
            {
                "hello": lambda: None,
                "powered": lambda: any(witness.powered for witness in witnesses),
                "speed": lambda: max(witness.speed_rad_s for witness in witnesses),
                "logs": lambda: [witness.cut() for witness in witnesses],
                "grip": simulation.grip,
            },
        )
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


@contextmanager
def drives(folder: Path, edit: Callable[[str], str], bus: str | None = None, **options: Any) -> Iterator[Drives]:
    """A drives' process for the time of a `with` block; `options` as of `Drives`."""
    process = Drives(folder, edit, bus, **options)
    try:
        yield process
    finally:
        process.close()


@dataclass(frozen=True, slots=True)
class Job:
    """What a master process does.

    Attributes
    ----------
    folder : where the cell is
    bus : where the drives are
    path : the recording
    file_limit : largest file it may write, bytes; 0 = no limit
    frames : frames after whose sending the transmit queue stays full; 0 = never
    """

    folder: Path
    bus: str
    path: Path
    file_limit: int = 0
    frames: int = 0

    @property
    def ledger(self) -> Path:
        """Write ledger."""
        return self.folder / "ledger.json"


class Master:
    """A master process that records; it can be killed at any time."""

    def __init__(self, job: Job) -> None:
        self._pipe, theirs = FORK.Pipe()
        self.process: BaseProcess = FORK.Process(target=_record, args=(job, theirs))
        self.process.start()
        theirs.close()
        self.announced: list[tuple[int, int]] = []
        self.moving = False
        self.full_s: float | None = None
        self.end = ""

    def listen(self, until_s: float) -> None:
        """Take in what it says until a time of the monotonic clock, or its end."""
        while (left := until_s - time.monotonic()) > 0 and not self.end:
            if not self._pipe.poll(left):
                return
            try:
                said = self._pipe.recv()
            except (EOFError, ConnectionError):
                self.end = self.end or "gone"
                return
            if isinstance(said, tuple):
                self.announced.append(said)
            elif said == "moving":
                self.moving = True
            elif said == "full":
                self.full_s = time.monotonic()
            else:
                self.end = said

    def kill(self) -> None:
        """SIGKILL, then what it had said before."""
        if self.process.pid is not None and self.process.is_alive():
            os.kill(self.process.pid, signal.SIGKILL)
        self.process.join()
        self.listen(time.monotonic() + 1.0)
        self._pipe.close()

    def wait(self, limit_s: float) -> None:
        """Let it come to its own end."""
        until_s = time.monotonic() + limit_s
        while not self.end and time.monotonic() < until_s:
            self.listen(until_s)
        self.process.join(5.0)
        self.kill()


def poses(count: int = POSES) -> list[RestPose]:
    """Postures close to each other: visits follow quickly, so that kills meet every part of one."""
    return [RestPose(n + 1, tuple(0.05 + 0.02 * (n + i % 3) for i in range(6)), "fit") for n in range(count)]


def _record(job: Job, pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if job.file_limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (job.file_limit, job.file_limit))

    def notify(event: Event) -> None:
        if isinstance(event, VisitDone):
            pipe.send((event.pose, event.direction))

    loaded = load_cell(job.folder / "cell.toml")
    made: list[Any] = []
    try:
        spec = BusSpec.parse(job.bus)
        with (
            adapters(lambda adapter: made.append(adapter) or adapter),
            open_arm(loaded, spec, ledger=job.ledger) as opened,
        ):
            if job.frames:
                block_queue(made[0], job.frames, lambda: pipe.send("full"))
            pipe.send("moving")
            plan = plan_of_poses(loaded, opened.config, opened.workspace, poses())
            record(opened, plan, "none", job.path, read(job.path) if job.path.exists() else None, (notify,))
        pipe.send("done")
    except (DriveError, GatewayError) as error:
        pipe.send(f"error: {type(error).__name__}: {error}")
    except BaseException as error:
        pipe.send(f"DEFECT: {type(error).__name__}: {error}")
    os._exit(0)


def block_queue(adapter: Any, frames: int, notify: Callable[[], None]) -> None:
    """Let the transmit queue of an adapter fill up for ever after so many frames."""
    plain, left = adapter.send, iter(range(frames - 1, -1, -1))

    def send(frame: can.Message, timeout: float | None = None) -> None:
        more = next(left, -1)
        if more == 0:
            notify()
        if more <= 0:
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        plain(frame, timeout)

    adapter.send = send


def restore(job: Job) -> str:
    """Put back what the ledger of a killed master holds, in a process of its own; "done" or what went wrong."""
    ours, theirs = FORK.Pipe()
    process = FORK.Process(target=_restore, args=(job, theirs))
    process.start()
    answer = ours.recv() if ours.poll(30.0) else "no answer"
    process.join(5.0)
    if process.is_alive():
        process.kill()
        process.join()
    return answer


def _restore(job: Job, pipe: Connection) -> None:
    loaded = load_cell(job.folder / "cell.toml")
    config = arm_named(loaded, None)
    options = GroupOptions(ledger_path=job.ledger)
    try:
        with (
            open_bus(BusSpec.parse(job.bus)) as bus,
            DriveGroup(bus, axis_setups(loaded, config), 0.01, options=options) as group,
        ):
            group.connect()
            group.restore()
        pipe.send("done")
    except (DriveError, GatewayError) as error:
        pipe.send(f"error: {error}")
    os._exit(0)


__all__ = ["ENABLED", "POSES", "Drives", "Job", "Master", "drives", "poses", "restore"]
