"""Power cuts and kills while drives are configured, written to and restored: is every original value still known?

Most are played in this process: an operation of the file system or of the bus, drawn at random, is the last one. A kill
leaves the files as they are at that instant. A power cut takes what was not forced to the disk (fsync of the file, and
of the folder after a rename). In half of the cases the drives lose what they hold in memory too.
"""

from __future__ import annotations

import os
import random
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import can

from benchmarks.chaos.killing import few_samples
from benchmarks.chaos.processes import FORK, Job, Master, _restore, drives, restore
from drives.bus import Bus, BusSpec
from drives.configuration.applying import NodeWrites, write_all
from drives.errors import DriveError
from drives.group import DriveGroup, GroupOptions
from drives.ledger import WriteLedger
from drives.pdo import Step
from drives.profile_file import load_profile
from drives.values import AxisSetup
from tests.drives.conftest import Slave, Wire

Address = tuple[int, int]
NODES = (1, 2)
#: Objects that `config apply` writes here, with their values.
APPLIED = {(0x6072, 0): ("u16", (400, 3000)), (0x6007, 0): ("i16", (0, 3)), (0x6065, 0): ("u32", (10, 5000))}


class CutError(BaseException):
    """The process or the computer is gone: nothing handles that."""


@dataclass(slots=True)
class Originals:
    """What came of many interruptions."""

    interrupted: int = 0
    by_kind: dict[str, int] = field(default_factory=dict)
    judged: int = 0
    lost: int = 0
    complaints: list[str] = field(default_factory=list)


class Machine:
    """A computer that stops after a number of operations, with a disk that keeps only what was forced to it.

    Parameters
    ----------
    wire : Wire
    """

    def __init__(self, wire: Wire) -> None:
        self.left = -1
        self.dead = False
        self._wire = wire
        self._send = wire.send
        self._synced: set[int] = set()
        #: What a file held before a rename that is not forced to the disk; None = it was not there.
        self._before: dict[str, bytes | None] = {}

    def _operation(self) -> None:
        if self.dead:
            raise CutError
        if self.left == 0:
            self.dead = True
            raise CutError
        self.left -= 1

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        """Send a frame, or stop before or after it."""
        self._operation()
        self._send(message, timeout)
        self._operation()

    def fsync(self, descriptor: int) -> None:
        """Force a file, or the names of a folder, to the disk."""
        self._operation()
        found = os.fstat(descriptor)
        self._synced.add(found.st_ino)
        if (found.st_mode & 0o170000) == 0o040000:
            self._before.clear()
        self._operation()

    def replace(self, source: Path, target: Path) -> None:
        """Rename a file."""
        self._operation()
        name = str(target)
        if name not in self._before:
            self._before[name] = Path(target).read_bytes() if Path(target).exists() else None
        os.replace(source, target)
        self._operation()

    def lose_power(self, rng: random.Random) -> None:
        """Take what was not forced to the disk: renames, and the content of files."""
        for name, before in self._before.items():
            path = Path(name)
            if rng.random() < 0.5:
                path.unlink() if before is None else path.write_bytes(before)
            elif path.stat().st_ino not in self._synced:
                path.write_bytes(b"")
        self._before.clear()

    @contextmanager
    def running(self, operations: int) -> Generator[None]:
        """Run until so many operations are done; -1 = to the end."""
        self.left, self.dead = operations, False
        shim = SimpleNamespace(**{name: getattr(os, name) for name in dir(os) if not name.startswith("__")})
        shim.fsync, shim.replace = self.fsync, self.replace
        clock = {"monotonic": self._wire.monotonic, "time": self._wire.wall, "sleep": self._wire.sleep}
        with mock.patch("drives.files.os", shim), mock.patch.multiple(time, **clock):
            self._wire.send = self.send  # type: ignore[method-assign]
            try:
                yield
            finally:
                self._wire.send = self._send  # type: ignore[method-assign]


