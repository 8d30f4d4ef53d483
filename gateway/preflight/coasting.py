"""How a drive stops by itself: option codes and ramps (CiA 402-2, 8.4). What lets the arm coast refuses motion.

The values are read and judged, never provoked; what they come to is proven by `check --prove-stop`.
"""

from __future__ import annotations

from typing import Final

from drives.objects import OBJECTS
from gateway.preflight.rules import Axis, Lines, Readings, counts_per_revolution, value_of
from gateway.result.result import Finding

#: Time from the cell's speed limit to rest [s] above which a quick stop is refused, and told.
TOO_LONG_S: Final = 1.0
LONG_S: Final = 0.5
#: Quick stop options by what brings the axis to rest (CiA 402-2, table 22).
BY_SLOW_RAMP: Final = (1, 5)
BY_QUICK_RAMP: Final = (2, 6)
BY_LIMIT: Final = (3, 4, 7, 8)
#: Options that may be missing or hold a value of the manufacturer's without a word against the drive.
_OPTIONAL: Final = (
    "quick_stop_option",
    "shutdown_option",
    "disable_operation_option",
    "halt_option",
    "fault_reaction_option",
    "quick_stop_deceleration",
    "following_error_window",
    "max_current",
    "position_range_min",
    "feed_constant_feed",
    "position_offset",
    "positive_torque_limit",
    "digital_inputs",
)


def judge_coasting(axis: Axis, readings: Readings) -> list[Finding]:
    """Judge what one drive does when it is stopped, disabled or in fault.

    Parameters
    ----------
    axis : Axis
    readings : mapping
        (index, subindex) -> value, None where the drive has no such object.

    Returns
    -------
    list of Finding
    """
    lines = Lines(axis)
    for rule in (_quick_stop, _fault_reaction, _power_off, _halt, _ramp, _missing):
        rule(lines, readings)
    return lines.items


def _quick_stop(lines: Lines, readings: Readings) -> None:
    option, address = value_of(readings, "quick_stop_option"), OBJECTS["quick_stop_option"].address
    if option == 0:
        what = "0: a quick stop cuts the power, the axis coasts until its brake holds"
        lines.add("fail", address, what, "set 2 (quick stop ramp) in the drive")
    elif option in (*BY_SLOW_RAMP, *BY_QUICK_RAMP):
        lines.add("ok", address, f"{option}: stops by a ramp")
    elif option in BY_LIMIT:
        lines.add("ok", address, f"{option}: stops with all the torque or voltage the drive may give, by no ramp")
    elif option is not None:
        _of_the_maker(lines, "quick_stop_option", option)


def _fault_reaction(lines: Lines, readings: Readings) -> None:
    option, address = value_of(readings, "fault_reaction_option"), OBJECTS["fault_reaction_option"].address
    if option == 0:
        what = "0: a fault cuts the power, the axis coasts until its brake holds"
        lines.add("fail", address, what, "set 2 (quick stop ramp) in the drive")
    elif option in (1, 2, 3, 4):
        lines.add("ok", address, f"{option}: a fault brings the axis to rest before the power is cut")
    elif option is not None:
        _of_the_maker(lines, "fault_reaction_option", option)


def _power_off(lines: Lines, readings: Readings) -> None:
    for name in ("shutdown_option", "disable_operation_option"):
        option, address = value_of(readings, name), OBJECTS[name].address
        if option == 0:
            what = "0: cuts the power at once; a drive is told to only when standstill was measured"
            lines.add("info", address, what)
        elif option == 1:
            lines.add("ok", address, "1: brings the axis to rest by a ramp before the power is cut")
        elif option is not None:
            _of_the_maker(lines, name, option)


def _halt(lines: Lines, readings: Readings) -> None:
    option = value_of(readings, "halt_option")
    if option is not None:
        lines.add("info", OBJECTS["halt_option"].address, f"{option}; the gateway never uses the halt bit")


def _of_the_maker(lines: Lines, name: str, option: int) -> None:
    what = f"{option} is not one of CiA 402; what it does is shown by `servo-gateway check --prove-stop`"
    advice = "look it up in the drive's manual: the arm must not coast"
    lines.add("info" if option < 0 else "warn", OBJECTS[name].address, what, advice)


def quick_stop_ramp(readings: Readings) -> tuple[str, int | None]:
    """Name of the object that holds the ramp of a quick stop, and its value; None = there is none, or not told."""
    option = value_of(readings, "quick_stop_option")
    name = "profile_deceleration" if option in BY_SLOW_RAMP else "quick_stop_deceleration"
    return name, None if option in BY_LIMIT else value_of(readings, name)


def _ramp(lines: Lines, readings: Readings) -> None:
    """The ramp that a quick stop uses, and what it comes to at the cell's speed limit."""
    name, raw = quick_stop_ramp(readings)
    if raw is None:
        return
    address, velocity = OBJECTS[name].address, lines.axis.profile.velocity
    if raw == 0:
        lines.add("fail", address, "0: the quick stop has no ramp", "set the deceleration in the drive")
        return
    counts = counts_per_revolution(lines.axis.profile, readings)
    unit_rad_s2 = None if velocity is None else velocity.ramp_rad_s2(counts)
    if unit_rad_s2 is None:
        what = f"{raw}: how long a quick stop takes is not known, the profile has no [velocity]"
        lines.add("info", address, what)
        return
    config = lines.axis.config
    speed_rad_s = config.speed_limit_rad_s * abs(config.gear_ratio.value)
    ramp_s = speed_rad_s / (raw * unit_rad_s2)
    what = f"{ramp_s:.2g} s from {config.speed_limit_rad_s:g} rad/s to rest, if its unit is the velocity's per second"
    if ramp_s > LONG_S:
        advice = f"raise it in the drive: more than {TOO_LONG_S:g} s is refused; or lower speed_limit_rad_s"
        lines.add("fail" if ramp_s > TOO_LONG_S else "warn", address, what, advice)
    else:
        lines.add("ok", address, what)


def _missing(lines: Lines, readings: Readings) -> None:
    absent = [f"{OBJECTS[name]}" for name in _OPTIONAL if value_of(readings, name) is None]
    if absent:
        lines.add("info", None, f"the drive does not tell {', '.join(absent)}")
