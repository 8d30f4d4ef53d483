"""Decoders that convert the TPDO frames of one SYNC to drive readings in SI, with precomputed scale factors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drives.pdo import tpdo_plans
from drives.scaling import MotorScale
from drives.values import AxisSetup, DriveReading

Frames = Sequence[bytes | bytearray | None]
#: (SYNC index, frames of all drives) -> reading, None where a frame of this drive is missing.
Decoder = Callable[[int, Frames], DriveReading | None]


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
