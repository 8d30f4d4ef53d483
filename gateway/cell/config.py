"""The cell file: buses, arms of two to eight axes, and how the rest poses are measured.

pydantic stands at this edge only; what is read here is frozen and complete. A key that is not known is refused, a
constant without its source too: nothing is ever filled in with 1.0.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from drives.toml_text import parse_toml
from drives.validation import Strict, problems_in_words
from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.cell.config_pair import DistanceConfig, PairConfig
from gateway.cell.quantities import Finite, Positive, Vector3
from gateway.errors import ConfigError


class SourcedNumber(Strict):
    """A number and where it comes from."""

    value: Finite = Field(description="in the unit of the key")
    source: Annotated[str, Field(min_length=1)] = Field(
        description="datasheet and page, `read from drive`, `measured` or `assumed`"
    )


#: Relative standard deviation [%] of a torque constant by the first word of its source; of any other a datasheet's.
STD_PERCENT_OF_SOURCE: Final = {"measured": 1.0, "read": 3.0, "datasheet": 5.0, "assumed": 10.0}
#: The same of a torque that the drive itself reports: its own constant was tuned by its maker.
REPORTED_STD_PERCENT: Final = 3.0
#: What no torque constant is worse than [%].
_LEAST_KNOWN_PERCENT: Final = 30.0


class TorqueConstant(SourcedNumber):
    """A torque constant: number, source, and how far it is trusted."""

    std_percent: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="relative standard deviation; absent: measured 1, read from drive 3, datasheet 5, assumed 10",
    )

    @property
    def trust_percent(self) -> float:
        """The stated standard deviation, else that of its source."""
        if self.std_percent is not None:
            return self.std_percent
        word = self.source.replace(",", " ").split()[:1]
        return STD_PERCENT_OF_SOURCE.get(word[0].lower() if word else "", STD_PERCENT_OF_SOURCE["datasheet"])

    @model_validator(mode="after")
    def _says_something(self) -> TorqueConstant:
        if (self.std_percent or 0.0) >= _LEAST_KNOWN_PERCENT:
            raise ValueError(
                f"a torque constant known to {self.std_percent:g} % says nothing of a mass: state less than"
                f" {_LEAST_KNOWN_PERCENT:g} %, or weigh a load and give it as --known"
            )
        return self


class BusConfig(Strict):
    """One CAN bus; `options` go to the python-can interface as they stand."""

    interface: str = Field(description="python-can interface: socketcan, pcan, kvaser, udp_multicast ...")
    channel: str = Field(description="its channel: can0, PCAN_USBBUS1, a multicast address ...")
    bitrate_bit_s: int = Field(
        default=1_000_000, gt=0, description="of the bus; the load of a cycle is reckoned with it"
    )
    sync_period_s: Positive = Field(default=0.01, description="time from SYNC to SYNC, one set point each")
    pacing: Literal["lockstep", "real"] = Field(
        default="real", description="by the clock, or (simulator alone) as fast as everybody has answered"
    )
    allow_real_drive: bool = Field(
        default=False,
        description="real drives on an interface over the network: anybody on such a network can write frames, a "
        "controlword too; never allows lockstep",
    )
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further options of the interface, as they stand"
    )


class KeepOut(Strict):
    """Axis-aligned box in the base frame that no link beyond the first and no load may enter, as thick as they are."""

    min_m: Vector3 = Field(description="smallest corner")
    max_m: Vector3 = Field(description="largest corner")

    @model_validator(mode="after")
    def _ordered(self) -> KeepOut:
        if not all(low < high for low, high in zip(self.min_m, self.max_m, strict=True)):
            raise ValueError(f"keep_out: every component of min_m {self.min_m} must lie below max_m {self.max_m}")
        return self


PerAxis = Annotated[tuple[Finite, ...], Field(min_length=FEWEST_AXES, max_length=MOST_AXES)]


class DhTable(Strict):
    """Denavit-Hartenberg rows, one an axis; theta = q + theta_offset."""

    convention: Literal["modified", "standard"] = Field(description="modified = Craig's")
    alpha_rad: PerAxis = Field(description="twists of the links")
    a_m: PerAxis = Field(description="lengths of the links")
    d_m: PerAxis = Field(description="offsets along the axes")
    theta_offset_rad: PerAxis = Field(description="angle of each joint at q = 0")


# Full speed is reached in 0.6 s, full acceleration in 0.2 s, where the cell gives no such limit.
RAMP_S = 0.6
ONSET_S = 0.2


class AxisConfig(Strict):
    """One servo axis: the drive, and what stands between motor and joint.

    A drive that reports the motor angle p and the motor torque t belongs to a joint at
    `position_sign p / gear_ratio + zero_offset_rad` with `torque_sign gear_ratio t` (before any coupling).
    """

    node_id: int = Field(ge=1, le=127, description="CANopen node id of the drive")
    profile: str = Field(description="a profile of the package, or a TOML file beside the cell")
    torque_constant_nm_per_a: TorqueConstant = Field(
        description="of the motor, per ampere of the kind that the profile states (rms or peak)"
    )
    gear_ratio: SourcedNumber = Field(description="motor turns per joint turn; negative where the gear turns the sense")
    gear_efficiency: SourcedNumber = Field(description="share of the motor's work that reaches the joint, in (0, 1]")
    position_sign: Literal[1, -1] = Field(default=1, description="-1 where the drive counts against the joint")
    torque_sign: Literal[1, -1] = Field(default=1, description="-1 where the drive's torque counts against the joint")
    zero_offset_rad: Finite = Field(default=0.0, description="joint angle at which the drive's position is zero")
    position_limit_rad: tuple[Finite, Finite] = Field(description="lowest and highest joint angle")
    speed_limit_rad_s: Positive = Field(description="of the joint; nothing moves faster")
    torque_limit_nm: Positive = Field(description="of the joint; the contact watch stops beyond")
    acceleration_limit_rad_s2: Positive | None = Field(
        default=None, description=f"of the joint; absent: full speed in {RAMP_S:g} s"
    )
    jerk_limit_rad_s3: Positive | None = Field(
        default=None, description=f"of the joint; absent: full acceleration in {ONSET_S:g} s"
    )
    following_error_limit_rad: Positive = Field(
        default=0.1, description="a joint further behind its set point stops all"
    )
    rotor_inertia_kg_m2: SourcedNumber | None = Field(default=None, description="of motor and gear, at the joint")
    coulomb_nm: SourcedNumber | None = Field(default=None, description="dry friction of motor and gear, at the joint")
    viscous_nm_s_rad: SourcedNumber | None = Field(default=None, description="friction that grows with the joint speed")

    @property
    def acceleration_rad_s2(self) -> float:
        """The given limit, else full speed in 0.6 s."""
        return self.acceleration_limit_rad_s2 or self.speed_limit_rad_s / RAMP_S

    @property
    def jerk_rad_s3(self) -> float:
        """The given limit, else full acceleration in 0.2 s."""
        return self.jerk_limit_rad_s3 or self.acceleration_rad_s2 / ONSET_S

    @model_validator(mode="after")
    def _plausible(self) -> AxisConfig:
        low, high = self.position_limit_rad
        if not low < high:
            raise ValueError(f"position_limit_rad: lower limit {low} is not below upper limit {high}")
        if self.gear_ratio.value == 0 or self.torque_constant_nm_per_a.value <= 0:
            raise ValueError("gear_ratio must not be 0 and torque_constant_nm_per_a must be positive")
        if not 0 < self.gear_efficiency.value <= 1:
            raise ValueError(f"gear_efficiency must lie in (0, 1], got {self.gear_efficiency.value}")
        for name in ("rotor_inertia_kg_m2", "coulomb_nm", "viscous_nm_s_rad"):
            constant = getattr(self, name)
            if constant is not None and constant.value < 0:
                raise ValueError(f"{name} must not be negative; leave it out if it is not known")
        return self


class ObjectKey(Strict):
    """An object of a device's dictionary."""

    index: int = Field(ge=0x1000, le=0xFFFF, description="such as 0x60FD")
    subindex: int = Field(default=0, ge=0, le=0xFF, description="of that object")


