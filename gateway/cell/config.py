"""Cell file: buses, arms of one to eight axes, and settings of the rest poses.

Values are validated with pydantic and frozen. Unknown keys and constants without a source are refused; there is no
default of 1.0.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from drives.bus_spec import BusSpec
from drives.profile import DriveProfile, is_assumed
from drives.toml_lines import KeyPath, key_lines
from drives.validation import Refused, Strict, Unfit, read_strict, refuse
from gateway.cell import plausible
from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.cell.calibration import read_calibration
from gateway.cell.config_pair import DistanceConfig, PairConfig
from gateway.cell.quantities import Finite, PlainName, Positive, Vector3, parse_inertials
from gateway.errors import ConfigError


class SourcedNumber(Strict):
    """A number with its source."""

    value: Finite = Field(description="in the unit of the key")
    source: Annotated[str, Field(min_length=1)] = Field(
        description="datasheet and page, `read from drive`, `measured` or `assumed`"
    )


#: Relative standard deviation [%] of a torque constant by the first word of its source; of any other a datasheet's.
STD_PERCENT_OF_SOURCE: Final = {"measured": 1.0, "read": 3.0, "datasheet": 5.0, "assumed": 10.0}
#: The same of a torque that the drive itself reports: its own constant was tuned by its maker.
REPORTED_STD_PERCENT: Final = 3.0
#: Largest accepted standard deviation of a torque constant [%].
_LEAST_KNOWN_PERCENT: Final = 30.0


class TorqueConstant(SourcedNumber):
    """A torque constant: number, source and standard deviation."""

    std_percent: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="relative standard deviation; absent: measured 1, read from drive 3, datasheet 5, assumed 10",
    )

    @property
    def trust_percent(self) -> float:
        """Standard deviation [%]: the stated one, otherwise that of the source."""
        if self.std_percent is not None:
            return self.std_percent
        word = self.source.replace(",", " ").split()[:1]
        return STD_PERCENT_OF_SOURCE.get(word[0].lower() if word else "", STD_PERCENT_OF_SOURCE["datasheet"])

    @model_validator(mode="after")
    def _says_something(self) -> TorqueConstant:
        if (self.std_percent or 0.0) >= _LEAST_KNOWN_PERCENT:
            raise Refused(
                (
                    ("std_percent",),
                    f"a torque constant with a standard deviation of {self.std_percent:g} % does not determine a "
                    f"mass: state less than"
                    f" {_LEAST_KNOWN_PERCENT:g} %, or weigh a load and give it as --known",
                )
            )
        return self


class BusConfig(Strict):
    """One CAN bus; `options` are passed to the python-can interface unchanged."""

    interface: str = Field(description="python-can interface: socketcan, pcan, kvaser, udp_multicast ...")
    channel: str = Field(description="its channel: can0, PCAN_USBBUS1, a multicast address ...")
    bitrate_bit_s: int = Field(default=1_000_000, ge=10_000, description="bit rate of the bus, used for the bus load")
    sync_period_s: Positive = Field(default=0.01, le=1.0, description="SYNC period; one setpoint per SYNC")
    pacing: Literal["lockstep", "real"] = Field(
        default="real",
        description="`real`: in real time; `lockstep` (simulator only): next SYNC when all nodes have answered",
    )
    allow_real_drive: bool = Field(
        default=False,
        description="allows real drives on a network interface; every host there can send frames, also controlwords; "
        "never allows lockstep",
    )
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further options of the interface, passed unchanged"
    )

    @property
    def spec(self) -> BusSpec:
        """Return the address of the bus."""
        return BusSpec(self.interface, self.channel, self.bitrate_bit_s, dict(self.options))


class KeepOut(Strict):
    """Axis-aligned box in the base frame that no link beyond the first and no load may enter, as thick as they are."""

    min_m: Vector3 = Field(description="smallest corner")
    max_m: Vector3 = Field(description="largest corner")

    @model_validator(mode="after")
    def _ordered(self) -> KeepOut:
        if not all(low < high for low, high in zip(self.min_m, self.max_m, strict=True)):
            what = f"keep_out: every component of min_m {self.min_m} must be below max_m {self.max_m}"
            raise Refused((("min_m",), what))
        return self


PerAxis = Annotated[tuple[Finite, ...], Field(min_length=FEWEST_AXES, max_length=MOST_AXES)]


class DhTable(Strict):
    """Denavit-Hartenberg parameters, one row per axis; theta = q + theta_offset."""

    convention: Literal["modified", "standard"] = Field(description="modified = Craig's")
    alpha_rad: PerAxis = Field(description="twists of the links")
    a_m: PerAxis = Field(description="lengths of the links")
    d_m: PerAxis = Field(description="offsets along the axes")
    theta_offset_rad: PerAxis = Field(description="angle of each joint at q = 0")


# Full speed is reached in 0.6 s, full acceleration in 0.2 s, where the cell gives no such limit.
RAMP_S = 0.6
ONSET_S = 0.2


class AxisConfig(Strict):
    """One servo axis: drive, gear and limits.

    A drive that reports the motor angle p and the motor torque t belongs to a joint at
    `position_sign p / gear_ratio + zero_offset_rad` with `torque_sign gear_ratio t` (before any coupling).
    """

    node_id: int = Field(ge=1, le=127, description="CANopen node id of the drive")
    profile: str = Field(description="a built-in profile, or the name of a TOML file beside the cell")
    torque_constant_nm_per_a: TorqueConstant = Field(
        description="of the motor, per ampere of the kind that the profile states (rms or peak)"
    )
    gear_ratio: SourcedNumber = Field(
        description="motor turns per joint turn; negative if the gear reverses the direction"
    )
    gear_efficiency: SourcedNumber = Field(description="share of the motor's work that reaches the joint, in (0, 1]")
    position_sign: Literal[1, -1] = Field(default=1, description="-1 if the drive counts opposite to the joint")
    torque_sign: Literal[1, -1] = Field(default=1, description="-1 if the torque of the drive is opposite to the joint")
    zero_offset_rad: Finite = Field(default=0.0, description="joint angle at which the drive's position is zero")
    position_limit_rad: tuple[Finite, Finite] = Field(description="lowest and highest joint angle")
    speed_limit_rad_s: Positive = Field(description="speed limit of the joint, at most the velocity in the URDF")
    torque_limit_nm: Positive = Field(description="torque limit of the joint; contact monitoring stops above it")
    torque_limit_source: str | None = Field(
        default=None, description="source of the limit; motion is refused if it begins with `assumed`"
    )
    acceleration_limit_rad_s2: Positive | None = Field(
        default=None, description=f"of the joint; absent: full speed in {RAMP_S:g} s"
    )
    jerk_limit_rad_s3: Positive | None = Field(
        default=None, description=f"of the joint; absent: full acceleration in {ONSET_S:g} s"
    )
    following_error_limit_rad: Positive = Field(default=0.1, description="a larger following error stops all axes")
    rotor_inertia_kg_m2: SourcedNumber | None = Field(default=None, description="of motor and gear, at the joint")
    coulomb_nm: SourcedNumber | None = Field(default=None, description="dry friction of motor and gear, at the joint")
    viscous_nm_s_rad: SourcedNumber | None = Field(default=None, description="friction that grows with the joint speed")

    @property
    def torque_limit_is_assumed(self) -> bool:
        """Return whether the torque limit is an unconfirmed placeholder."""
        return self.torque_limit_source is not None and is_assumed(self.torque_limit_source)

    @property
    def acceleration_rad_s2(self) -> float:
        """Acceleration limit [rad/s2] per axis: the configured one, otherwise full speed in 0.6 s."""
        return self.acceleration_limit_rad_s2 or self.speed_limit_rad_s / RAMP_S

    @property
    def jerk_rad_s3(self) -> float:
        """Jerk limit [rad/s3] per axis: the configured one, otherwise full acceleration in 0.2 s."""
        return self.jerk_limit_rad_s3 or self.acceleration_rad_s2 / ONSET_S

    @model_validator(mode="after")
    def _plausible(self) -> AxisConfig:
        refuse([*self._slips()])
        return self

    def _slips(self) -> plausible.Found:
        low, high = self.position_limit_rad
        if not low < high:
            what = f"position_limit_rad: lower limit {low} is not below upper limit {high}: write the lower one first"
            yield ("position_limit_rad",), what
        speed = max(self.speed_limit_rad_s, plausible.LOWERED_SPEED_RAD_S)
        ramp = max(self.acceleration_rad_s2, plausible.LOWERED_RAMP_RAD_S2)
        for bound, key, values, of in (
            ("joint angle", "position_limit_rad", self.position_limit_rad, 1.0),
            ("joint angle", "zero_offset_rad", (self.zero_offset_rad,), 1.0),
            ("following error", "following_error_limit_rad", (self.following_error_limit_rad,), 1.0),
            ("acceleration for each rad/s of speed", "acceleration_limit_rad_s2", (self.acceleration_rad_s2,), speed),
            ("jerk for each rad/s2 of acceleration", "jerk_limit_rad_s3", (self.jerk_rad_s3,), ramp),
        ):
            yield from plausible.beyond(bound, key, *values, of=of)
        if not self.torque_limit_is_assumed:  # else motion is refused until it is confirmed
            yield from plausible.beyond("torque", "torque_limit_nm", self.torque_limit_nm)
        yield from plausible.ratio(self.gear_ratio.value)
        yield from plausible.torque_constant(self.torque_constant_nm_per_a.value, self.gear_ratio.value)
        yield from plausible.efficiency(self.gear_efficiency.value)
        for name in ("rotor_inertia_kg_m2", "coulomb_nm", "viscous_nm_s_rad"):
            constant = getattr(self, name)
            if constant is not None and constant.value < 0:
                yield (name,), f"{name} must not be negative; omit it if it is unknown"


class ObjectKey(Strict):
    """Object of a device's object dictionary."""

    index: int = Field(ge=0x1000, le=0xFFFF, description="such as 0x60FD")
    subindex: int = Field(default=0, ge=0, le=0xFF, description="of that object")


