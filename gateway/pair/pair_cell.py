"""Read the pair from a cell file: arms, geometry, path, model; needs no bus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drives.bus import BusSpec
from drives.exchange import Pacing
from gateway.cell.buses import bus_specs
from gateway.cell.config import ArmConfig, LoadedCell, PairConfig, load_cell, with_pacing
from gateway.data.csv_text import read_path_columns
from gateway.errors import ConfigError, InputError
from gateway.feedforward.identified import AxisConstants, Known, axis_constants, notes_of, read_identified
from gateway.model.arm_model import arm_robot
from gateway.model.regressor import regressor
from gateway.model.robot import Robot, rotation_rpy, transform
from gateway.pair.gap import GapLayout, gap_layout
from gateway.pair.inverse import ForwardChain, chain_of, path_joint_angles
from gateway.pair.path import PairPath, PathProgram, master_commands
from gateway.pair.transform import Floats, relation, slave_command

COLUMNS = ("time_s", "x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
#: Constants of an axis by key of the cell file and by name in messages: names in `AxisConstants`.
CONSTANTS = {
    "rotor_inertia_kg_m2": "rotor_kg_m2",
    "coulomb_nm": "coulomb_nm",
    "viscous_nm_s_rad": "viscous_nm_s_rad",
}
STATED_AS = {
    "rotor inertia": "rotor_kg_m2",
    "Coulomb friction": "coulomb_nm",
    "viscous friction": "viscous_nm_s_rad",
}
#: Largest number of a path.
FARTHEST = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class PairArm:
    """One arm of a pair.

    Attributes
    ----------
    config : ArmConfig
    robot : Robot
        With the fingertip as its flange.
    chain : ForwardChain
    world_from_base : array of shape (4, 4)
    part_from_tip : array of shape (4, 4)
        Fingertip in the part's frame.
    rotor_kg_m2, coulomb_nm, viscous_nm_s_rad : arrays of shape (N,)
    links : array of shape (10 N,)
        Inertial parameters of the links, gripper included, part not.
    known : tuple of AxisConstants
        Rotors and friction with their sources.
    """

    config: ArmConfig
    robot: Robot
    chain: ForwardChain
    world_from_base: Floats
    part_from_tip: Floats
    rotor_kg_m2: Floats
    coulomb_nm: Floats
    viscous_nm_s_rad: Floats
    links: Floats
    known: tuple[AxisConstants, ...] = ()

    @property
    def axes(self) -> int:
        """Return the number of axes."""
        return self.robot.axes

    @property
    def torque_limit_nm(self) -> Floats:
        """Return the torque limits (N,) of the axes [Nm]."""
        return np.array([axis.torque_limit_nm for axis in self.config.axis])

    @property
    def start_rad(self) -> Floats:
        """Return the joint angles (N,) at which the part is gripped [rad]."""
        return start_of(self.config)

    @property
    def said(self) -> tuple[str, ...]:
        """Return the source of rotors and friction and remarks on them, a line each."""
        sources: dict[str, list[str]] = {}
        for axis in self.known:
            for name, attribute in STATED_AS.items():
                known: Known | None = getattr(axis, attribute)
                if known is not None and name not in sources.setdefault(known.source, []):
                    sources[known.source].append(name)
        notes = notes_of([axis.notes for axis in self.known])
        return (
            *(f"{', '.join(names)}: {source}" for source, names in sources.items()),
            *(f"{joints}: {note}" for joints, note in notes),
        )

    def model_torque(self, q_rad: Floats, qd_rad_s: Floats, qdd_rad_s2: Floats) -> Floats:
        """Return the actuator torque (n, N) [Nm] of a free motion, with rotors, without friction."""
        rows = regressor(self.robot, q_rad, qd_rad_s, qdd_rad_s2, self.config.gravity_m_s2)
        return rows @ self.links + self.rotor_kg_m2 * qdd_rad_s2

    def link_torques(self, q_rad: Floats, qd_rad_s: Floats, qdd_rad_s2: Floats) -> list[Floats]:
        """Return the torque (n, N) [Nm] of each of the N links alone, without rotors."""
        rows = regressor(self.robot, q_rad, qd_rad_s, qdd_rad_s2, self.config.gravity_m_s2)
        each = [slice(10 * link, 10 * link + 10) for link in range(self.axes)]
        return [rows[:, :, link] @ self.links[link] for link in each]

    def mass_matrix(self, q_rad: Floats) -> Floats:
        """Return the mass matrix (n, N, N) [kg m2], rotors included."""
        still = np.zeros_like(q_rad)
        at_rest = self.model_torque(q_rad, still, still)
        columns = [self.model_torque(q_rad, still, still + unit) - at_rest for unit in np.eye(self.axes)]
        return np.stack(columns, axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class PairCell:
    """Cell with a pair of arms: configuration, robots and path.

    Attributes
    ----------
    loaded : LoadedCell
    config : PairConfig
    arms : two PairArm
        Master and slave.
    program : PathProgram
        Of the master.
    specs : tuple of two BusSpec
    gap : GapLayout or None
        Distance sensors, None = the internal force is used.
    """

    loaded: LoadedCell
    config: PairConfig
    arms: tuple[PairArm, PairArm]
    program: PathProgram
    specs: tuple[BusSpec, BusSpec]
    gap: GapLayout | None = None

    @property
    def sync_period_s(self) -> float:
        """Of both buses."""
        return self.loaded.cell.bus[self.arms[0].config.bus].sync_period_s

    @property
    def pacing(self) -> Pacing:
        """Of both buses."""
        return self.loaded.cell.bus[self.arms[0].config.bus].pacing

    @property
    def nominal_relation(self) -> Floats:
        """Gripper 2 in gripper 1 (4, 4) by the grasps alone [m]."""
        first, second = self.arms
        return nominal_relation(first.part_from_tip, second.part_from_tip)

    def path(self, speed: float | None = None) -> PairPath:
        """Return the master's commands at a speed setting (by default the cell's)."""
        return self.program.at_speed(speed or self.config.speed, self.sync_period_s)

    def nominal_slave(self, path: PairPath) -> Floats:
        """Return the slave's commands (M, 4, 4) by the nominal relation."""
        first, second = self.arms
        return slave_command(first.world_from_base, path.commands, second.world_from_base, self.nominal_relation)

    def joints(self, path: PairPath) -> tuple[Floats, Floats]:
        """Nominal joint angles (M, N) of each arm along a path [rad]; refuses a singular posture."""
        first, second = self.arms
        return (
            path_joint_angles(first.chain, path.commands, first.start_rad)[0],
            path_joint_angles(second.chain, self.nominal_slave(path), second.start_rad)[0],
        )