class Bench:
    """Two drives of an engineer, and what is known of their original values."""

    def __init__(self, folder: Path, rng: random.Random) -> None:
        self.path, self.rng = folder / "ledger.json", rng
        self.wire = Wire()
        self.slaves = [Slave(self.wire, node, rng.randint(1, 99) * 10 + node) for node in NODES]
        self.wire.slaves += self.slaves
        for slave in self.slaves:
            for address, (kind, (low, high)) in APPLIED.items():
                slave.types[address], slave.values[address] = kind, rng.randint(low, high)
        self.profile = load_profile("generic-cia402")
        self.stored = [dict(slave.values) for slave in self.slaves]
        #: Values that count as the original of an object; the first is the engineer's.
        self.originals: list[dict[Address, set[int]]] = [
            {address: {value} for address, value in slave.values.items() if _counts(address, slave.values)}
            for slave in self.slaves
        ]
        self._applied: list[dict[Address, int]] = [{}, {}]
        self.machine = Machine(self.wire)

    def group(self, bus: Bus, limit_nm: float | None = None) -> DriveGroup:
        """The drives as a command has them."""
        setups = [AxisSetup(node, self.profile, 0.5, 300.0, torque_limit_nm=limit_nm) for node in NODES]
        return DriveGroup(bus, setups, 0.01, "lockstep", options=GroupOptions(ledger_path=self.path))

    def do(self, what: str, operations: int = -1) -> bool:
        """Do one thing, to its end or until the computer stops; whether it came to its end."""
        work: Callable[[Bus], bool] = {"configure": self._configure, "apply": self._apply, "restore": self._restore}[
            what
        ]
        self.wire.shutdown()
        for slave in self.slaves:
            slave.state, slave.nmt = "switch on disabled", 127
        try:
            with self.machine.running(operations), Bus(self.wire, BusSpec("test", "wire")) as bus:
                return work(bus)
        except CutError:
            return False

    def _configure(self, bus: Bus) -> bool:
        adopting = [dict(values) for values in self._applied]
        for originals, values in zip(self.originals, adopting, strict=True):
            for address, value in values.items():
                originals[address].add(value)
        with self.group(bus, self.rng.choice((0.5, 1.0, 2.0))) as group:
            group.connect()
            try:
                group.configure()
            except DriveError as error:
                if "was interrupted" not in str(error):
                    raise
                return True
        for originals, values in zip(self.originals, adopting, strict=True):
            originals.update({address: {value} for address, value in values.items()})
        self._applied = [{}, {}]
        return True

    def _apply(self, bus: Bus) -> bool:
        wanted = [
            {address: self.rng.randint(*bounds) for address, (_, bounds) in APPLIED.items() if self.rng.random() < 0.7}
            for _ in NODES
        ]
        with self.group(bus) as group:
            group.connect()
            work = [
                NodeWrites(
                    drive.access,
                    tuple(Step(*address, APPLIED[address][0], value, "apply") for address, value in values.items()),
                )
                for drive, values in zip(group.drives, wanted, strict=True)
            ]
            try:
                write_all(work)
            except DriveError as error:
                if "restore CELL" not in str(error):
                    raise
                return True
            except CutError:
                if self._is_marked():
                    self._take_applied(wanted)
                raise
            self._take_applied(wanted)
        return True

    def _take_applied(self, wanted: list[dict[Address, int]]) -> None:
        for held, values in zip(self._applied, wanted, strict=True):
            held.update(values)

    def _is_marked(self) -> bool:
        """The computer stopped after `config apply` was entered as complete."""
        return any(entry.writer == "applied" for entry in WriteLedger(self.path).entries)

    def _restore(self, bus: Bus) -> bool:
        with self.group(bus) as group:
            group.connect()
            group.restore()
        self._applied = [{}, {}]
        return True

    def power_up(self) -> None:
        """The drives lose what they hold in memory; what they start with is then what an engineer finds."""
        for slave, stored, originals in zip(self.slaves, self.stored, self.originals, strict=True):
            slave.values.update(stored)
            for address, values in originals.items():
                values.add(stored[address])
        self._applied = [{}, {}]

    def judge(self, found: Originals, description: str) -> None:
        """Restore without an interruption: every object has to hold an original."""
        try:
            self.do("restore")
        except DriveError as error:
            found.complaints.append(f"{description}: {error}")
        for slave, originals in zip(self.slaves, self.originals, strict=True):
            for address, values in originals.items():
                found.judged += 1
                if slave.values[address] not in values:
                    found.lost += 1
                    found.complaints.append(
                        f"{description}: node {slave.node_id} {address[0]:04X}:{address[1]:02X} holds"
                        f" {slave.values[address]:#x}, original {[hex(value) for value in sorted(values)]}"
                    )


