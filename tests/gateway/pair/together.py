"""Two arms and the part between them, quasi-static: joints are at their commands, a spring pushes both hands.

Written from statics: the hands are where forward kinematics has them. The spring acts at the slave's hand between its
pose and that of the grasps, with the opposite force at the master's. Joint torques follow by virtual work.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from drives.epoch import Epoch
from drives.errors import DriveFault
from drives.values import DriveReading
from gateway.cell.conversion import AxisConversion
from gateway.model.arm_model import arm_robot
from gateway.motion.arm import Arm
from gateway.motion.arms import Arms
from gateway.motion.workspace import workspace_of
from gateway.pair.pair_cell import PairArm, PairCell, load_pair
from gateway.pair.path import PathProgram
from gateway.pair.session import PairLink
from tests.support.rigs.brakes import in_brakes

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "pair"
ENABLED = 0x1237


class Part:
    """What both hands hold.

    Parameters
    ----------
    cell : PairCell
    true : array of shape (4, 4)
        Hand 2 in hand 1 as the part has it.
    stiffness : N/m and Nm/rad
    """

    def __init__(self, cell: PairCell, true: np.ndarray, stiffness: tuple[float, float]) -> None:
        self.cell, self.true, self.stiffness = cell, true, stiffness
        self.q_rad = [arm.start_rad for arm in cell.arms]
        #: Where each arm goes with the next SYNC.
        self.next_rad = list(self.q_rad)

    def pushes(self) -> tuple[np.ndarray, np.ndarray]:
        """Wrench (6,) on each hand, at the hand, axes of its base [N, Nm]."""
        (one, two), first, second = self.hands(), *self.cell.arms
        away = one @ self.true
        force = self.stiffness[0] * (away[:3, 3] - two[:3, 3])
        moment = self.stiffness[1] * Rotation.from_matrix(away[:3, :3] @ two[:3, :3].T).as_rotvec()
        back = -moment - np.cross(two[:3, 3] - one[:3, 3], force)
        turned = [arm.world_from_base[:3, :3].T for arm in (first, second)]
        weight = 0.5 * self.cell.config.part_mass_kg * np.array(first.config.gravity_m_s2)
        return (
            np.concatenate([turned[0] @ (weight - force), turned[0] @ back]),
            np.concatenate([turned[1] @ (weight + force), turned[1] @ moment]),
        )

    def hands(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses (4, 4) of both hands in the world."""
        first, second = (
            arm.world_from_base @ arm.chain.poses(q[None])[0][0]
            for arm, q in zip(self.cell.arms, self.q_rad, strict=True)
        )
        return first, second