class HoldToRun(Strict):
    """A digital input that has to be held while anything moves: motion is allowed while `value & mask == good`.

    Not an enabling device in the sense of a safety standard: it is read over the bus, by software.
    """

    node_id: int = Field(ge=1, le=127, description="node on the arm's bus that has the input")
    object: ObjectKey = Field(description="object that holds the inputs, such as { index = 0x60FD }")
    mask: int = Field(gt=0, le=0xFFFFFFFF, description="bits that count")
    good: int = Field(ge=0, le=0xFFFFFFFF, description="their value while the input is held")

    @model_validator(mode="after")
    def _can_be_released(self) -> HoldToRun:
        if self.good & ~self.mask:
            what = f"hold_to_run: good {self.good:#x} has bits outside mask {self.mask:#x}: it is never met"
            raise Refused((("good",), what))
        if self.good == 0:
            what = "hold_to_run: good is 0, the same as a broken wire; wire the input to be 1 while held"
            raise Refused((("good",), what))
        return self


NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
#: `false` if the object does not exist; 0 is a number.
No = Annotated[bool, Field(strict=True)]


class ArmConfig(Strict):
    """One arm on one bus, of one to eight axes; six is the usual case: `link_6` stands for the last link."""

    name: PlainName = Field(description="name of the arm in all files, and for `--arm`")
    bus: str = Field(description="name of its [bus.NAME]")
    robot: str | None = Field(default=None, description="URDF beside the cell; either this or [arm.dh]")
    tip: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="last link of the arm in the URDF; other joints are fixed at zero; absent: the last link of the "
        "only chain of driven joints",
    )
    dh: DhTable | None = Field(default=None, description="Denavit-Hartenberg parameters instead of a URDF")
    inertials: Annotated[str, Field(pattern=r"^(exact|ignore|prior:\d*\.?\d+)$")] = Field(
        default="ignore",
        description="uncertainty of the URDF inertials: exact, ignore, prior:S, S the relative standard deviation",
    )
    gravity_m_s2: Vector3 = Field(
        default=(0.0, 0.0, -9.80665), description="gravity in the base frame; states a wall or ceiling mount"
    )
    flange_xyz_m: Vector3 | None = Field(
        default=None, description="position of the flange in link_6; absent: results only in link_6"
    )
    flange_rpy_rad: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="its orientation, roll, pitch, yaw; absent: assumed not rotated"
    )
    flange_source: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="source of the flange; exports state it and warn if it is `assumed`",
    )
    keep_out: tuple[KeepOut, ...] = Field(
        default=(), description="boxes that the arm must not enter, in addition to floor, wall and column"
    )
    floor_m: Finite | No | None = Field(
        default=None,
        description="height of the floor above the base origin; false: no floor; absent: 0 is assumed, or the "
        "clearance below the shoulder",
    )
    wall: No | None = Field(
        default=None,
        description="mounting surface perpendicular to axis 1; absent: assumed if the base is tilted by more than "
        "45 degrees, as on a wall or ceiling",
    )
    column_radius_m: Positive | No | None = Field(
        default=None,
        description="radius of the column about axis 1, from the floor up to below axis 2; false: there is none; "
        "absent: the base's collision geometry in the URDF, else 0.1 x reach is assumed",
    )
    max_load_kg: Positive | None = Field(
        default=None,
        description="heaviest load to be mounted; absent: half of each torque limit is reserved",
    )
    max_load_com_m: Vector3 | None = Field(
        default=None, description="its centre of gravity in link_6; the flange if absent"
    )
    rated_load_kg: SourcedNumber | None = Field(
        default=None,
        description="rated load of the arm: a heavier one fails; feedforward assumes it if no load is entered",
    )
    rated_load_com_m: Vector3 | None = Field(
        default=None, description="its centre of gravity in link_6; the flange if absent"
    )
    rated_reach_m: SourcedNumber | None = Field(
        default=None, description="largest distance of a load's centre of gravity from the flange"
    )
    rated_moment_nm: SourcedNumber | None = Field(
        default=None, description="largest weight moment about the flange, mass x 9.80665 x that distance"
    )
    load_points_m: tuple[Vector3, ...] = Field(
        default=(), description="points of the load in link_6, such as its corners, instead of load_size_m"
    )
    load_size_m: tuple[Positive, Positive, Positive] | None = Field(
        default=None,
        description="box around the load, centred on the flange face, along x, y and z of the flange; "
        "absent: a ball as thick as the last link is assumed",
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
    identified: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="result file beside the cell, of `estimate`, `diagnose` or `commission` of this arm in motion: its"
        " friction and rotor inertia are taken before those of the axes",
    )
    load_acceleration_m_s2: Positive | None = Field(
        default=None,
        description="largest acceleration of the load's centre of gravity, without gravity, that the gripper can "
        "hold; absent: only the limits of the arm",
    )
    hold_to_run: HoldToRun | None = Field(
        default=None,
        description="digital input that must be held for motion; not an enabling device of a safety standard",
    )
    coupling: tuple[tuple[float, ...], ...] | None = Field(
        default=None, description="N x N matrix A of q_motor_side = A q_joint, ratios not included; identity if absent"
    )
    base_xyz_m: Vector3 = Field(default=(0.0, 0.0, 0.0), description="base of the arm in the world")
    base_rpy_rad: Vector3 = Field(default=(0.0, 0.0, 0.0), description="its orientation, roll, pitch, yaw")
    tool_xyz_m: Vector3 = Field(default=(0.0, 0.0, 0.0), description="fingertip of the gripper in the flange")
    tool_rpy_rad: Vector3 = Field(default=(0.0, 0.0, 0.0), description="its orientation, roll, pitch, yaw")
    start_rad: tuple[Finite, ...] | None = Field(
        default=None,
        description="joint angles at which an arm of a pair grips the part: start of the path; an arm with more "
        "than six axes stays near them",
    )
    home_rad: tuple[Finite, ...] | None = Field(
        default=None,
        description="joint angles that `move --to home` goes to; the middle of the joint ranges if absent",
    )
    loading_rad: tuple[Finite, ...] | None = Field(
        default=None,
        description="joint angles for mounting a load: `move --to loading`, also used by `commission`",
    )
    axis: tuple[AxisConfig, ...] = Field(description="one to eight of them, usually six, from the base on")

    @property
    def link_std(self) -> float:
        """Relative standard deviation of the link inertials of the URDF: 0 = exact, infinite = ignored."""
        return parse_inertials(self.inertials)

    @property
    def flange_origin(self) -> str | None:
        """Return the source of the flange; begins with `assumed` if its orientation is assumed.

        None without a flange.
        """
        if self.flange_xyz_m is None:
            return None
        if self.flange_source is not None:
            return self.flange_source
        return "cell file" if "flange_rpy_rad" in self.model_fields_set else "assumed: not rotated in the last link"

    @model_validator(mode="after")
    def _consistent(self) -> ArmConfig:
        refuse([*self._slips(), *self._space(), *self._units()])
        return self

    def _slips(self) -> plausible.Found:
        axes = len(self.axis)
        if not FEWEST_AXES <= axes <= MOST_AXES:
            what = f"arm '{self.name}' has {axes} [[arm.axis]] tables, {FEWEST_AXES} to {MOST_AXES} are handled"
            yield ("axis",), what
            return
        for name, length in self._lengths():
            if length != axes:
                yield (
                    (name,) if name in ArmConfig.model_fields else ("dh", name),
                    f"arm '{self.name}': {name} has {length} numbers but the arm has {axes} [[arm.axis]] tables; "
                    f"give one per axis",
                )
        ids = [axis.node_id for axis in self.axis]
        for number, node in enumerate(ids):
            if node in ids[:number]:
                what = f"arm '{self.name}': node id {node} is used for more than one axis: write that of its drive"
                yield ("axis", number, "node_id"), what
        yield from self._ratings()
        if (self.robot is None) == (self.dh is None):
            yield (), f"arm '{self.name}' needs either robot = \"FILE.urdf\" or [arm.dh], not both"
        if self.tip is not None and self.robot is None:
            yield ("tip",), f"arm '{self.name}': tip names a link of a URDF, and there is none: remove it"
        if self.coupling is not None:
            matrix = np.array(self.coupling, dtype=float) if len({*map(len, self.coupling)}) == 1 else np.zeros(0)
            if matrix.shape != (axes, axes) or abs(np.linalg.det(matrix)) < 1e-6:
                yield ("coupling",), f"arm '{self.name}': coupling must be an invertible {axes} x {axes} matrix"

    def _ratings(self) -> plausible.Found:
        """Check the rating of the arm."""
        for key in ("rated_load_kg", "rated_reach_m", "rated_moment_nm"):
            rated: SourcedNumber | None = getattr(self, key)
            if rated is not None and rated.value <= 0:
                yield (key,), f"arm '{self.name}': {key} must be positive"
            if rated is not None and key != "rated_load_kg" and self.flange_xyz_m is None:
                yield (key,), f"arm '{self.name}': {key} counts from the flange: write flange_xyz_m too"
        if self.rated_load_kg is not None:
            yield from plausible.beyond("load", "rated_load_kg.value", self.rated_load_kg.value)
        yield from plausible.beyond("load", "max_load_kg", self.max_load_kg or 0.0)

    def _space(self) -> plausible.Found:
        """Check postures and surroundings."""
        for name in ("home_rad", "loading_rad"):
            yield from self._outside(name, getattr(self, name) or ())
        for name in ("floor_m", "column_radius_m"):
            if getattr(self, name) is True:
                yield (name,), f"arm '{self.name}': {name} is a number in m, or false if it does not exist"
        if self.load_size_m is not None and self.load_points_m:
            yield ("load_points_m",), f"arm '{self.name}': give load_size_m or load_points_m, not both"

    def _units(self) -> plausible.Found:
        """Check for numbers in a wrong unit."""
        yield from plausible.gravity(self.gravity_m_s2)
        yield from plausible.speeds([axis.speed_limit_rad_s for axis in self.axis])
        for name in ("flange_rpy_rad", "base_rpy_rad", "tool_rpy_rad"):
            yield from plausible.beyond("angle of a frame", name, *getattr(self, name))
        for name in ("flange_xyz_m", "base_xyz_m", "tool_xyz_m", "rated_load_com_m", "max_load_com_m"):
            yield from plausible.beyond("length", name, *(getattr(self, name) or ()))
        for name in ("floor_m", "column_radius_m"):
            yield from plausible.beyond("length", name, getattr(self, name) or 0.0)
        for name in ("start_rad", "home_rad", "loading_rad"):
            yield from plausible.beyond("joint angle", name, *(getattr(self, name) or ()))
        if self.dh is not None:
            for name in ("alpha_rad", "theta_offset_rad"):
                yield from plausible.beyond("angle of a frame", f"dh.{name}", *getattr(self.dh, name))
            for name in ("a_m", "d_m"):
                yield from plausible.beyond("length", f"dh.{name}", *getattr(self.dh, name))

    def _outside(self, name: str, q_rad: tuple[float, ...]) -> plausible.Found:
        """Check that the joints of a posture are within their ranges."""
        for joint, (value, axis) in enumerate(zip(q_rad, self.axis, strict=False), start=1):
            low, high = axis.position_limit_rad
            if not low <= value <= high:
                what = f"joint {joint} at {value:g} rad is outside its position_limit_rad [{low:g}, {high:g}]"
                yield (name, joint - 1), f"arm '{self.name}': {name} puts {what}"

    def _lengths(self) -> Iterator[tuple[str, int]]:
        """Return the keys that hold one number per axis, with their lengths."""
        if self.dh is not None:
            yield from ((name, len(getattr(self.dh, name))) for name in ("alpha_rad", "a_m", "d_m", "theta_offset_rad"))
        if isinstance(self.link_radius_m, tuple):
            yield "link_radius_m", len(self.link_radius_m)
        for name in ("start_rad", "home_rad", "loading_rad"):
            if getattr(self, name) is not None:
                yield name, len(getattr(self, name))


