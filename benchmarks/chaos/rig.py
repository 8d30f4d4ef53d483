"""Six simulated drives behind a faulty wire, and what is seen from their side: states, targets, true answers."""

from __future__ import annotations

import re
import struct
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import can

from drives.bus import BusSpec
from drives.profile_file import PROFILE_FOLDER
from gateway.cell.config import LoadedCell, load_cell
from gateway.motion.opening import OpenArm, open_arm
from sim.fault import Fault
from sim.serve import ServeOptions, Simulation
from sim.states import PdsState
from sim.wire_faults import FaultyWire
from tests.support.rigs.pacing import by_the_clock, in_lockstep

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "small"
#: The generic profile, made to expect one make.
IDENTITY = "[identity]\nvendor_id = 0x0000009A\nproduct_code = 0x00030924\n\n"
#: What the simulated make shows in 0x60FD.
SAFETY = """
[[safety]]
what = "emergency stop"
object = { index = 0x60FD, subindex = 0, type = "u32" }
mask = 0x01000000
good = 0x01000000

[reference]
object = { index = 0x60FD, subindex = 0, type = "u32" }
mask = 0x02000000
good = 0x02000000
"""
#: Bit of the controlword by which mode 7 follows its setpoints: beside the state that is commanded, no stop.
FOLLOW = 0x10
#: TPDO3 of a drive, and the bit of its identifier that says that it is off.
TPDO3, OFF = 2, 1 << 31
#: Fault that is cleared at once: the wire is there, and faults can be armed while it runs.
IDLE = "warning"


@contextmanager
def adapters(take: Callable[[Any], Any]) -> Iterator[None]:
    """Let buses that are opened meanwhile have what `take` returns for their adapter."""
    plain = can.Bus
    with mock.patch("can.Bus", lambda **options: take(plain(**options))):
        yield


@dataclass(slots=True)
class Seen:
    """The drives at each SYNC, before it acts: (SYNC, states, targets, controlwords) and their true answers.

    Beside it, when each SYNC came by the monotonic clock, and the longest time from there to an answer [s].
    """

    states: list[tuple[int, tuple[PdsState, ...], tuple[int, ...], tuple[int, ...]]] = field(default_factory=list)
    answers: dict[tuple[int, int], tuple[int, int]] = field(default_factory=dict)
    came_s: list[float] = field(default_factory=list)
    slowest_s: float = 0.0

    def clear(self) -> None:
        """Forget everything."""
        self.states.clear()
        self.answers.clear()
        self.came_s.clear()
        self.slowest_s = 0.0


@dataclass(frozen=True, slots=True)
class Watched:
    """What a scenario has left in the drives.

    Attributes
    ----------
    seen : Seen
    states : of each drive, now
    unresponsive : whether each is without power
    touched : frames that faults have touched, by kind
    tpdo3_on : drives that send their third TPDO
    torque_limits : 0x6072 of each drive, now
    """

    seen: Seen
    states: tuple[PdsState, ...]
    unresponsive: tuple[bool, ...]
    touched: dict[str, int]
    tpdo3_on: int
    torque_limits: tuple[int, ...] = ()