class HoldToRun(Strict):
    """A digital input that has to be held while anything moves: motion is allowed while `value & mask == good`.

    No enabling device in the sense of a safety standard: it is read over the bus, by software.
    """

    node_id: int = Field(ge=1, le=127, description="node on the arm's bus that has the input")
    object: ObjectKey = Field(description="object that holds the inputs, such as { index = 0x60FD }")
    mask: int = Field(gt=0, le=0xFFFFFFFF, description="bits that count")
    good: int = Field(ge=0, le=0xFFFFFFFF, description="their value while the input is held")

    @model_validator(mode="after")
    def _can_be_released(self) -> HoldToRun:
        if self.good & ~self.mask:
            raise ValueError(f"hold_to_run: good {self.good:#x} has bits outside mask {self.mask:#x}: it is never met")
        if self.good == 0:
            raise ValueError("hold_to_run: good is 0, which a broken wire looks like too; wire the input to be 1 held")
        return self


NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class ArmConfig(Strict):
    """One arm on one bus, of two to eight axes; six is the usual case: `link_6` stands for the last link."""

    name: str = Field(description="of the arm, in every file; `--arm` asks for it where there are several")
    bus: str = Field(description="name of its [bus.NAME]")
    robot: str | None = Field(default=None, description="URDF beside the cell; either this or [arm.dh]")
    dh: DhTable | None = Field(default=None, description="Denavit-Hartenberg rows instead of a URDF")
    inertials: Annotated[str, Field(pattern=r"^(exact|ignore|prior:\d*\.?\d+)$")] = Field(
        default="ignore", description="trust of the URDF's inertials: exact, ignore, prior:S, S the relative deviation"
    )
    gravity_m_s2: Vector3 = Field(
        default=(0.0, 0.0, -9.80665), description="in the base frame: a wall mount is said here"
    )
    flange_xyz_m: Vector3 | None = Field(default=None, description="flange in link_6; absent: results in link_6 alone")
    flange_rpy_rad: Vector3 = Field(default=(0.0, 0.0, 0.0), description="its turn, roll, pitch, yaw")
    keep_out: tuple[KeepOut, ...] = Field(
        default=(), description="boxes that the arm stays out of, floor and column too"
    )
    max_load_kg: Positive | None = Field(
        default=None,
        description="heaviest load that will hang on the flange; absent: half of each torque limit is kept",
    )
    max_load_com_m: Vector3 | None = Field(
        default=None, description="its centre of gravity in link_6; the flange if absent"
    )
    rated_load_kg: SourcedNumber | None = Field(
        default=None,
        description="load the arm is rated for: a heavier one fails, feedforward assumes it as long as none is entered",
    )
    rated_load_com_m: Vector3 | None = Field(
        default=None, description="its centre of gravity in link_6; the flange if absent"
    )
    rated_reach_m: SourcedNumber | None = Field(
        default=None, description="furthest from the flange that a load's centre of gravity may lie"
    )
    rated_moment_nm: SourcedNumber | None = Field(
        default=None, description="largest weight moment about the flange, mass x 9.80665 x that distance"
    )
    load_points_m: tuple[Vector3, ...] = Field(
        default=(), description="points of the load in link_6, such as its corners, that stay out of keep_out"
    )
    link_radius_m: Positive | tuple[Positive, ...] | None = Field(
        default=None,
        description="radius of the links whose shape the URDF's collision geometry does not give, one for all or one "
        "per link; 0.05 x reach is assumed if absent",
    )
    load_radius_m: NotNegative | None = Field(
        default=None,
        description="thickness of the load about the lines from the flange to load_points_m, 0 where these are its "
        "corners; as the last link if absent",
    )
    hold_to_run: HoldToRun | None = Field(
        default=None, description="digital input that has to be held for motion; no enabling device of a standard"
    )
    coupling: tuple[tuple[float, ...], ...] | None = Field(
        default=None, description="N x N matrix A of q_motor_side = A q_joint, ratios not included; identity if absent"
    )
    base_xyz_m: Vector3 = Field(default=(0.0, 0.0, 0.0), description="base of the arm in the world")
    base_rpy_rad: Vector3 = Field(default=(0.0, 0.0, 0.0), description="its turn, roll, pitch, yaw")
    tool_xyz_m: Vector3 = Field(default=(0.0, 0.0, 0.0), description="fingertip of the gripper in the flange")
    tool_rpy_rad: Vector3 = Field(default=(0.0, 0.0, 0.0), description="its turn, roll, pitch, yaw")
    start_rad: tuple[Finite, ...] | None = Field(
        default=None, description="joint angles at which an arm of a pair grips the part: start of the path"
    )
    axis: tuple[AxisConfig, ...] = Field(description="two to eight of them, usually six, from the base on")

    @model_validator(mode="after")
    def _consistent(self) -> ArmConfig:
        axes = len(self.axis)
        if not FEWEST_AXES <= axes <= MOST_AXES:
            raise ValueError(
                f"arm '{self.name}' has {axes} [[arm.axis]] tables, {FEWEST_AXES} to {MOST_AXES} are handled"
            )
        for name, length in self._lengths():
            if length != axes:
                raise ValueError(
                    f"arm '{self.name}': {name} has {length} numbers and the arm {axes} [[arm.axis]] tables; one per"
                    " axis is needed"
                )
        ids = [axis.node_id for axis in self.axis]
        twice = sorted({node for node in ids if ids.count(node) > 1})
        if twice:
            raise ValueError(f"arm '{self.name}': node id {twice[0]} is given to more than one axis")
        for key in ("rated_load_kg", "rated_reach_m", "rated_moment_nm"):
            rated: SourcedNumber | None = getattr(self, key)
            if rated is not None and rated.value <= 0:
                raise ValueError(f"arm '{self.name}': {key} must be positive")
            if rated is not None and key != "rated_load_kg" and self.flange_xyz_m is None:
                raise ValueError(f"arm '{self.name}': {key} counts from the flange; give flange_xyz_m too")
        if (self.robot is None) == (self.dh is None):
            raise ValueError(f"arm '{self.name}' needs either robot = \"FILE.urdf\" or [arm.dh], not both")
        if self.coupling is not None:
            matrix = np.array(self.coupling, dtype=float)
            if matrix.shape != (axes, axes) or abs(np.linalg.det(matrix)) < 1e-6:
                raise ValueError(f"arm '{self.name}': coupling must be an invertible {axes} x {axes} matrix")
        return self

    def _lengths(self) -> Iterator[tuple[str, int]]:
        """Keys that hold a number per axis, and how many they hold."""
        if self.dh is not None:
            yield from ((name, len(getattr(self.dh, name))) for name in ("alpha_rad", "a_m", "d_m", "theta_offset_rad"))
        if isinstance(self.link_radius_m, tuple):
            yield "link_radius_m", len(self.link_radius_m)
        if self.start_rad is not None:
            yield "start_rad", len(self.start_rad)


