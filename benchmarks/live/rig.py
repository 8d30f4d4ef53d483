"""Simulated drives, a command that moves them, and pages that look on; each in a process of its own."""

from __future__ import annotations

import functools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import can
from websockets.sync.client import connect

from benchmarks.chaos.processes import undisturbed
from drives.bus_spec import BusSpec
from tests.support.rigs.pacing import by_the_clock, in_lockstep

SMALL = Path(__file__).parents[2] / "examples" / "small"
PATIENCE_S = 60.0
#: SYNC period of the small cell [s].
PERIOD_S = 0.01
ADDRESS = re.compile(r"live page: (http\S+)")
POSES = """[poses]
count = {count}
approach_offset_rad = 0.03
approach_speed_rad_s = 0.1
samples = 60
validation = 2
seed = 2
"""


def cell_in(folder: Path, pacing: str, poses: int) -> Path:
    """The small cell with so many poses, paced as asked, in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text((SMALL / "robot.urdf").read_text())
    text = (SMALL / "cell.toml").read_text()
    text = (in_lockstep if pacing == "lockstep" else by_the_clock)(text[: text.index("[poses]")])
    path = folder / "cell.toml"
    path.write_text(text + POSES.format(count=poses))
    return path


@functools.cache
def port_of(folder: Path) -> int:
    """A UDP port for the runs in a folder, the same for all of them: what was proven of the drives holds there."""
    del folder
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass
class Command:
    """A running command of the gateway.

    Attributes
    ----------
    process : subprocess.Popen
    said : list of str
        Lines that it has printed so far.
    """

    process: subprocess.Popen[str]
    said: list[str] = field(default_factory=list)

    def read(self) -> None:
        """Keep what it prints."""
        for line in self.process.stdout or ():
            self.said.append(line)

    @property
    def text(self) -> str:
        """All that was printed."""
        return "".join(self.said)

    def address(self) -> str:
        """Of the live page."""
        wait_for(lambda: ADDRESS.search(self.text) or self.process.poll() is not None)
        found = ADDRESS.search(self.text)
        if found is None:
            raise RuntimeError(f"no live page:\n{self.text}")
        return found[1]

    def page_pid(self) -> int:
        """Number of the process of the page."""
        for place in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                parent = int((place / "stat").read_text().rpartition(")")[2].split()[1])
                if parent == self.process.pid and b"gateway.live.page_process" in (place / "cmdline").read_bytes():
                    return int(place.name)
        raise RuntimeError(f"the page has no process:\n{self.text}")

    def moving(self) -> None:
        """Wait until the run itself moves, after all proofs."""
        wait_for(lambda: "visit" in self.text or self.process.poll() is not None)
        if self.process.poll() is not None:
            raise RuntimeError(f"it has not moved:\n{self.text}")


def wait_for(what, patience_s: float = PATIENCE_S) -> None:
    """Wait until something is so."""
    until_s = time.monotonic() + patience_s
    while not what():
        if time.monotonic() > until_s:
            raise TimeoutError
        time.sleep(0.02)


def surroundings(folder: Path) -> dict[str, str]:
    """Environment of the programs that run in a folder."""
    return os.environ | {
        "XDG_STATE_HOME": str(folder / "state"),
        "PYTHONPATH": os.pathsep.join(sys.path),
        "COLUMNS": "400",
    }


@contextmanager
def drives(folder: Path, cell: Path) -> Iterator[str]:
    """Simulated drives of their own; the bus that they are on."""
    bus = f"udp_multicast:239.74.163.11,port={port_of(folder)}"
    with ExitStack() as stack:
        with undisturbed():
            process = subprocess.Popen(
                [sys.executable, "-m", "sim", "serve", str(cell), "--bus", bus],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env=surroundings(folder),
            )
        stack.callback(end, process)
        assert process.stdout is not None
        process.stdout.readline()
        yield bus


@contextmanager
def running(folder: Path, *wanted: str) -> Iterator[Command]:
    """A command of the gateway; ended, if it has not, when this is left."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from gateway.cli import main; main()", *wanted],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=surroundings(folder),
    )
    command = Command(process)
    threading.Thread(target=command.read, daemon=True).start()
    try:
        yield command
    finally:
        end(process)


@contextmanager
def recording(folder: Path, cell: Path, *more: str) -> Iterator[Command]:
    """`record` on drives of its own."""
    (folder / "run.h5").unlink(missing_ok=True)
    with drives(folder, cell) as bus:
        wanted = ["record", str(cell), "--bus", bus, "--load", "none", "-o", str(folder / "run.h5"), "--yes", "-v"]
        with running(folder, *wanted, *more) as command:
            yield command


@contextmanager
def frames_of(bus: str) -> Iterator[list[can.Message]]:
    """Frames of a bus as they come, with the wall clock."""
    spec = BusSpec.parse(bus)
    received: list[can.Message] = []
    with can.Bus(interface=spec.interface, channel=spec.channel, fd=False, **spec.options) as adapter:
        notifier = can.Notifier(adapter, [received.append])
        try:
            yield received
        finally:
            notifier.stop()


def end(process: subprocess.Popen[str]) -> None:
    """End a process of ours."""
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGINT)
    try:
        process.wait(20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def viewers(address: str, count: int, *, read: bool) -> Iterator[list[int]]:
    """So many open pages without a browser, which read what they are sent or do not; how many words each has read."""
    words = [0] * count
    place, _, token = address.partition("/?token=")
    target = f"ws{place.removeprefix('http')}/feed?token={token}"
    with ExitStack() as stack:
        sockets = [stack.enter_context(connect(target, max_queue=None if read else 1)) for _ in range(count)]

        def listen(number: int) -> None:
            with suppress(Exception):
                for _ in sockets[number]:
                    words[number] += 1

        if read:
            for number in range(count):
                threading.Thread(target=listen, args=(number,), daemon=True).start()
        yield words


def processor_s(pid: int) -> float:
    """Processor time that a process has taken [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Counted:
    """SYNCs of a run of `period_s` each, and how many of them were not answered whole."""

    syncs: int
    incomplete: int
    period_s: float

    @property
    def per_10_min(self) -> float:
        """Incomplete ones in ten minutes."""
        return 600.0 * self.incomplete / max(self.syncs * self.period_s, 1e-9)


def counted(path: Path) -> Counted:
    """Of `record --json`."""
    statistics = json.loads(path.read_text())["statistics"]
    return Counted(int(statistics["cycles"]), int(statistics["incomplete"]), PERIOD_S)
