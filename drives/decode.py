"""Decoders that convert the TPDO frames of one SYNC to drive readings in SI, with precomputed scale factors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from drives.scaling import MotorScale
from drives.values import DriveReading

Frames = Sequence[bytes | bytearray | None]
#: (SYNC index, frames of all drives) -> reading, None where a frame of this drive is missing.
Decoder = Callable[[int, Frames], DriveReading | None]
Unpack = Callable[[Any], tuple[int, ...]]


class Fields(NamedTuple):
    """Objects that TPDO2 carries besides the torque."""

    velocity: bool
    current: bool


def single_decoder(node_id: int, slot: int, unpack: Unpack, scale: MotorScale) -> Decoder:
    """Return the decoder of a drive with one TPDO: statusword, position, torque.

    Parameters
    ----------
    node_id : int
    slot : int
        Place of its frame among those of all drives.
    unpack : callable
        Of the frame.
    scale : MotorScale
    """
    count_rad, torque_nm = scale.count_rad, scale.torque_nm

    def decode(sync_index: int, frames: Frames) -> DriveReading | None:
        data = frames[slot]
        if data is None:
            return None
        status, position, torque = unpack(data)
        return DriveReading(
            node_id,
            sync_index,
            status,
            position,
            torque,
            None,
            None,
            position * count_rad,
            torque * torque_nm,
            None,
            None,
        )

    return decode


def double_decoder(
    node_id: int, slot: int, unpack: tuple[Unpack, Unpack], scale: MotorScale, fields: Fields
) -> Decoder:
    """Return the decoder of a drive with two TPDOs: statusword, position, torque, then the fields of `fields`."""
    count_rad, torque_nm = scale.count_rad, scale.torque_nm
    rad_s, ampere = scale.velocity_rad_s or 0.0, scale.current_a or 0.0
    has_velocity, has_current = fields
    first, second = unpack

    def decode(sync_index: int, frames: Frames) -> DriveReading | None:
        data, more = frames[slot], frames[slot + 1]
        if data is None or more is None:
            return None
        values = first(data) + second(more)
        position, torque = values[1], values[2]
        velocity = values[3] if has_velocity else None
        current = values[-1] if has_current else None
        return DriveReading(
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

    return decode
