"""An opened arm in lockstep whose drives are the slaves of the wire: every frame passes, no simulator is needed.

The joints are kinematic: a held one is at its command, and one whose brake fails accelerates. The drive that catches it
decelerates it at a constant rate. Nothing of it is shared with the product but object numbers.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest

from drives.bus import Bus, BusSpec
from drives.group import DriveGroup
from drives.profile_file import load_profile
from drives.values import AxisSetup
from gateway.cell.config import LoadedCell
from gateway.cell.conversion import AxisConversion
from gateway.data.disk import Disk
from gateway.model.arm_model import arm_robot
from gateway.motion.arm import Arm
from gateway.motion.opening import OpenArm
from gateway.motion.workspace import Workspace, workspace_of
from tests.drives.conftest import Slave, Wire, on_its_clock

COUNTS = 65536
CONSUMER_MS = 500
#: Deceleration of a motor that catches its axis, joint side [rad/s2].
CATCH_RAD_S2 = 40.0
FREE_RAD = (0.1, 0.3, -0.4, 0.2, 0.5, -0.2)


class Joint(Slave):
    """A slave that counts time by SYNCs, with an axis that may fall.

    Attributes
    ----------
    falls_rad_s2 : acceleration of the joint while its drive does not hold it; 0 = the brake holds
    creeps_rad_s : speed at which the joint sinks in its brake
    commands : controlword and target position at every SYNC
    measured : position at every SYNC, which the drive sends
    states, last_beats : state after every SYNC, and the SYNC of the master's last heartbeat by then
    without_master : state that it takes when the master's heartbeat is lost, by 0x6007
    farthest_rad : largest angle of the joint from where it was last held
    """

    def __init__(self, wire: Wire, node_id: int, period_s: float, joint_count: float) -> None:
        super().__init__(wire, node_id)
        self.values[0x1016, 1] = 127 << 16 | CONSUMER_MS
        self.values[0x60C2, 1], self.values[0x60C2, 2] = round(period_s * 1000), -3
        self.falls_rad_s2 = self.creeps_rad_s = 0.0
        self.farthest_rad = 0.0
        self.commands: list[tuple[int, int]] = []
        self.measured: list[int] = []
        self.states: list[str] = []
        self.without_master = {1: "fault", 2: "switch on disabled", 3: "quick stop"}
        self.last_beats: list[int] = []
        self._period_s, self.joint_count = period_s, joint_count
        self._beat_sync = 0
        self._speed = 0.0
        #: Where it was last held at rest; None = its brake has not been opened yet.
        self._held_count: int | None = None

    def on_frame(self, can_id: int, data: bytes) -> None:
        if can_id == 0x700 | self.values[0x1016, 1] >> 16:
            self._beat_sync = self.sync_seen
        super().on_frame(can_id, data)

    def _supervise_master(self) -> None:
        limit_s = (self.values[0x1016, 1] & 0xFFFF) / 1000.0
        missing_s = (self.sync_seen - self._beat_sync) * self._period_s
        if self.supervises and limit_s and self.state == "operation enabled" and missing_s > limit_s:
            self.state = self.without_master[self.values[0x6007, 0]]

    def _sync(self) -> None:
        before = self.position
        super()._sync()
        if self.nmt != 5:
            return
        self.commands.append((self.controlwords[-1] if self.controlwords else 0, self.values[0x607A, 0]))
        self.measured.append(before)
        self.states.append(self.state)
        self.last_beats.append(self._beat_sync)
        self._turn(before)

    def _turn(self, before: int) -> None:
        """The axis over the period that begins with this SYNC."""
        period_s = self._period_s
        if self.state in ("operation enabled", "quick stop"):
            if self._speed == 0.0:
                self._held_count = self.position
                return
            slower = max(0.0, self._speed - CATCH_RAD_S2 * period_s)
            step, self._speed = (self._speed + slower) / 2.0 * period_s, slower
        elif self._held_count is not None and (self.falls_rad_s2 or self.creeps_rad_s):
            faster = self._speed + self.falls_rad_s2 * period_s
            step = ((self._speed + faster) / 2.0 + self.creeps_rad_s) * period_s
            self._speed = faster
        else:
            return
        self.position = before + round(step * self.joint_count)
        self.farthest_rad = max(self.farthest_rad, abs(self.position - (self._held_count or 0)) / self.joint_count)


@contextmanager
def wired_arm(loaded: LoadedCell, period_s: float) -> Generator[tuple[OpenArm, list[Joint]]]:
    """The first arm of a cell, connected and configured, in its brakes at a free posture; with its slaves."""
    wire = Wire()
    config = loaded.cell.arm[0]
    axes = AxisConversion.from_arm(config)
    profile = load_profile("generic-cia402")
    ratios = [abs(float(axis.gear_ratio.value)) for axis in config.axis]
    slaves = [
        Joint(wire, axis.node_id, period_s, ratio * COUNTS / math.tau)
        for axis, ratio in zip(config.axis, ratios, strict=True)
    ]
    motor = axes.motor_position(np.array(FREE_RAD))
    for slave, angle in zip(slaves, motor.tolist(), strict=True):
        slave.position = round(angle * COUNTS / math.tau)
        slave.torque = 0
        slave.supervises = True
    wire.slaves += slaves
    setups = [AxisSetup(axis.node_id, profile, 0.5, 600.0) for axis in config.axis]
    with (
        pytest.MonkeyPatch.context() as patch,
        Disk() as disk,
        Bus(wire, BusSpec("test", "wire")) as bus,
        DriveGroup(bus, setups, period_s, "lockstep") as group,
    ):
        on_its_clock(wire, patch)
        group.connect()
        group.configure()
        yield (
            OpenArm(
                loaded=loaded,
                config=config,
                robot_text="",
                workspace=workspace_of(config, arm_robot(loaded, config)),
                profiles=(profile,) * len(setups),
                group=group,
                arm=Arm(config.name, group, axes),
                identities=(),
                constants=(),
                readings=(),
                disk=disk,
            ),
            slaves,
        )


def last_set_point(slaves: Sequence[Joint]) -> int:
    """SYNC, counted as the slaves do, with which a target of any axis last changed."""
    last = 0
    for slave in slaves:
        targets = [target for _, target in slave.commands]
        last = max([last, *(number for number in range(1, len(targets)) if targets[number] != targets[number - 1])])
    return last + 1


def ramp_syncs(workspace: Workspace, speed_rad_s: float, period_s: float) -> int:
    """SYNCs of a stop from a speed of all joints inside the limits of acceleration and jerk."""
    acceleration, jerk = float(workspace.acceleration_rad_s2.min()), float(workspace.jerk_rad_s3.min())
    steepest = min(acceleration, math.sqrt(speed_rad_s * jerk))
    return math.ceil((speed_rad_s / steepest + 2.0 * steepest / jerk) / period_s)