def _counts(address: Address, values: dict[Address, int]) -> bool:
    """Parameters; not what is measured or commanded, nor entries of a mapping beyond its length."""
    index, sub = address
    if 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00:
        return sub <= values[index, 0]
    return index not in (0x6040, 0x6041, 0x603F, 0x6061, 0x6064, 0x606C, 0x6077, 0x6078, 0x607A, 0x60B2)


def cut_in_process(cuts: int, seed: int = 1) -> Originals:
    """Cut short what is done to two drives at random operations.

    Parameters
    ----------
    cuts : int
        How many interruptions.
    seed : int
        Of everything that is drawn.
    """
    found, rng = Originals(), random.Random(f"originals {seed}")
    while found.interrupted < cuts:
        with tempfile.TemporaryDirectory(prefix="originals-") as name:
            bench, description = Bench(Path(name), rng), ""
            for _ in range(rng.randint(1, 4)):
                what = rng.choice(("configure", "apply", "restore"))
                try:
                    completed = bench.do(what, rng.choice((-1, rng.randint(0, 60), rng.randint(0, 700))))
                except DriveError as error:
                    found.complaints.append(f"{description} {what}: {error}")
                    continue
                description += f" {what}{'' if completed else ' cut'}"
                if completed:
                    continue
                kind = rng.choice(("kill", "power cut"))
                found.interrupted += 1
                found.by_kind[f"{kind} in {what}"] = found.by_kind.get(f"{kind} in {what}", 0) + 1
                if kind == "power cut":
                    bench.machine.lose_power(rng)
                    if rng.random() < 0.5:
                        bench.power_up()
            bench.judge(found, description.strip())
    return found


def kill_processes(kills: int, seed: int = 1) -> Originals:
    """SIGKILL real processes that configure or restore the drives of an arm, at random instants.

    Parameters
    ----------
    kills : int
    seed : int
    """
    found, rng = Originals(), random.Random(f"killed {seed}")
    with tempfile.TemporaryDirectory(prefix="originals-") as name:
        folder = Path(name)
        with drives(folder, few_samples) as served:
            before = served.ask("values")
            while found.interrupted < kills:
                job = Job(folder, served.bus, folder / "run.h5")
                master = Master(job)
                master.listen(time.monotonic() + rng.uniform(0.05, 1.0))
                master.kill()
                _count(found, "SIGKILL in configure")
                served.ask("power off")
                if rng.random() < 0.5 and found.interrupted < kills:
                    _kill_restore(job, rng.uniform(0.05, 0.5))
                    _count(found, "SIGKILL in restore")
                answer = restore(job)
                _compare(found, before, served.ask("values"), answer)
                job.path.unlink(missing_ok=True)
                served.ask("renew")
    return found


def _count(found: Originals, kind: str) -> None:
    found.interrupted += 1
    found.by_kind[kind] = found.by_kind.get(kind, 0) + 1


def _kill_restore(job: Job, after_s: float) -> None:
    ours, theirs = FORK.Pipe()
    process = FORK.Process(target=_restore, args=(job, theirs))
    process.start()
    process.join(after_s)
    process.kill()
    process.join()
    ours.close()


def _compare(found: Originals, before: list[dict[Address, Any]], after: list[dict[Address, Any]], answer: str) -> None:
    wrong = [
        (node, address)
        for node, (old, new) in enumerate(zip(before, after, strict=True), start=1)
        for address, value in old.items()
        if new[address] != value
    ]
    found.judged += sum(map(len, before))
    found.lost += len(wrong)
    if wrong or answer != "done":
        found.complaints.append(f"restore: {answer}; {wrong[:5]}")