class PosesConfig(Strict):
    """How many rest poses, and how each is approached, settled and sampled."""

    count: int = Field(default=10, ge=2, description="poses to fit from")
    approach_offset_rad: Positive = Field(default=0.03, description="each pose is come to from so far, from both sides")
    approach_speed_rad_s: Positive = Field(default=0.05, description="of that last part of the way")
    samples: int = Field(default=100, ge=10, description="SYNCs that are averaged on each side")
    validation: int = Field(default=4, ge=0, description="further poses to judge on, that no fit sees")
    settle_timeout_s: Positive = Field(default=10.0, description="longest wait for rest")
    seed: int = Field(default=1, ge=0, description="of the choice of poses")
    file: str | None = Field(default=None, description="CSV with pose, q1_rad .. qN_rad instead of chosen poses")


class Cell(Strict):
    """The whole cell file."""

    name: str = Field(description="of the cell")
    bus: dict[str, BusConfig] = Field(description="one table a bus: [bus.a]")
    arm: tuple[ArmConfig, ...] = Field(min_length=1, description="one table an arm: [[arm]]")
    poses: PosesConfig = Field(default=PosesConfig(), description="rest poses")
    pair: PairConfig | None = Field(default=None, description="two arms with one workpiece")

    @model_validator(mode="after")
    def _consistent(self) -> Cell:
        names = [arm.name for arm in self.arm]
        if len(set(names)) != len(names):
            raise ValueError("two arms have the same name")
        taken: set[tuple[str, int]] = set()
        for arm in self.arm:
            if arm.bus not in self.bus:
                raise ValueError(f"arm '{arm.name}' names bus '{arm.bus}', but there is no [bus.{arm.bus}]")
            for axis in arm.axis:
                if (arm.bus, axis.node_id) in taken:
                    raise ValueError(f"bus '{arm.bus}': node id {axis.node_id} is used by two arms")
                taken.add((arm.bus, axis.node_id))
        if self.pair is not None:
            _check_pair(self.pair, self)
        return self