class Rig:
    """Simulated drives of the small arm in a thread of this process; `options` are further ones of `ServeOptions`.

    What is seen of them grows with every SYNC until `renew`; for a long run, do not `watch`.

    Attributes
    ----------
    bus : a bus of its own, as INTERFACE:CHANNEL
    loaded : the cell
    wire : where faults are armed
    seen : what the drives went through
    """

    def __init__(
        self,
        folder: Path,
        edit: Callable[[str], str] = lambda text: text,
        bus: str | None = None,
        payload: Path | None = None,
        watch: bool = True,
        mode: int = 8,
        **options: Any,
    ) -> None:
        self.bus = bus or f"virtual:rig-{uuid.uuid4().hex}"
        self.loaded = small_cell(folder, edit, mode)
        serve_options = ServeOptions(bus=self.bus, fault=(IDLE,), payload=payload, **options)
        self.simulation = Simulation(folder / "cell.toml", serve_options)
        self.server = self.simulation.servers[0]
        self.wire: FaultyWire = self.server.bus
        self.wire.clear()
        self.seen = Seen()
        if watch:
            self.wire.on_sync = self._on_sync
            self.wire.on_frame = self._on_frame
        self._thread = threading.Thread(target=self.simulation.run, name="rig")

    def __enter__(self) -> Rig:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.simulation.stop()
        self._thread.join()
        self.simulation.close()

    def _on_sync(self, sync: int) -> None:
        drives = self.server.drives
        self.seen.came_s.append(time.monotonic())
        self.seen.states.append(
            (
                sync,
                tuple(drive.automaton.state for drive in drives),
                tuple(
                    drive.motion.record_counts if drive.motion.mode == 7 else drive.motion.target_counts
                    for drive in drives
                ),
                tuple(drive.automaton.controlword & ~FOLLOW for drive in drives),
            )
        )

    def _on_frame(self, sync: int, frame: can.Message) -> None:
        if frame.arbitration_id & 0x780 == 0x180 and len(frame.data) == 8:
            _, position, torque = struct.unpack("<Hih", frame.data)
            if self.seen.came_s:
                self.seen.slowest_s = max(self.seen.slowest_s, time.monotonic() - self.seen.came_s[-1])
            self.seen.answers[sync, frame.arbitration_id & 0x7F] = (position, torque)

    # -- what a scenario asks for; `benchmarks.chaos.remote.Remote` passes it on to another process --

    def sync(self) -> int:
        """Number of the last SYNC on the wire."""
        return self.wire.sync

    def arm(self, fault: Fault) -> None:
        """Let a fault begin now, in the drives' thread."""
        self.call(lambda: self.wire.arm(fault))

    def arm_in(self, fault: Fault, syncs: int) -> None:
        """Let a fault begin after so many more SYNCs."""
        self.wire.arm_in(fault, syncs)

    def all_well(self) -> None:
        """Let every drive say by an emergency message that it has no error."""
        self.server.later(lambda: [drive.node.emergency(0, 0) for drive in self.server.drives])

    def watched(self) -> Watched:
        """What was seen since `renew`, once the drives have followed their commands."""
        self.call(lambda: None)
        drives = self.server.drives
        return Watched(
            Seen(list(self.seen.states), dict(self.seen.answers), list(self.seen.came_s), self.seen.slowest_s),
            tuple(drive.automaton.state for drive in drives),
            tuple(drive.node.unpowered for drive in drives),
            dict(self.wire.touched),
            sum(not drive.tpdos[TPDO3].cob_id & OFF for drive in drives),
            tuple(drive.store.number((0x6072, 0)) for drive in drives),
        )

    def call(self, job: Callable[[], None]) -> None:
        """Have something done in the drives' thread, and wait for it."""
        done = threading.Event()

        def and_report() -> None:
            try:
                job()
            finally:
                done.set()

        self.server.later(and_report)
        if not done.wait(60.0):
            raise TimeoutError("the simulated drives do not answer")

    def renew(self) -> None:
        """No fault on the wire, every drive as after power-up, nothing seen."""
        self.wire.clear()
        self.call(self._renew)
        self.wire.touched.clear()
        self.seen.clear()

    def _renew(self) -> None:
        for drive in self.server.drives:
            drive.repair()
            drive.node.boot()

    @contextmanager
    def open(self, **options: Any) -> Iterator[OpenArm]:
        """The master's side: connected and configured."""
        with open_arm(self.loaded, BusSpec.parse(self.bus), **options) as opened:
            yield opened


def small_cell(folder: Path, edit: Callable[[str], str] = lambda text: text, mode: int = 8) -> LoadedCell:
    """The small example in a folder of its own, its text in lockstep and passed through `edit`; `mode` is 7 or 8."""
    (folder / "robot.urdf").write_text((EXAMPLE / "robot.urdf").read_text())
    profile = (PROFILE_FOLDER / "generic-cia402.toml").read_text().replace("generic-cia402", "named-make", 1)
    profile = re.sub(r"(?m)^eds = .*\n", "", profile)
    profile = profile.replace("[state_machine]\n", f"[state_machine]\ncyclic_mode = {mode}\n")
    profile = profile.replace("allow = [", "allow = [0x60C1,")
    profile = profile.replace("[torque]\n", IDENTITY + "[torque]\n", 1) + SAFETY
    (folder / "drive.toml").write_text(profile)
    text = (EXAMPLE / "cell.toml").read_text().replace('profile = "generic-cia402"', 'profile = "drive.toml"')
    text = edit(in_lockstep(text))
    (folder / "cell.toml").write_text(text)
    return load_cell(folder / "cell.toml")


def with_real_pacing(period_s: float) -> Callable[[str], str]:
    """Edit of a cell's text: SYNC in real time."""

    def edit(text: str) -> str:
        return re.sub(r"sync_period_s = [\d.]+", f"sync_period_s = {period_s}", by_the_clock(text))

    return edit


@contextmanager
def rig(edit: Callable[[str], str] = lambda text: text, mode: int = 8) -> Iterator[Rig]:
    """A rig in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="rig-") as folder, Rig(Path(folder), edit, mode=mode) as made:
        yield made


__all__ = ["Rig", "Seen", "replace", "rig", "small_cell", "with_real_pacing"]
