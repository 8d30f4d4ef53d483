"""Decode the unit of the speed of a drive: 0x60A9, SI unit velocity (CiA 402-2; notation of CiA 303-2)."""

from __future__ import annotations

import math
from typing import Final

from drives.draft.device import Device

ADDRESS: Final = (0x60A9, 0)
#: Numerator: radian and revolution; denominator: second and minute.
_TURN_RAD: Final = {0x10: 1.0, 0xB4: 2.0 * math.pi}
_TIME_S: Final = {0x03: 1.0, 0x47: 60.0}


def velocity_unit_rad_s(device: Device) -> tuple[float, str] | None:
    """Return the motor speed of one bit of 0x606C [rad/s] and its source; None where the drive does not report it."""
    found = device.value_of(*ADDRESS)
    if found is None:
        return None
    unit = unit_rad_s(found[0])
    return None if unit is None else (unit, f"{found[1]} = 0x{found[0]:08X}")


def unit_rad_s(code: int) -> float | None:
    """Unit of a code: power of ten, numerator, denominator, one byte each from the top; None where it is not a
    speed.
    """
    exponent, numerator, denominator = (code >> 24) & 0xFF, (code >> 16) & 0xFF, (code >> 8) & 0xFF
    turn, time = _TURN_RAD.get(numerator), _TIME_S.get(denominator)
    if turn is None or time is None or code & 0xFF:
        return None
    return turn / time * 10.0 ** (exponent - 256 if exponent > 127 else exponent)