#: Two arms that carry one part are led by the inverse of a hand's six directions.
PAIR_AXES = 6


def _check_pair(pair: PairConfig, cell: Cell) -> None:
    arms = {arm.name: arm for arm in cell.arm}
    for role in ("master", "slave"):
        name = getattr(pair, role)
        if name not in arms:
            raise ValueError(f"pair: {role} = '{name}' is no arm of this cell; it has {', '.join(arms)}")
        if arms[name].start_rad is None:
            raise ValueError(f"arm '{name}' is the {role} of a pair and needs start_rad")
        if len(arms[name].axis) != PAIR_AXES:
            raise ValueError(
                f"arm '{name}' is the {role} of a pair and has {len(arms[name].axis)} axes; only arms of {PAIR_AXES}"
                " axes are led together"
            )
    if pair.master == pair.slave or arms[pair.master].bus == arms[pair.slave].bus:
        raise ValueError("pair: master and slave are two arms on two buses")
    first, second = (cell.bus[arms[name].bus] for name in (pair.master, pair.slave))
    if (first.sync_period_s, first.pacing) != (second.sync_period_s, second.pacing):
        raise ValueError("pair: sync_period_s and pacing of both buses must be the same")
    if pair.distance is not None:
        _check_distance(pair.distance, cell, (arms[pair.master].bus, arms[pair.slave].bus))


