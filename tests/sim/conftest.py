"""A master of raw frames, and simulated arms, for the tests of the simulator."""

from __future__ import annotations

import struct
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest

from sim.cellfile import ArmSpec, read_cell
from sim.engine import Engine
from sim.fake_drive import FakeDrive
from sim.nominal import plant_of
from sim.pair.geometry import ArmGeometry
from sim.pair.pair_errors import GEAR_STIFFNESS_NM_RAD, ArmSheet
from sim.pair.two_arms import TwoArms
from sim.physics import ArmWorld
from sim.plant import Plant
from sim.serve import RunningSimulation, running
from sim.urdf import translation, turn

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
Start = Callable[..., AbstractContextManager[tuple["Master", RunningSimulation]]]
CODES = {1: "B", 2: "H", 4: "I"}
SMALL = EXAMPLES / "small" / "cell.toml"
STANDARD_TPDO1 = (0x60410010, 0x60640020, 0x60770010)
STANDARD_RPDO1 = (0x60400010, 0x607A0020, 0x60B20010)


class Aborted(Exception):  # noqa: N818
    """An SDO abort with its code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class Master:
    """Raw CANopen frames, written from CiA 301 for these tests alone."""

    Aborted = Aborted

    def __init__(self, channel: str, interface: str = "virtual", **options: int) -> None:
        self.bus = can.Bus(interface=interface, channel=channel, **options)
        self.seen: list[can.Message] = []

    def send(self, can_id: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def wait(self, can_id: int, timeout_s: float = 30.0) -> bytes:
        """Next frame with that identifier; everything else is kept in `seen`.

        It is long since the computer may be busy: only a test that fails waits for it.
        """
        end = time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0:
            frame = self.bus.recv(left)
            if frame is None:
                break
            if frame.arbitration_id == can_id:
                return bytes(frame.data)
            self.seen.append(frame)
        raise AssertionError(f"no frame 0x{can_id:03X} within {timeout_s} s")

    def request(self, node: int, data: bytes) -> bytes:
        self.send(0x600 + node, data.ljust(8, b"\x00"))
        answer = self.wait(0x580 + node)
        if answer[0] == 0x80:
            raise Aborted(struct.unpack_from("<I", answer, 4)[0])
        return answer

    def read(self, node: int, index: int, sub: int = 0) -> bytes:
        """Upload, expedited or segmented."""
        answer = self.request(node, struct.pack("<BHB", 0x40, index, sub))
        if answer[0] & 0x02:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        size, data, toggle = struct.unpack_from("<I", answer, 4)[0], b"", 0
        while len(data) < size:
            answer = self.request(node, bytes([0x60 | toggle]))
            assert answer[0] & 0x10 == toggle
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            toggle ^= 0x10
            if answer[0] & 1:
                break
        assert len(data) == size
        return data

    def number(self, node: int, index: int, sub: int = 0, signed: bool = False) -> int:
        return int.from_bytes(self.read(node, index, sub), "little", signed=signed)

    def write(self, node: int, index: int, sub: int, value: int, size: int) -> None:
        """Expedited download."""
        head = struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub)
        self.request(node, head + (value & (1 << 8 * size) - 1).to_bytes(size, "little"))

    def map(self, node: int, number: int, entries: tuple[int, ...], sync_type: int, *, receive: bool = False) -> int:
        """Write one PDO map; returns the identifier."""
        com, table = (0x1400, 0x1600) if receive else (0x1800, 0x1A00)
        can_id = (0x200 if receive else 0x180) + 0x100 * number + node
        self._write_unless_fixed(node, com + number, 1, 0x80000000 | can_id, 4)
        self.write(node, table + number, 0, 0, 1)
        for sub, entry in enumerate(entries, start=1):
            self.write(node, table + number, sub, entry, 4)
        self.write(node, table + number, 0, len(entries), 1)
        self._write_unless_fixed(node, com + number, 2, sync_type, 1)
        self._write_unless_fixed(node, com + number, 1, can_id, 4)
        return can_id

    def _write_unless_fixed(self, *arguments: int) -> None:
        try:
            self.write(*arguments)
        except Aborted as aborted:
            if aborted.code != 0x06010002:  # read-only
                raise

    def configure(self, node: int, mode: int) -> None:
        """TPDO1 and RPDO1 as the gateway has them, mode, OPERATIONAL."""
        self.map(node, 0, STANDARD_TPDO1, 1)
        self.map(node, 0, STANDARD_RPDO1, 1, receive=True)
        self.write(node, 0x6060, 0, mode, 1)
        self.send(0x000, bytes([1, node]))

    def cycle(self, node: int, controlword: int, target: int, offset: int = 0) -> tuple[int, int, int]:
        """One SYNC with one drive: statusword, position, torque."""
        self.send(0x200 + node, struct.pack("<Hih", controlword, target, offset))
        self.send(0x080, b"")
        return struct.unpack("<Hih", self.wait(0x180 + node))

    def sync(self, times: int = 1) -> None:
        for _ in range(times):
            self.send(0x080, b"")

    def enable(self, node: int, cycles: int = 30) -> int:
        """Walk to OPERATION ENABLED where the axis is; returns its position."""
        position = self.number(node, 0x6064, signed=True)
        for word in (0x06, 0x07, *[0x0F] * cycles):
            status, _, _ = self.cycle(node, word, position)
        assert status & 0x6F == 0x27
        return position

    def drain(self) -> list[can.Message]:
        """Everything that the drives have sent: they serve frames in order, so an answer of node 1 comes last."""
        self.read(1, 0x1000)
        frames, self.seen = self.seen, []
        return frames


@pytest.fixture
def channel() -> str:
    return f"sim-{uuid.uuid4().hex}"


@contextmanager
def mastered(channel: str, **options: object) -> Iterator[tuple[Master, RunningSimulation]]:
    """Simulated drives on a virtual bus, and a master."""
    with running(SMALL, f"virtual:{channel}", **options) as simulation:
        master = Master(channel)
        try:
            yield master, simulation
        finally:
            master.bus.shutdown()


@pytest.fixture
def drives(channel: str) -> Iterator[tuple[Master, RunningSimulation]]:
    """The small arm's six drives on a virtual bus, and a master."""
    with mastered(channel, pacing="lockstep") as both:
        yield both