class PosesConfig(Strict):
    """Number of rest poses, and settings of approach, settling and sampling."""

    count: int = Field(default=10, ge=2, description="number of poses for the fit")
    approach_offset_rad: Positive = Field(
        default=0.03, description="distance of the approach to each pose, from both directions"
    )
    approach_speed_rad_s: Positive = Field(default=0.05, description="speed of the approach")
    samples: int = Field(default=100, ge=10, description="SYNCs averaged per approach direction")
    validation: int = Field(default=4, ge=0, description="validation poses, not used in the fit")
    settle_timeout_s: Positive = Field(default=10.0, description="longest wait for rest")
    seed: int = Field(default=1, ge=0, description="of the choice of poses")
    file: str | None = Field(default=None, description="CSV with pose, q1_rad .. qN_rad instead of chosen poses")


class Cell(Strict):
    """Content of the cell file."""

    name: PlainName = Field(description="of the cell")
    bus: dict[str, BusConfig] = Field(description="one table a bus: [bus.a]")
    arm: tuple[ArmConfig, ...] = Field(min_length=1, description="one table an arm: [[arm]]")
    poses: PosesConfig = Field(default=PosesConfig(), description="rest poses")
    pair: PairConfig | None = Field(default=None, description="two arms with one workpiece")

    @model_validator(mode="after")
    def _consistent(self) -> Cell:
        refuse([*self._slips()])
        if self.pair is not None:
            _check_pair(self.pair, self)
        return self

    def _slips(self) -> plausible.Found:
        names = [arm.name for arm in self.arm]
        wires: dict[str, str] = {}
        for name, bus in self.bus.items():
            other = wires.setdefault(bus.spec.wire, name)
            if other != name:
                what = f"[bus.{name}] and [bus.{other}] are both {bus.interface} {bus.channel}: one bus has one master"
                yield ("bus", name, "channel"), f"{what}; write one table, and its name to each arm's bus"
        taken: dict[tuple[str, int], str] = {}
        for number, arm in enumerate(self.arm):
            if arm.name in names[:number]:
                yield ("arm", number, "name"), f"two arms have the same name '{arm.name}': write another one"
            if arm.bus not in self.bus:
                known = " or ".join(f'"{name}"' for name in self.bus)
                what = f"arm '{arm.name}' names bus '{arm.bus}', but there is no [bus.{arm.bus}]: write bus = {known}"
                yield ("arm", number, "bus"), what
            for joint, axis in enumerate(arm.axis):
                if taken.setdefault((arm.bus, axis.node_id), arm.name) != arm.name:
                    what = f"bus '{arm.bus}': node id {axis.node_id} is used by two arms"
                    yield ("arm", number, "axis", joint, "node_id"), what


