"""Table [pair] of a cell file.

Two arms that carry one part with force control, or keep a gap between their grippers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from drives.validation import Strict
from gateway.cell.quantities import Finite, Positive, Vector3
from gateway.errors import ConfigError

#: What only a common part needs.
_OF_FORCE = ("force_limit_n", "contact_stiffness", "impedance_damping")

Component = Literal["x", "y", "z", "rx", "ry", "rz"]


class SixFold(Strict):
    """A number for the three straight directions [N/m, Ns/m, N, m] and one for the three turns [per rad]."""

    straight: Positive = Field(description="along x, y and z")
    turned: Positive = Field(description="about x, y and z")


class ChannelConfig(Strict):
    """One distance sensor: mounted on one gripper, measures to a plane on the part of the other one."""

    subindex: int = Field(ge=1, le=254, description="channel of the measuring device")
    on: Literal["master", "slave"] = Field(default="slave", description="gripper that carries the sensor")
    at_m: Vector3 = Field(description="origin of the distance, in the fingertip frame of that gripper")
    beam: Vector3 = Field(description="measuring direction, same frame; perpendicular to the plane at the required gap")
    gap_m: Positive = Field(description="demanded distance")

    @model_validator(mode="after")
    def _looks_somewhere(self) -> ChannelConfig:
        if not np.linalg.norm(self.beam) > 0.0:
            raise ValueError(f"channel {self.subindex}: beam = (0, 0, 0) is not a direction")
        return self


class DistanceConfig(Strict):
    """Distance sensors on a CANopen measuring device (CiA 404), read with the drives of its bus."""

    bus: str = Field(description="of the master or of the slave")
    node_id: int = Field(ge=1, le=127, description="of the measuring device")
    object: int = Field(ge=0x2000, le=0xFFFF, description="process values: 0x9130 (i32), 0x7130 (i16)")
    type: Literal["i16", "i32"] = Field(description="of a process value")
    lsb_m: Positive = Field(description="distance that one bit means")
    status_object: int | None = Field(default=None, ge=0x2000, le=0xFFFF, description="0x6150; absent: it has none")
    components: tuple[Component, ...] = Field(
        default=("x", "y", "z", "rx", "ry", "rz"), min_length=1, description="corrected, axes of the master's gripper"
    )
    range_m: tuple[Finite, Finite] = Field(description="a distance outside stops both arms")
    missing_cycles: int = Field(default=5, ge=1, description="as many cycles in a row without a value stop both arms")
    damping_s: SixFold | None = Field(default=None, description="time in which a gap error is corrected; absent: 0.045")
    channel: tuple[ChannelConfig, ...] = Field(min_length=1, description="one table a sensor")

    @model_validator(mode="after")
    def _consistent(self) -> DistanceConfig:
        low, high = self.range_m
        if not 0.0 <= low < high:
            raise ValueError(f"range_m {self.range_m} must rise from 0 on")
        for channel in self.channel:
            if not low < channel.gap_m < high:
                raise ValueError(f"gap_m of channel {channel.subindex} is outside range_m {self.range_m}")
        for name, values in (("subindex", [one.subindex for one in self.channel]), ("components", self.components)):
            if len(set(values)) != len(values):
                raise ValueError(f"{name} has the same entry twice")
        return self


@dataclass(frozen=True, slots=True)
class ForceSettings:
    """Force control of a common part: limit [N], stiffness of part and gears, impedance."""

    limit_n: float
    stiffness: SixFold
    damping: SixFold
    spring: SixFold | None


class PairConfig(Strict):
    """Two arms that carry one workpiece; the frame of the part is at its centre.

    With `distance` the master carries the part alone and the slave keeps a gap to it, without touching.
    """

    master: str = Field(description="arm that leads")
    slave: str = Field(description="arm that follows")
    path: str = Field(description="CSV: time_s and the part's pose in the world x_m .. yaw_rad")
    speed: Positive = Field(default=1.0, description="speed setting; 1 = speed of the path")
    part_mass_kg: Positive = Field(description="of the workpiece")
    master_grasp_xyz_m: Vector3 = Field(description="fingertip of the master in the part's frame")
    master_grasp_rpy_rad: Vector3 = Field(description="its orientation, roll, pitch, yaw")
    slave_grasp_xyz_m: Vector3 = Field(description="fingertip of the slave in the part's frame")
    slave_grasp_rpy_rad: Vector3 = Field(description="its orientation, roll, pitch, yaw")
    force_limit_n: Positive | None = Field(
        default=None, description="largest internal force of the part; twice this value for 20 ms stops both arms"
    )
    contact_stiffness: SixFold | None = Field(
        default=None, description="of part and gears together, what the correction works against"
    )
    impedance_damping: SixFold | None = Field(default=None, description="impedance of the compliant arm")
    impedance_stiffness: SixFold | None = Field(default=None, description="absent: corrects until no force is left")
    knots: int = Field(default=9, ge=2, description="number of taught points, evenly distributed over the path")
    servo_lag_s: Positive = Field(default=0.016, description="delay of the axes behind their setpoints")
    loop_delay_s: Positive = Field(default=0.035, description="from a force or gap to the correction that answers it")
    force_filter_hz: Positive = Field(default=15.0, description="low-pass of the estimated force")
    distance: DistanceConfig | None = Field(default=None, description="a gap instead of a common part")

    @model_validator(mode="after")
    def _force_or_distance(self) -> PairConfig:
        for name in (*_OF_FORCE, "impedance_stiffness"):
            stated = getattr(self, name) is not None
            if stated and self.distance is not None:
                raise ValueError(f"{name} is for a common part; with [pair.distance] there is none: omit it")
            if not stated and self.distance is None and name in _OF_FORCE:
                raise ValueError(f"{name} is missing and has no default")
        return self

    @property
    def force(self) -> ForceSettings:
        """Return the settings of force control.

        Raises
        ------
        ConfigError
            The arms keep a gap; there is no common part.
        """
        limit_n, stiffness, damping = self.force_limit_n, self.contact_stiffness, self.impedance_damping
        if limit_n is None or stiffness is None or damping is None:
            raise ConfigError(
                "the cell keeps a gap by distance sensors ([pair.distance]): there is no common part for force control"
            )
        return ForceSettings(limit_n, stiffness, damping, self.impedance_stiffness)
