"""Values exchanged with the drive layer, motor side: setup and commands in, readings out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from drives.errors import ProfileError
from drives.pdo import OFFSETS, Offsets
from drives.profile import DriveProfile


@dataclass(frozen=True, slots=True)
class AxisSetup:
    """Settings of a drive from the cell file.

    Attributes
    ----------
    node_id : int
        1 to 127.
    profile : DriveProfile
        Of its model.
    torque_constant_nm_per_a : float
        Of the motor, Nm/A; used only where the profile measures a current.
    max_motor_speed_rad_s : float
        Largest speed that may be commanded, motor side.
    position_limit_rad : (float, float), optional
        Lowest and highest target that may be commanded, motor side; an axis outside may only move inwards.
    torque_limit_nm : float, optional
        Lowest torque limit that may be set in the drive (0x6072), motor side; None = the drive's own is unchanged.
    offsets : tuple of str
        Offsets that are mapped and sent at each SYNC: "velocity" (0x60B1), "torque" (0x60B2).

    Raises
    ------
    ProfileError
        A number that is missing, not finite or out of range.
    """

    node_id: int
    profile: DriveProfile
    torque_constant_nm_per_a: float
    max_motor_speed_rad_s: float
    position_limit_rad: tuple[float, float] | None = None
    offsets: Offsets = ()
    torque_limit_nm: float | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.node_id <= 127:
            raise ProfileError(f"node id {self.node_id} is not in 1 .. 127", advice="correct the cell file")
        for name in ("torque_constant_nm_per_a", "max_motor_speed_rad_s", "torque_limit_nm"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                what = f"{name} = {value}, a positive number is needed"
                raise ProfileError(what, node=self.node_id, advice="nothing is assumed in its place")
        limit = self.position_limit_rad
        if limit is not None and not (-math.inf < limit[0] < limit[1] < math.inf):
            what = f"position limits {limit} rad are not in order"
            raise ProfileError(what, node=self.node_id, advice="correct the cell file")
        if "velocity" in self.offsets and self.profile.feedforward is None:
            what = f"profile {self.profile.name} has no [feedforward]: the drive takes no velocity offset 0x60B1"
            raise ProfileError(what, node=self.node_id, advice="follow the path without feedforward on this drive")
        for name in self.offsets:
            if OFFSETS[name].index not in self.profile.write.allow:
                what = f"profile {self.profile.name} does not allow the {name} offset 0x{OFFSETS[name].index:04X}"
                advice = "add it to write.allow if the drive has the object; without it this command cannot run"
                raise ProfileError(what, node=self.node_id, index=OFFSETS[name].index, advice=advice)


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """Target of one SYNC, motor side; a velocity offset only for a drive that was set up with feedforward."""

    position_rad: float
    torque_offset_nm: float = 0.0
    velocity_offset_rad_s: float = 0.0


class DriveReading(NamedTuple):
    """Reading of one drive at one SYNC, raw and in SI, motor side.

    A tuple, since one is made per axis and SYNC: it costs a quarter of a frozen dataclass.

    Attributes
    ----------
    node_id, sync_index : int
        Node, and SYNC after which it was received.
    statusword, position_count, torque_word : int
        As received.
    velocity_word, current_word : int or None
        As received; None = not mapped.
    position_rad, torque_nm : float
        By the profile's arithmetic.
    velocity_rad_s, current_a : float or None
        The current in the ampere (rms or peak) that the torque constant refers to.
    """

    node_id: int
    sync_index: int
    statusword: int
    position_count: int
    torque_word: int
    velocity_word: int | None
    current_word: int | None
    position_rad: float
    torque_nm: float
    velocity_rad_s: float | None
    current_a: float | None


class InstrumentReading(NamedTuple):
    """Reading of one measuring device at one SYNC.

    Attributes
    ----------
    node_id, sync_index : int
        Who, and after which SYNC.
    raw : tuple of int
        As received, one per channel.
    values : tuple of float or None
        In the SI unit of its setup; None = the device reports the channel as invalid.
    """

    node_id: int
    sync_index: int
    raw: tuple[int, ...]
    values: tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of the device at a node id; None = the device lacks the object, or it was not read."""

    node_id: int
    device_type: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None
    name: str | None = None
    hardware_version: str | None = None
    software_version: str | None = None

    @property
    def is_drive(self) -> bool:
        """Return whether the device type is CiA 402."""
        return self.device_type is not None and self.device_type & 0xFFFF == 0x0192

    def mismatches(self, profile: DriveProfile) -> dict[int, str]:
        """Return the mismatches with the profile's identity as text, by subindex of 0x1018."""
        wanted = profile.identity
        found = dict[int, str]()
        for subindex, name, want, have in (
            (1, "vendor id", wanted.vendor_id, self.vendor_id),
            (2, "product code", wanted.product_code, self.product_code),
        ):
            if want is not None and want != have:
                found[subindex] = f"{name} is {_hex(have)} instead of {_hex(want)}"
        low, high = wanted.revision_min, wanted.revision_max
        if (low is not None or high is not None) and self.revision is None:
            found[3] = "revision is not given by the drive"
        elif low is not None and self.revision is not None and self.revision < low:
            found[3] = f"revision {_hex(self.revision)} is below {_hex(low)}"
        elif high is not None and self.revision is not None and self.revision > high:
            found[3] = f"revision {_hex(self.revision)} is above {_hex(high)}"
        return found


def _hex(value: int | None) -> str:
    return "missing" if value is None else f"0x{value:08X}"
