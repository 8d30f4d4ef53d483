"""The [pair] of a cell file: two arms that carry one part and feel it, or that keep a gap between their hands."""

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
    """One distance sensor: it sits on one gripper, and looks at a plane of what the other one carries."""

    subindex: int = Field(ge=1, le=254, description="channel of the measuring device")
    on: Literal["master", "slave"] = Field(default="slave", description="gripper that carries the sensor")
    at_m: Vector3 = Field(description="where the distance counts from, in that gripper's fingertip frame")
    beam: Vector3 = Field(description="direction it looks in, same frame; at the demanded gap the plane faces it")
    gap_m: Positive = Field(description="demanded distance")

    @model_validator(mode="after")
    def _looks_somewhere(self) -> ChannelConfig:
        if not np.linalg.norm(self.beam) > 0.0:
            raise ValueError(f"channel {self.subindex}: beam = (0, 0, 0) is no direction")
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
                raise ValueError(f"gap_m of channel {channel.subindex} lies outside range_m {self.range_m}")
        for name, values in (("subindex", [one.subindex for one in self.channel]), ("components", self.components)):
            if len(set(values)) != len(values):
                raise ValueError(f"{name} has the same entry twice")
        return self


@dataclass(frozen=True, slots=True)
class ForceSettings:
    """How a common part is felt: limit [N], stiffness of part and gears, impedance of a yielding hand."""

    limit_n: float
    stiffness: SixFold
    damping: SixFold
    spring: SixFold | None


class PairConfig(Strict):
    """Two arms that carry one workpiece; the part's frame lies in its centre.

    With `distance` the master carries the part alone and the slave keeps a gap to it, without touching.
    """

    master: str = Field(description="arm that leads")
    slave: str = Field(description="arm that follows")
    path: str = Field(description="CSV: time_s and the part's pose in the world x_m .. yaw_rad")
    speed: Positive = Field(default=1.0, description="speed setting; 1 = as the path says")
    part_mass_kg: Positive = Field(description="of the workpiece")
    master_grasp_xyz_m: Vector3 = Field(description="fingertip of the master in the part's frame")
    master_grasp_rpy_rad: Vector3 = Field(description="its turn, roll, pitch, yaw")
    slave_grasp_xyz_m: Vector3 = Field(description="fingertip of the slave in the part's frame")
    slave_grasp_rpy_rad: Vector3 = Field(description="its turn, roll, pitch, yaw")
    force_limit_n: Positive | None = Field(
        default=None, description="largest force inside the part; twice of it for 20 ms stops both arms"
    )
    contact_stiffness: SixFold | None = Field(
        default=None, description="of part and gears together, what the correction works against"
    )
    impedance_damping: SixFold | None = Field(default=None, description="of a hand that yields")
    impedance_stiffness: SixFold | None = Field(default=None, description="absent: corrects until no force is left")
    knots: int = Field(default=9, ge=2, description="points that are taught, evenly spread over the way")
    servo_lag_s: Positive = Field(default=0.016, description="by which the axes follow their set points")
    loop_delay_s: Positive = Field(default=0.035, description="from a force or gap to the correction that answers it")
    force_filter_hz: Positive = Field(default=15.0, description="low-pass of the force that is felt")
    distance: DistanceConfig | None = Field(default=None, description="a gap instead of a common part")

    @model_validator(mode="after")
    def _force_or_distance(self) -> PairConfig:
        for name in (*_OF_FORCE, "impedance_stiffness"):
            given = getattr(self, name) is not None
            if given and self.distance is not None:
                raise ValueError(f"{name} is of a common part; with [pair.distance] there is none, leave it out")
            if not given and self.distance is None and name in _OF_FORCE:
                raise ValueError(f"{name} is missing; nothing is assumed in its place")
        return self

    @property
    def force(self) -> ForceSettings:
        """What is needed to feel the part.

        Raises
        ------
        ConfigError
            The hands keep a gap, there is no part between them.
        """
        limit_n, stiffness, damping = self.force_limit_n, self.contact_stiffness, self.impedance_damping
        if limit_n is None or stiffness is None or damping is None:
            raise ConfigError(
                "the cell keeps a gap by distance sensors ([pair.distance]): there is no common part to be felt"
            )
        return ForceSettings(limit_n, stiffness, damping, self.impedance_stiffness)
