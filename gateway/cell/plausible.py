"""Detection of unit errors: degrees, millimetres, percent, an inverted ratio. Each message states the valid range.

The ranges include every commercial arm, motor and gear, and exclude values in a wrong unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from drives.toml_lines import KeyPath

#: Two turns [rad]: no joint of an arm is moved further to be measured; 720 degrees would be read as 115 turns.
LARGEST_ANGLE_RAD: Final = 4 * math.pi
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
#: A speed limit [rad/s] or acceleration [rad/s2] that was lowered for a first motion does not make the other limits
#: implausible: from here on down their bounds stay the same.
LOWERED_SPEED_RAD_S: Final = 0.5
LOWERED_RAMP_RAD_S2: Final = 2.0
#: Joints from the base on with the lower bound of the speed; the others are taken for those of a wrist.
LARGE_JOINTS: Final = 3

_GENEROUS: Final = "generous bound"
_GP4: Final = "ros-industrial/motoman, motoman_gp4_support/urdf/gp4_macro.xacro: J3 9.2 rad/s"
_TX2: Final = "ros-industrial/staubli_experimental, staubli_tx2_60_support/urdf/tx2_60_macro.xacro: J6 25.2 rad/s"
_RAMP: Final = "ICube-Robotics/staubli_driver_ros2, staubli_robot_description/config/tx2_60l/joint_limits.yaml: 167 ms"
#: Of trajectories. The interface of that arm accepts 2 ms (libfranka: 15 rad/s2, 7500 rad/s3), at setpoints every 1 ms.
_PANDA: Final = "moveit/moveit_resources, panda_moveit_config/config/joint_limits.yaml: J2 6.3 ms"
#: Largest plausible magnitudes: value, unit, meaning, source (repository and file on GitHub).
BOUNDS: Final[Mapping[str, tuple[float, str, str, str]]] = {
    "joint angle": (LARGEST_ANGLE_RAD, "rad", "two turns: no joint is moved further", _GENEROUS),
    "angle of a frame": (2 * math.pi, "rad", "a whole turn", _GENEROUS),
    "following error": (1.0, "rad", "a joint that far behind does not follow", _GENEROUS),
    "speed of joints 1 to 3": (12.0, "rad/s", "joints 1 to 3 of no six-axis arm are faster", _GP4),
    "speed of other joints": (30.0, "rad/s", "no wrist joint of a six-axis arm is faster", _TX2),
    "acceleration for each rad/s of speed": (1 / 0.012, "rad/s2", "full speed in 12 ms", _RAMP),
    "jerk for each rad/s2 of acceleration": (1 / 0.004, "rad/s3", "full acceleration in 4 ms", _PANDA),
    "length": (20.0, "m", "longer than any arm", _GENEROUS),
    "load": (LARGEST_LOAD_KG, "kg", "more than any six-axis arm carries", _GENEROUS),
    "torque": (LARGEST_TORQUE_NM, "Nm", "more than any joint has", _GENEROUS),
}
#: Unit that is typed by mistake for another one, and its size in that one.
_TYPED: Final = {
    "rad": ("degrees", math.pi / 180),
    "m": ("millimetres", 1e-3),
    "kg": ("grams", 1e-3),
    "Nm": ("mNm", 1e-3),
}

Found = Iterator[tuple[KeyPath, str]]


def beyond(bound: str, key: str, *values: float, of: float = 1.0) -> Found:
    """Refuse values that are only plausible in another unit.

    Parameters
    ----------
    bound : str
        Name of a row of `BOUNDS`.
    key : str
        Key of the cell file that holds the values, with the names of its tables: `rated_load_kg.value`.
    *values : float
        In the unit of the row.
    of : float
        What the bound is multiplied by: the speed limit for an acceleration, the acceleration for a jerk.
    """
    value, unit, meaning, _ = BOUNDS[bound]
    worst = max(values, key=abs, default=0.0)
    if abs(worst) > value * of:
        base, *per = unit.split("/")
        typed, size = _TYPED[base]
        converted = ", ".join(f"{each * size:.4g}" for each in values)
        yield (
            tuple(key.split(".")),
            f"{key}: {worst:g} {unit} is beyond {value * of:.4g} {unit} ({meaning}); in {'/'.join([typed, *per])}? "
            f"write {key} = {f'[{converted}]' if len(values) > 1 else converted}",
        )


def speeds(values_rad_s: Sequence[float]) -> Found:
    """Refuse speed limits (N,) of the joints of an arm, from the base on, that are only plausible in degrees/s."""
    for joint, value_rad_s in enumerate(values_rad_s):
        bound = "speed of joints 1 to 3" if joint < LARGE_JOINTS else "speed of other joints"
        for path, what in beyond(bound, "speed_limit_rad_s", value_rad_s):
            yield ("axis", joint, *path), what


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
