"""Detection of unit errors: degrees, millimetres, percent, an inverted ratio. Each message states the valid range.

The ranges include every commercial arm, motor and gear, and exclude values in a wrong unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from drives.toml_lines import KeyPath

#: Two turns [rad]: no joint of an arm is moved further to be measured; 720 degrees would be read as 115 turns.
LARGEST_ANGLE_RAD: Final = 4 * math.pi
#: A turn of a frame [rad].
LARGEST_TURN_RAD: Final = 2 * math.pi
#: Faster than the hand axes of the fastest small arms, 1000 degrees a second [rad/s].
LARGEST_SPEED_RAD_S: Final = 20.0
#: A joint that is a quarter turn behind does not follow [rad].
LARGEST_FOLLOWING_RAD: Final = math.pi / 2
#: Larger than any arm of this kind [m].
LARGEST_LENGTH_M: Final = 20.0
#: From the last joint to the centre of gravity of any load [m].
LARGEST_LEVER_M: Final = 5.0
#: More than any six-axis arm carries: the strongest are rated for 2.3 t [kg].
LARGEST_LOAD_KG: Final = 3000.0
#: More than joint 2 of the strongest six-axis arms has [Nm].
LARGEST_TORQUE_NM: Final = 200_000.0
#: How many times its rated load an arm is taken to hold at all.
OVERLOAD: Final = 5.0
#: Motor turns a joint turn: from a direct drive to a gear of four planetary stages of 10.
RATIOS: Final = (1.0, 10_000.0)
#: [Nm/A]: from a motor as thick as a finger to the largest servo motors; those without a gear turn slower.
CONSTANTS_NM_PER_A: Final = (0.001, 10.0)
DIRECT_CONSTANTS_NM_PER_A: Final = (0.001, 100.0)
#: Largest ratio of what counts as a motor without a gear.
DIRECT_RATIO: Final = 5.0
#: Of the earth, from the equator to the poles, with a margin [m/s2].
GRAVITY_M_S2: Final = (9.7, 9.9)

Found = Iterator[tuple[KeyPath, str]]


def angles(key: str, values_rad: Sequence[float], largest_rad: float = LARGEST_ANGLE_RAD) -> Found:
    """Refuse angles that are only plausible in degrees."""
    worst = max(values_rad, key=abs, default=0.0)
    if abs(worst) > largest_rad:
        in_rad = ", ".join(f"{math.radians(value):.4g}" for value in values_rad)
        value = f"[{in_rad}]" if len(values_rad) > 1 else in_rad
        yield (
            (key,),
            f"{key}: {worst:g} rad is beyond {largest_rad:.4g}, these are degrees: write {key} = {value}",
        )


def speed(key: str, value_rad_s: float) -> Found:
    """Refuse a speed that is only plausible in degrees per second."""
    if value_rad_s > LARGEST_SPEED_RAD_S:
        yield (
            (key,),
            f"{key}: {value_rad_s:g} rad/s is beyond {LARGEST_SPEED_RAD_S:g}, these are degrees a second:"
            f" write {key} = {math.radians(value_rad_s):.4g}",
        )


def lengths(key: str, values_m: Sequence[float] | None) -> Found:
    """Refuse lengths that are only plausible in millimetres."""
    worst = max(values_m or (), key=abs, default=0.0)
    if abs(worst) > LARGEST_LENGTH_M:
        in_m = ", ".join(f"{value / 1000:g}" for value in values_m or ())
        value = f"[{in_m}]" if len(values_m or ()) > 1 else in_m
        yield (
            (key,),
            f"{key}: {worst:g} m is beyond {LARGEST_LENGTH_M:g}, these are millimetres: write {key} = {value}",
        )


def ratio(value: float) -> Found:
    """Refuse a gear ratio outside the range of servo gears."""
    low, high = RATIOS
    if not low <= abs(value) <= high:
        turned = f"; inverted? write value = {1 / value:.4g}" if 0 < abs(value) < low else ""
        yield (
            ("gear_ratio",),
            f"gear_ratio must not be {value:g}: motor turns per joint turn are between {low:g} and {high:g}{turned}",
        )


def torque_constant(value_nm_per_a: float, gear_ratio: float) -> Found:
    """Refuse a torque constant outside the range of servo motors."""
    direct = abs(gear_ratio) <= DIRECT_RATIO
    low, high = DIRECT_CONSTANTS_NM_PER_A if direct else CONSTANTS_NM_PER_A
    if not low <= value_nm_per_a <= high:
        milli = f"; in mNm/A? write value = {value_nm_per_a / 1000:g}" if low <= value_nm_per_a / 1000 <= high else ""
        kind = "a motor without a gear" if direct else "a motor with a gear"
        yield (
            ("torque_constant_nm_per_a",),
            f"torque_constant_nm_per_a must be positive and of a motor: {value_nm_per_a:g} Nm/A is not, {kind} has"
            f" {low:g} to {high:g}{milli}",
        )


def efficiency(value: float) -> Found:
    """Refuse an invalid efficiency."""
    if not 0 < value <= 1:
        percent = f"; in percent? write value = {value / 100:g}" if 1 < value <= 100 else ""
        yield ("gear_efficiency",), f"gear_efficiency must be in (0, 1], got {value:g}{percent}"


def mass(key: str, value_kg: float) -> Found:
    """Refuse a load mass above that of any arm."""
    if value_kg > LARGEST_LOAD_KG:
        yield (
            (key,),
            f"{key}: {value_kg:g} kg is beyond {LARGEST_LOAD_KG:g} kg, more than any six-axis arm carries: grams? write"
            f" {value_kg / 1000:g}",
        )


def torque_limit(value_nm: float) -> Found:
    """Refuse a torque limit above that of any joint."""
    if value_nm > LARGEST_TORQUE_NM:
        yield (
            ("torque_limit_nm",),
            f"torque_limit_nm: {value_nm:g} Nm is beyond {LARGEST_TORQUE_NM:g} Nm, more than any joint has: mNm? write"
            f" torque_limit_nm = {value_nm / 1000:g}",
        )


def gravity(values_m_s2: Sequence[float]) -> Found:
    """Refuse a gravity that is not that of the earth."""
    low, high = GRAVITY_M_S2
    size = math.hypot(*values_m_s2)
    if not low <= size <= high:
        yield (
            ("gravity_m_s2",),
            f"gravity_m_s2: its length is {size:g}, on earth {low:g} to {high:g} m/s2: write [0, 0, -9.80665] for a "
            f"floor-mounted arm",
        )