#: A hand that is controlled in all six directions needs six axes.
FEWEST_PAIR_AXES = 6


def _check_pair(pair: PairConfig, cell: Cell) -> None:
    arms = {arm.name: arm for arm in cell.arm}
    for role in ("master", "slave"):
        name = getattr(pair, role)
        if name not in arms:
            raise ValueError(f"pair: {role} = '{name}' is not an arm of this cell; it has {', '.join(arms)}")
        if arms[name].start_rad is None:
            raise ValueError(f"arm '{name}' is the {role} of a pair and needs start_rad")
        if len(arms[name].axis) < FEWEST_PAIR_AXES:
            raise ValueError(
                f"arm '{name}' is the {role} of a pair and has {len(arms[name].axis)} axes; a hand that holds a part"
                f" with another one needs an arm of at least {FEWEST_PAIR_AXES} axes"
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
    """A cell, the text it was read from, the folder its relative paths start at, and the calibration file's text."""

    cell: Cell
    text: str
    folder: Path
    calibration: str = ""
    _profiles: dict[str, DriveProfile] = PrivateAttr(default_factory=dict)

    def profile(self, name: str) -> DriveProfile:
        """Return the drive profile of this name, as `find_profile`; each is read once, also for copies of the cell."""
        if name not in self._profiles:
            # imported here: a cell is read by commands that reach no drive and need not load its libraries
            from drives.profile_file import find_profile

            self._profiles[name] = find_profile(name, self.folder)
        return self._profiles[name]

    def path(self, name: str) -> Path:
        """Return the path of a file named in the cell."""
        return (self.folder / name).resolve()


def parse_cell(text: str, where: str) -> Cell:
    """Validate the text of a cell file.

    Raises
    ------
    ConfigError
        With every problem of the file: line, joint, what is wrong, what to write.
    """
    try:
        return read_strict(text, Cell)
    except Unfit as error:
        raise ConfigError.of(error.messages(where, partial(_place, text))) from error


def _place(text: str, path: KeyPath) -> str:
    """Return the joint (`J1`) of a key path in the cell; with the arm if there are several."""
    if len(path) < 2 or path[0] != "arm" or not isinstance(path[1], int):
        return ""
    arms = sum(1 for each in key_lines(text) if len(each) == 2 and each[0] == "arm")
    arm = [f"arm {path[1] + 1}"] if arms > 1 else []
    joint = [f"J{path[3] + 1}"] if len(path) > 3 and path[2] == "axis" and isinstance(path[3], int) else []
    return " ".join([*arm, *joint])


def cell_schema() -> dict[str, Any]:
    """Return the JSON schema of the cell file."""
    return Cell.model_json_schema()


def load_cell(path: Path) -> LoadedCell:
    """Read a cell file, and the calibration file beside it, from disk."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    cell = parse_cell(text, str(path))
    return LoadedCell(cell=cell, text=text, folder=path.resolve().parent, calibration=read_calibration(path))


def with_sync_period(loaded: LoadedCell, bus: str, sync_period_s: float) -> LoadedCell:
    """Return the same cell with another SYNC period on one bus."""
    buses = loaded.cell.bus | {bus: loaded.cell.bus[bus].model_copy(update={"sync_period_s": sync_period_s})}
    return loaded.model_copy(update={"cell": loaded.cell.model_copy(update={"bus": buses})})


def with_pacing(loaded: LoadedCell, pacing: str | None) -> LoadedCell:
    """Return the same cell with another pacing on every bus; None = unchanged."""
    if pacing is None:
        return loaded
    buses = {name: bus.model_copy(update={"pacing": pacing}) for name, bus in loaded.cell.bus.items()}
    return loaded.model_copy(update={"cell": loaded.cell.model_copy(update={"bus": buses})})
