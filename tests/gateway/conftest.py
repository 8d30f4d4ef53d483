"""An arm without a bus: six drives that answer as a drive group does, with gravity, a friction band and noise."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from drives.cia402 import State
from drives.drive import DriveCommand, DriveReading
from drives.epoch import Epoch
from drives.errors import DriveFault
from drives.gate import ArmState, DriveState
from drives.profile_file import load_profile
from drives.scaling import Constants, motor_scale
from gateway.cell.config import LoadedCell, parse_cell
from gateway.cell.conversion import AxisConversion
from gateway.model.arm_model import arm_robot
from gateway.motion.arm import Arm
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.workspace import Workspace, workspace_of
from tests.data.arms import urdf_of
from tests.support.rigs.pacing import in_lockstep

ENABLED = 0x1237
CONSTANTS = Constants(torque_rated=2.0, current_rated_a=4.0, offset_rated=None, counts_per_revolution=131072.0)


class FakeDrives:
    """Joint positions follow their targets one SYNC later; torque is gravity plus a band by the last motion.

    Attributes
    ----------
    log : list of str
        What was asked, without the SYNCs.
    log_of_parts : list of str
        Parts of SYNCs that several arms share.
    unanswered : dict of int to int
        SYNC -> axis (from 0) that does not answer it.
    fault_at, jam_at : int or None
        SYNC of a drive fault; SYNC from which joint 2 no longer follows.
    contact_nm : dict of int to float
        SYNC -> torque that joint 3 shows from there on, on top.
    swing_nm : float
        Amplitude of an oscillation of joint 5's torque that never ends.
    """

    def __init__(self, axes: AxisConversion, gravity, band_nm: np.ndarray, noise_nm: float = 0.0) -> None:
        self.axes = axes
        self.scale = motor_scale(load_profile("generic-cia402"), CONSTANTS, 1.0)
        self.gravity = gravity
        self.band_nm = band_nm
        self.noise_nm = noise_nm
        self.random = np.random.default_rng(5)
        self.log: list[str] = []
        self.log_of_parts: list[str] = []
        self.sync_index = 0
        self.enabled = False
        self.q_rad = np.zeros(6)
        self.target_rad = np.zeros(6)
        self.direction = np.zeros(6)
        self.path: list[np.ndarray] = []
        self.unanswered: dict[int, int] = {}
        self.fault_at: int | None = None
        self.jam_at: int | None = None
        self.contact_nm: dict[int, float] = {}
        self.swing_nm = 0.0
        self.period_s = 0.01
        self.drop_on_enable_rad = 0.0
        self.brake_drop_rad: Sequence[float] = (0.0,) * 6
        self.on_stop: Callable[[], None] = lambda: None

    def positions_rad(self) -> Sequence[float]:
        return self.axes.motor_position(self.q_rad).tolist()

    def enable(self, stop_requested=lambda: False) -> Epoch:
        self.log.append("enable")
        self.enabled = True
        self.q_rad = self.q_rad - self.drop_on_enable_rad
        self.target_rad = self.q_rad
        return self._epoch()

    def exchange(self, commands: Sequence[DriveCommand], /) -> Epoch:
        motor = np.array([command.position_rad for command in commands])
        target = self.axes.joint_position(motor)
        assert self.enabled
        step = target - self.target_rad
        self.follow()
        self.direction = np.where(np.abs(step) > 1e-12, np.sign(step), self.direction)
        self.target_rad = target
        return self._epoch()

    def hold(self) -> Epoch:
        assert self.enabled
        self.follow()
        return self._epoch()

    def begin(self, commands: Sequence[DriveCommand] | None, /) -> None:
        self.log_of_parts.append("begin")
        self.begun = commands

    def prepare(self, at_s: float | None, /) -> float:
        self.log_of_parts.append("prepare")
        return 12.0 if at_s is None else at_s

    def sync(self) -> None:
        self.log_of_parts.append("sync")

    def gather(self) -> Epoch | None:
        """A fault is found when the answers are looked at."""
        self.log_of_parts.append("gather")
        self.failed: DriveFault | None = None
        try:
            return self.hold() if self.begun is None else self.exchange(self.begun)
        except DriveFault as error:
            self.failed = error
            return None

    def check(self, epoch: Epoch | None, /) -> None:
        self.log_of_parts.append("check")
        if self.failed is not None:
            raise self.failed

    def abandon(self) -> None:
        self.log_of_parts.append("abandon")

    def disable(self) -> None:
        self.log.append("disable")
        self.enabled = False

    def quick_stop(self) -> None:
        self.log.append("quick stop")
        self.target_rad = self.q_rad

    def gate(self) -> ArmState:
        state = State.OPERATION_ENABLED if self.enabled else State.SWITCH_ON_DISABLED
        fault = DriveFault("is enabled", node=1) if self.enabled else None
        return ArmState((DriveState(1, state, fault),), datetime.now(UTC))

    def align(self, at_s):
        self.aligned_s = at_s

    @property
    def sync_sent_s(self):
        return self.period_s * self.sync_index

    def asks_at(self, sync: int, kind: StopKind = StopKind.ALONG_PATH) -> StopDesk:
        """A desk with a person who wants a stop from a SYNC on."""
        wish = StopRequest(kind, StoppedByPerson("a person"))
        return StopDesk(lambda: wish if self.sync_index >= sync else None)

    def follow(self) -> None:
        """Bring the joints to their targets of the SYNC before."""
        jammed = self.jam_at is not None and self.sync_index >= self.jam_at
        q_rad = self.target_rad.copy()
        if jammed:
            q_rad[1] = self.q_rad[1]
        self.q_rad = q_rad

    def _epoch(self) -> Epoch:
        self.sync_index += 1
        self.path.append(self.q_rad)
        if self.fault_at is not None and self.sync_index >= self.fault_at:
            self.enabled = False
            raise DriveFault("left OPERATION ENABLED: FAULT", node=3, index=0x6041, code=0x0008)
        torque = self.gravity(self.q_rad) + self.direction * self.band_nm
        for sync, extra in self.contact_nm.items():
            torque[2] += extra if self.sync_index >= sync else 0.0
        torque[4] += self.swing_nm * np.sin(2 * np.pi * self.sync_index * self.period_s / 0.7)
        motor_nm = self.axes.motor_torque(torque + self.noise_nm * self.random.normal(size=6))
        counts = np.round(self.axes.motor_position(self.q_rad) / self.scale.count_rad).astype(int).tolist()
        words = np.round(motor_nm / self.scale.torque_nm).astype(int).tolist()
        readings = [self._reading(axis, counts[axis], words[axis]) for axis in range(6)]
        if self.sync_index in self.unanswered:
            readings[self.unanswered[self.sync_index]] = None
        return Epoch(self.sync_index, self.sync_index * self.period_s, tuple(readings))

    def _reading(self, axis: int, count: int, word: int) -> DriveReading | None:
        return DriveReading(
            node_id=axis + 1,
            sync_index=self.sync_index,
            statusword=ENABLED,
            position_count=count,
            torque_word=word,
            velocity_word=None,
            current_word=None,
            position_rad=count * self.scale.count_rad,
            torque_nm=word * self.scale.torque_nm,
            velocity_rad_s=None,
            current_a=None,
        )


@pytest.fixture(scope="session")
def small_cell() -> LoadedCell:
    return _example("small")


@pytest.fixture(scope="session")
def large_cell() -> LoadedCell:
    return _example("large")


def _example(name: str) -> LoadedCell:
    """Cell of an example, in lockstep."""
    path = Path(__file__).parents[2] / "examples" / name / "cell.toml"
    text = in_lockstep(path.read_text(encoding="utf-8"))
    return LoadedCell(cell=parse_cell(text, str(path)), text=text, folder=path.parent)


@pytest.fixture
def random_urdf():
    """Factory: seed -> URDF text of a random arm; `more` is put inside <robot>."""
    return lambda seed, more="": urdf_of(np.random.default_rng(seed), more)


@pytest.fixture(scope="session")
def workspace(small_cell) -> Workspace:
    config = small_cell.cell.arm[0]
    return workspace_of(config, arm_robot(small_cell, config))


BAND_NM = np.array([3.0, 4.0, 2.0, 0.8, 0.6, 0.4])


@pytest.fixture
def fake(small_cell, monkeypatch) -> FakeDrives:
    # locking all memory of a test process takes seconds
    monkeypatch.setattr("gateway.motion.power.RealTime", nullcontext)

    def gravity(q_rad: np.ndarray) -> np.ndarray:
        return np.array([0.0, 40.0 * np.cos(q_rad[1]), 15.0 * np.cos(q_rad[1] + q_rad[2]), 0.5, 2.0, 0.1])

    return FakeDrives(AxisConversion.from_arm(small_cell.cell.arm[0]), gravity, BAND_NM, noise_nm=0.2)


@pytest.fixture
def arm(fake) -> Arm:
    return Arm("main", fake, fake.axes)