def load_pair(path: Path, bus: str | None = None, pacing: str | None = None) -> PairCell:
    """Read a cell file with a pair.

    Parameters
    ----------
    path : Path
    bus : str, optional
        NAME=SPEC;NAME=SPEC in place of the cell's buses.
    pacing : str, optional
        In place of the buses' own.

    Raises
    ------
    ConfigError, InputError
        The cell, its robots or its path cannot be used.
    BusError
        A SPEC is not understood.
    """
    loaded = with_pacing(load_cell(path), pacing)
    return pair_of(path, loaded, bus_specs(loaded.cell, bus))


def pair_of(path: Path, loaded: LoadedCell, specs: Mapping[str, BusSpec]) -> PairCell:
    """Return the pair of a cell that was read from a file; `specs` holds the bus of every name. As `load_pair`."""
    config = loaded.cell.pair
    if config is None:
        raise ConfigError(f"{path}: the cell has no [pair]; two arms that carry one part are described there")
    arms = {arm.name: arm for arm in loaded.cell.arm}
    grasps = (
        _pose(config.master_grasp_xyz_m, config.master_grasp_rpy_rad),
        _pose(config.slave_grasp_xyz_m, config.slave_grasp_rpy_rad),
    )
    names = (config.master, config.slave)
    built = [_arm(loaded, arms[name], grasp) for name, grasp in zip(names, grasps, strict=True)]
    poses, step_s = read_path(loaded.path(config.path))
    commands = master_commands(poses, built[0].world_from_base, built[0].part_from_tip)
    buses = [arms[name].bus for name in names]
    distance = config.distance
    gap = None
    if distance is not None:
        gap = gap_layout(distance, buses.index(distance.bus), nominal_relation(*grasps))
    chosen = (specs[buses[0]], specs[buses[1]])
    return PairCell(loaded, config, (built[0], built[1]), PathProgram(commands, step_s), chosen, gap)