@pytest.fixture
def start(tmp_path: Path, channel: str) -> Start:
    """Drives of which node 2 has a fault from the beginning: `start(kind, key=value)`."""

    @contextmanager
    def begin(kind: str, pacing: str = "lockstep", timing: Path | None = None, **keys: float):
        scenario = tmp_path / "fault.toml"
        more = "\n".join(f"{key} = {value}" for key, value in keys.items())
        scenario.write_text(f'[[fault]]\nkind = "{kind}"\nnode = 2\n{more}\n', encoding="utf-8")
        with mastered(channel, fault=(scenario,), pacing=pacing, timing=timing) as both:
            yield both

    return begin


def drive_of(simulation: RunningSimulation, node: int = 2) -> FakeDrive:
    assert simulation.simulation is not None
    return simulation.simulation.servers[0].drive(node)


@pytest.fixture
def master_on() -> Iterator[Callable[[str], Master]]:
    """Masters on virtual channels, closed after the test."""
    masters: list[Master] = []

    def build(channel: str) -> Master:
        masters.append(Master(channel))
        return masters[-1]

    yield build
    for master in masters:
        master.bus.shutdown()


@pytest.fixture(scope="session")
def arm_of() -> Callable[[str], ArmSpec]:
    """Arm of an example cell by name."""
    cells = {name: read_cell(EXAMPLES / name / "cell.toml") for name in ("large", "small")}
    return lambda name: cells[name].arms[0]


def ideal(arm: ArmSpec, **fields: object) -> Plant:
    """The arm with ideal gears and sensors, but for the given fields."""
    nominal = plant_of(arm)
    zero = np.zeros(6)
    plain = replace(
        nominal,
        stiction_nm=zero,
        coulomb_nm=zero,
        viscous_nm_s_rad=zero,
        creep_rad_s=zero,
        friction_scatter=zero,
        gear_efficiency=np.ones(6),
        reading_noise_nm=zero,
    )
    return replace(plain, **fields)


def torques(engine: Engine, q: np.ndarray, qd: np.ndarray | float = 0.0, qdd: np.ndarray | float = 0.0) -> np.ndarray:
    """Joint torques that a motion needs by an engine, which ends here."""
    with engine:
        return engine.needed_nm(*(np.broadcast_to(each, q.shape) for each in (q, qd, qdd)))


def reference_arms() -> tuple[ArmSheet, ArmSheet]:
    """The two equal arms of the example of a pair, 1.9 m apart along x, facing each other."""
    d_m, a_m = np.array([0.45, 0.0, 0.0, 0.64, 0.0, 0.10]), np.array([0.15, 0.60, 0.10, 0.0, 0.0, 0.0])
    alpha_rad, tool = np.deg2rad([90.0, 0.0, -90.0, 90.0, -90.0, 0.0]), translation(0.0, 0.0, 0.15)
    ratio = np.array([120.0, 120.0, 100.0, 80.0, 80.0, 50.0])
    bases = np.eye(4), translation(1.9, 0.0, 0.0) @ turn("z", np.pi)
    arms = (ArmGeometry(d_m, a_m, alpha_rad, np.zeros(6), base, tool) for base in bases)
    first, second = (ArmSheet(arm, GEAR_STIFFNESS_NM_RAD, ratio) for arm in arms)
    return first, second


def power(world: TwoArms) -> None:
    for axis in world.motors.axes:
        axis.release()


def go(world: TwoArms, seconds: float, sync_s: float = 0.004) -> None:
    """SYNCs of both buses, in step."""
    for _ in range(round(seconds / sync_s)):
        world.ask(0, sync_s)
        world.ask(1, sync_s)


@pytest.fixture
def world_of(arm_of) -> Iterator[Callable[..., ArmWorld]]:
    """Build worlds of the example arms: `world_of(name, **plant fields)`; closed after the test."""
    worlds: list[ArmWorld] = []

    def build(name: str, arm: ArmSpec | None = None, **fields: object) -> ArmWorld:
        spec = arm or arm_of(name)
        worlds.append(ArmWorld(spec, ideal(spec, **fields), seed=1))
        return worlds[-1]

    yield build
    for world in worlds:
        world.close()