def _check_distance(distance: DistanceConfig, cell: Cell, buses: tuple[str, str]) -> None:
    if distance.bus not in buses:
        raise ValueError(f"distance: bus '{distance.bus}' is none of the pair's; use '{buses[0]}' or '{buses[1]}'")
    if any(arm.bus == distance.bus and distance.node_id in [axis.node_id for axis in arm.axis] for arm in cell.arm):
        raise ValueError(f"distance: node id {distance.node_id} on bus '{distance.bus}' is a drive's")


class LoadedCell(Strict):
    """A cell, the text it was read from and the folder its relative paths start at."""

    cell: Cell
    text: str
    folder: Path

    def path(self, name: str) -> Path:
        """Path of a file that the cell names."""
        return (self.folder / name).resolve()


def parse_cell(text: str, where: str) -> Cell:
    """Validate the text of a cell file; every problem is named at once."""
    try:
        return Cell.model_validate(parse_toml(text))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{where}: not valid TOML: {error}") from error
    except ValidationError as error:
        raise ConfigError(f"{where}: {problems_in_words(error)}") from error


def load_cell(path: Path) -> LoadedCell:
    """Read a cell file from disk."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    return LoadedCell(cell=parse_cell(text, str(path)), text=text, folder=path.resolve().parent)


def with_pacing(loaded: LoadedCell, pacing: str | None) -> LoadedCell:
    """The same cell with another pacing on every bus; None = as it is."""
    if pacing is None:
        return loaded
    cell = loaded.cell
    buses = {name: bus.model_copy(update={"pacing": pacing}) for name, bus in cell.bus.items()}
    return loaded.model_copy(update={"cell": cell.model_copy(update={"bus": buses})})