def nominal_relation(master_grasp: Floats, slave_grasp: Floats) -> Floats:
    """Gripper 2 in gripper 1 (4, 4) from both fingertips (4, 4) in the part's frame."""
    return relation(np.eye(4), master_grasp, np.eye(4), slave_grasp)


def start_of(config: ArmConfig) -> Floats:
    """Joint angles (N,) of an arm at which the part is gripped [rad]."""
    return np.array(config.start_rad or (0.0,) * len(config.axis))


def _pose(xyz_m: tuple[float, float, float], rpy_rad: tuple[float, float, float]) -> Floats:
    return transform(rotation_rpy(rpy_rad), xyz_m)


def _arm(loaded: LoadedCell, config: ArmConfig, grasp: Floats) -> PairArm:
    robot = arm_robot(loaded, config)
    flange = np.eye(4) if robot.flange is None else robot.flange
    robot = replace(robot, flange=flange @ _pose(config.tool_xyz_m, config.tool_rpy_rad))
    if not np.isfinite(robot.mass_kg).all():
        unknown = int(np.argmin(np.isfinite(robot.mass_kg))) + 1
        raise ConfigError(
            f"arm '{config.name}': the mass of link {unknown} is not known, and force from torque needs every link:"
            " give <inertial> in the URDF, or commission the arm first"
        )
    known = axis_constants(config, read_identified(loaded, config, robot))
    constants = []
    for key, attribute in CONSTANTS.items():
        values = [getattr(axis, attribute) for axis in known]
        if None in values:
            where = values.index(None) + 1
            raise ConfigError(
                f"arm '{config.name}', axis {where}: {key} is missing; it is needed for force from torque:"
                " give it, or name under `identified` a result of motion (plan --moving) that holds it"
            )
        constants.append(np.array([value.value for value in values]))
    rows = []
    for mass, com, inertia in zip(robot.mass_kg, robot.com_m, robot.inertia_kg_m2, strict=True):
        about = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
        rows.append([mass, *(mass * com), *about[np.triu_indices(3)]])
    return PairArm(
        config,
        robot,
        chain_of(robot, start_of(config)),
        _pose(config.base_xyz_m, config.base_rpy_rad),
        grasp,
        *constants,
        links=np.array(rows).ravel(),
        known=known,
    )


def read_path(path: Path) -> tuple[Floats, float]:
    """Poses (M, 4, 4) of a part in the world [m] and the time between them [s], from a CSV.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing or unknown, a number is none, or the times are not evenly spaced.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; correct the key path of [pair]")
    columns = read_path_columns(path, COLUMNS)
    rows = np.column_stack([columns.values[name] for name in COLUMNS])
    if len(rows) < 3:
        raise InputError(f"{path}: a path needs at least three poses, got {len(rows)}")
    far = np.abs(rows).max(axis=1) > FARTHEST
    if far.any():
        raise InputError(
            f"{columns.where(int(np.argmax(far)))}: a value beyond {FARTHEST:g}; a path is given in m, rad and s"
        )
    steps = np.diff(rows[:, 0])
    if steps.min() <= 0 or np.ptp(steps) > 1e-6 * steps.mean() + 1e-6:
        raise InputError(f"{path}: the times of a path must rise in even steps")
    poses = np.array([_pose(tuple(row[1:4]), tuple(row[4:7])) for row in rows])
    return poses, float((rows[-1, 0] - rows[0, 0]) / len(steps))
