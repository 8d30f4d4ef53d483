"""Raw object values and TPDO frames as SI values on the motor side, by the arithmetic of the profile.

Everything is linear, so the cyclic path multiplies by factors that are computed here once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drives.errors import ConfigurationRefused, ProfileError
from drives.pdo import tpdo_plans
from drives.profile import (
    NO_RESOLUTION,
    CountsFromObjects,
    DriveProfile,
    ObjectReference,
    Reader,
    Signal,
    current_factor,
)
from drives.values import AxisSetup, DriveReading

Frames = Sequence[bytes | bytearray | None]
#: (SYNC index, frames of all drives) -> reading, None where a frame of this drive is missing.
Decoder = Callable[[int, Frames], DriveReading | None]


@dataclass(frozen=True, slots=True)
class Constants:
    """Constants read from the drive, in SI; None = the profile does not require them.

    Attributes
    ----------
    torque_rated : float or None
        Nm (kind permille_rated_torque) or A (permille_rated_current) of 1000 per mille of the torque object.
    current_rated_a : float or None
        A of 1000 per mille of the current object.
    offset_rated : float or None
        Nm or A of 1000 per mille of 0x60B2, where it has an arithmetic of its own.
    counts_per_revolution : float
        Position counts of one motor revolution.
    """

    torque_rated: float | None
    current_rated_a: float | None
    offset_rated: float | None
    counts_per_revolution: float


@dataclass(frozen=True, slots=True)
class MotorScale:
    """Factors between raw object values and SI units, motor side.

    Attributes
    ----------
    torque_nm : float
        Nm per bit of the torque object.
    current_a : float or None
        A per bit of the current object, in the ampere (rms or peak) that the torque constant refers to.
    velocity_rad_s : float or None
        rad/s per bit of the velocity object.
    count_rad : float
        rad per position count.
    offset_nm : float or None
        Nm per bit of 0x60B2; None = the profile does not state it, and only zero may be sent.
    constants : Constants
        Of the drive, from which the factors were computed.
    """

    torque_nm: float
    current_a: float | None
    velocity_rad_s: float | None
    count_rad: float
    offset_nm: float | None
    constants: Constants

    def counts(self, position_rad: float) -> int:
        """Return the nearest position count of a motor angle [rad]."""
        return round(position_rad / self.count_rad)

    def revolutions(self, number: float) -> float:
        """Return the counts of a number of motor revolutions, not rounded."""
        return number * 2.0 * math.pi / self.count_rad


def motor_scale(profile: DriveProfile, constants: Constants, torque_constant_nm_per_a: float) -> MotorScale:
    """Compute the factors of one axis.

    Parameters
    ----------
    profile : DriveProfile
        Its arithmetic.
    constants : Constants
        What was read from the drive.
    torque_constant_nm_per_a : float
        Of the motor, per ampere of the kind the profile states; used by profiles that measure current.

    Raises
    ------
    ProfileError
        A constant that is missing, zero, negative or not finite.
    """
    turn = _positive(profile, "counts per revolution", constants.counts_per_revolution)
    torque = _ampere_per_bit(profile, "torque", profile.torque, constants.torque_rated)
    if profile.torque.is_current:
        torque *= _positive(profile, "torque constant (Nm/A)", torque_constant_nm_per_a)
    current = None
    if profile.current is not None:
        current = _ampere_per_bit(profile, "current", profile.current, constants.current_rated_a)
    return MotorScale(
        torque_nm=torque,
        current_a=current,
        velocity_rad_s=None if profile.velocity is None else profile.velocity.rad_s(turn),
        count_rad=2.0 * math.pi / turn,
        offset_nm=_offset_nm(profile, constants, torque, torque_constant_nm_per_a),
        constants=constants,
    )


def _ampere_per_bit(profile: DriveProfile, what: str, signal: Signal, rated: float | None) -> float:
    """Return Nm per bit of a torque, or A (as used by the torque constant) per bit of a current."""
    if signal.is_current and None in (signal.current_reference, signal.torque_constant_per):
        advice = "give current_reference and torque_constant_per in the profile; no default is assumed"
        raise ProfileError(f"profile {profile.name}: {what} is a current, rms or peak is not known", advice=advice)
    if signal.kind == "internal_unit":
        if signal.internal_unit_a is None:
            raise ProfileError(f"{profile.name}: {what}.internal_unit_a is missing")
        return signal.internal_unit_a.value * current_factor(signal)
    if signal.kind == "milliampere":
        return 1e-3 * current_factor(signal)
    per_mille = _positive(profile, f"{what}: rated value", rated) / 1000.0
    return per_mille * current_factor(signal) if signal.is_current else per_mille


def _offset_nm(profile: DriveProfile, constants: Constants, torque_nm: float, kt: float) -> float | None:
    own = profile.torque_offset
    if own is None:
        return torque_nm if profile.torque.kind.startswith("permille") else None
    per_mille = _positive(profile, "torque_offset: rated value", constants.offset_rated) / 1000.0
    if own.kind == "permille_rated_torque":
        return per_mille
    return per_mille * current_factor(own) * _positive(profile, "torque constant (Nm/A)", kt)


def _positive(profile: DriveProfile, what: str, value: float | None) -> float:
    if value is None or not math.isfinite(value) or value <= 0:
        advice = "set it in the drive or give it in the profile or cell file; no default is assumed"
        raise ProfileError(f"profile {profile.name}: {what} is {value}, a positive number is needed", advice=advice)
    return value


def read_constants(profile: DriveProfile, read: Reader, node_id: int) -> Constants:
    """Return the constants that the profile takes from the drive: rated values and encoder resolution.

    Parameters
    ----------
    profile : DriveProfile
    read : Reader
        Of the drive, or of its recorded SDO answers.
    node_id : int
        For messages.

    Raises
    ------
    ConfigurationRefused
        A value that is missing or zero.
    SdoError
        An object cannot be read.
    """
    words, what = (profile.torque, profile.current, profile.torque_offset), "the rated value is not positive"
    rated = [
        word and word.rated and _known(word.rated.amount(read), word.rated.object, what, node_id) for word in words
    ]
    return Constants(*rated, counts_per_revolution=read_resolution(profile, read, node_id))


def read_resolution(profile: DriveProfile, read: Reader, node_id: int) -> float:
    """Return the position counts of one motor revolution; parameters and errors as `read_constants`."""
    counts = profile.position.counts_per_revolution
    where = counts.object if isinstance(counts, CountsFromObjects) else None
    return _known(profile.position.counts(read), where, NO_RESOLUTION, node_id)


def _known(value: float | None, where: ObjectReference | None, what: str, node_id: int) -> float:
    if value is None:
        index, subindex = (None, None) if where is None else (where.index, where.subindex)
        advice = "set it in the drive, or give it in the profile"
        raise ConfigurationRefused(what, node=node_id, index=index, subindex=subindex, advice=advice)
    return value


def reading_decoder(setup: AxisSetup, scale: MotorScale, slot: int = 0) -> Decoder:
    """Return the decoder of a drive with the TPDOs of `tpdo_plans`.

    Parameters
    ----------
    setup : AxisSetup
    scale : MotorScale
    slot : int
        Place of its first frame among those of all drives.
    """
    new_tuple = tuple.__new__
    node_id, (plans, roles) = setup.node_id, tpdo_plans(setup.profile, setup.node_id)
    count_rad, torque_nm = scale.count_rad, scale.torque_nm
    rad_s, ampere = scale.velocity_rad_s or 0.0, scale.current_a or 0.0
    first, *others = [plan.layout.unpack for plan in plans]
    second = others[0] if others else None
    at_velocity, at_current = (roles.index(each) if each in roles else None for each in ("velocity", "current"))

    def decode(sync_index: int, frames: Frames) -> DriveReading | None:
        data = frames[slot]
        if data is None:
            return None
        values = first(data)
        velocity = current = None
        if second is not None:
            more = frames[slot + 1]
            if more is None:
                return None
            values += second(more)
            velocity = None if at_velocity is None else values[at_velocity]
            current = None if at_current is None else values[at_current]
        position, torque = values[1], values[2]
        # half the time of DriveReading(...), for each axis at each SYNC
        fields = (
            node_id,
            sync_index,
            values[0],
            position,
            torque,
            velocity,
            current,
            position * count_rad,
            torque * torque_nm,
            None if velocity is None else velocity * rad_s,
            None if current is None else current * ampere,
        )
        return new_tuple(DriveReading, fields)

    return decode