class Joints:
    """Drives of one arm; with each SYNC they are at the command of the SYNC before."""

    def __init__(self, index: int, arm: PairArm, part: Part, period_s: float) -> None:
        self.index, self.arm, self.part, self.period_s = index, arm, part, period_s
        self.axes = AxisConversion.from_arm(arm.config)
        self.enabled = False
        self.sync_index = 0
        self.log: list[str] = []
        self.offsets_nm: list[np.ndarray] = []
        self.unanswered: set[int] = set()
        self.brake_drop_rad = (0.0,) * arm.axes
        self.fault_at: int | None = None

    def positions_rad(self):
        return self.axes.motor_position(self.part.q_rad[self.index]).tolist()

    def enable(self, _stop_requested):
        self.log.append("enable")
        self.enabled = True
        self.last_rad = self.part.next_rad[self.index] = self.part.q_rad[self.index]
        still = np.zeros(self.arm.axes)
        return self._epoch(still, still)

    def exchange(self, commands, /):
        self.offsets_nm.append(np.array([command.torque_offset_nm for command in commands]))
        return self._step(self.axes.joint_position(np.array([command.position_rad for command in commands])))

    def hold(self):
        return self._step(self.part.next_rad[self.index])

    def _step(self, target_rad: np.ndarray) -> Epoch:
        """The former targets are reached, and the next ones are stored."""
        assert self.enabled
        part, after = self.part, target_rad
        if self.index == 0:  # one SYNC for both: the slave's joints go with the master's
            part.q_rad = list(part.next_rad)
        before, here = self.last_rad, part.q_rad[self.index]
        self.last_rad, part.next_rad[self.index] = here, after
        return self._epoch((after - before) / (2 * self.period_s), (after - 2 * here + before) / self.period_s**2)

    def abandon(self):
        """Nothing is ever begun in lockstep."""

    def disable(self):
        self.log.append("disable")
        self.enabled = False

    def quick_stop(self):
        self.log.append("quick stop")

    def gate(self):
        return in_brakes()

    def align(self, at_s):
        pass

    @property
    def sync_sent_s(self):
        return 0.0

    def _epoch(self, qd_rad_s: np.ndarray, qdd_rad_s2: np.ndarray) -> Epoch:
        self.sync_index += 1
        if self.sync_index == self.fault_at:
            self.enabled = False
            self.on_stop()
            raise DriveFault("left OPERATION ENABLED: FAULT", node=3)
        q = self.part.q_rad[self.index]
        torque = self.arm.model_torque(q[None], qd_rad_s[None], qdd_rad_s2[None])[0]
        torque = torque + self.arm.coulomb_nm * np.tanh(qd_rad_s / 1e-4) + self.arm.viscous_nm_s_rad * qd_rad_s
        jacobian = self.arm.chain.poses(q[None])[1][0]
        torque = torque - jacobian.T @ self.part.pushes()[self.index]
        position, motor = self.axes.motor_position(q), self.axes.motor_torque(torque)
        readings: list[DriveReading | None] = [
            DriveReading(axis + 1, self.sync_index, ENABLED, 0, 0, None, None, position[axis], motor[axis], None, None)
            for axis in range(self.arm.axes)
        ]
        if self.sync_index in self.unanswered:
            readings[2] = None
        return Epoch(self.sync_index, self.sync_index * self.period_s, tuple(readings))


def short(cell: PairCell) -> PairCell:
    """The same cell with the beginning of its path alone, from rest to rest, two points, servos without lag."""
    poses, count = cell.program.poses, 150
    share = np.linspace(0.0, 1.0, count)
    at = len(poses) / 8 * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    rows = np.arange(len(poses))
    commands = np.tile(np.eye(4), (count, 1, 1))
    commands[:, :3, 3] = np.column_stack([np.interp(at, rows, column) for column in poses[:, :3, 3].T])
    commands[:, :3, :3] = Slerp(rows, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    config = cell.config.model_copy(update={"servo_lag_s": 0.0, "knots": 2})
    return replace(cell, config=config, program=PathProgram(commands, cell.sync_period_s))


class Together:
    """A pair without a bus.

    Parameters
    ----------
    away : array of shape (6,)
        How far the grasps are off: the hand that the part wants, seen from the nominal one [m, rad].
    softer : how much softer the part is than the cell says
    cell_file : of the cell
    """

    def __init__(self, away: np.ndarray, softer: float = 0.5, cell_file: Path = EXAMPLE / "cell.toml") -> None:
        self.cell = short(load_pair(cell_file, pacing="lockstep"))
        off = np.eye(4)
        off[:3, 3], off[:3, :3] = away[:3], Rotation.from_rotvec(away[3:]).as_matrix()
        self.true = self.cell.nominal_relation @ off
        stiffness = self.cell.config.force.stiffness
        self.part = Part(self.cell, self.true, (softer * stiffness.straight, softer * stiffness.turned))
        self.drives = [
            Joints(index, arm, self.part, self.cell.sync_period_s) for index, arm in enumerate(self.cell.arms)
        ]
        members = [
            Arm(arm.config.name, drives, drives.axes)  # type: ignore[arg-type]
            for arm, drives in zip(self.cell.arms, self.drives, strict=True)
        ]
        counts = SimpleNamespace(cycles=7, incomplete=1, late=2)
        opened = [
            SimpleNamespace(
                workspace=workspace_of(arm.config, arm_robot(self.cell.loaded, arm.config)),
                config=arm.config,
                group=SimpleNamespace(statistics=counts),
            )
            for arm in self.cell.arms
        ]
        self.arms = Arms(members, "lockstep")
        self.link = PairLink((opened[0], opened[1]), self.arms)  # type: ignore[arg-type]
