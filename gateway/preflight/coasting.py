"""Stop behaviour of a drive: option codes and ramps (CiA 402-2, 8.4). Settings that let the arm coast refuse motion.

The settings are read, not tested; the test is `check --prove-stop`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from drives.bringup import ENDING_OPTIONS, RAMP_OPTION
from drives.objects import OBJECTS
from gateway.preflight.rules import Axis, Readings, counts_per_revolution, value_of
from gateway.result.result import Finding

#: Duration of a quick stop from the cell's speed limit [s] above which motion is refused.
TOO_LONG_S: Final = 1.0
LONG_S: Final = 0.5
#: Quick stop options used in a run that stop by the ramp 0x6084, and at the current limit (CiA 402-2, table 22).
BY_SLOW_RAMP: Final = 1
BY_LIMIT: Final = 3
#: Options that may be missing or hold a manufacturer-specific value.
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
    """Assess the behaviour of one drive on stop, disable and fault.

    Parameters
    ----------
    axis : Axis
    readings : mapping
        (index, subindex) -> value; None if the drive has no such object.

    Returns
    -------
    list of Finding
    """
    items = [item for rule in (_quick_stop, _other_options, _ramp) for item in rule(axis, readings)]
    absent = [f"{OBJECTS[name]}" for name in _OPTIONAL if readings.get(OBJECTS[name].address, 0) is None]
    return [*items, axis.item("info", None, f"the drive does not have {', '.join(absent)}")] if absent else items


def _quick_stop(axis: Axis, readings: Readings) -> Iterator[Finding]:
    option, entry = value_of(readings, "quick_stop_option"), OBJECTS["quick_stop_option"]
    if option is None:
        return
    if option == BY_LIMIT:
        yield axis.item("ok", entry.address, f"{option}: stops at the current limit, without a ramp")
    elif option in ENDING_OPTIONS:
        yield axis.item("ok", entry.address, f"{option}: stops on a ramp")
    elif entry.index in axis.profile.write.allow:
        what = f"{option}: {_after_quick_stop(option)}; {RAMP_OPTION} (quick stop ramp) is written for each run"
        yield axis.item("info", entry.address, what)
    else:
        advice = "set 1, 2 or 3 in the drive, or add 0x605A to write.allow of the profile"
        yield axis.item("fail", entry.address, f"{option}: {_after_quick_stop(option)}", advice)


def _after_quick_stop(option: int) -> str:
    """Return what a drive does in or after a quick stop with an option that is not used in a run."""
    if option == 0:
        return "a quick stop disables the drive; the axis coasts until the brake engages"
    if option in (5, 6, 7, 8):
        return "after a quick stop the drive stays energised, and the next controlword would enable it again"
    return "the effect of this quick stop option is not defined by CiA 402 or not known"


def _other_options(axis: Axis, readings: Readings) -> Iterator[Finding]:
    """Check what the drive does in a fault, when it is disabled, and on the halt bit."""
    for name in ("fault_reaction_option", "shutdown_option", "disable_operation_option", "halt_option"):
        option, address, in_fault = value_of(readings, name), OBJECTS[name].address, name == "fault_reaction_option"
        if option is None:
            continue
        if name == "halt_option":
            yield axis.item("info", address, f"{option}; the gateway never uses the halt bit")
        elif in_fault and option == 0:
            what = "0: a fault disables the drive; the axis coasts until the brake engages"
            yield axis.item("fail", address, what, "set 2 (quick stop ramp) in the drive")
        elif in_fault and option in (1, 2, 3, 4):
            yield axis.item("ok", address, f"{option}: a fault brings the axis to rest before the drive is disabled")
        elif option == 0:
            what = "0: disables at once; the gateway requests it only after standstill is measured"
            yield axis.item("info", address, what)
        elif option == 1:
            yield axis.item("ok", address, "1: brings the axis to rest on a ramp before the drive is disabled")
        else:
            what = f"{option} is manufacturer-specific; test its effect with `servo-gateway check --prove-stop`"
            advice = "see the manual of the drive: the arm must not coast"
            yield axis.item("info" if option < 0 else "warn", address, what, advice)


def quick_stop_ramp(readings: Readings) -> tuple[str, int | None]:
    """Return name and value of the object with the quick stop ramp of a run; None if missing or not used."""
    option = value_of(readings, "quick_stop_option")
    name = "profile_deceleration" if option == BY_SLOW_RAMP else "quick_stop_deceleration"
    return name, None if option == BY_LIMIT else value_of(readings, name)


def _ramp(axis: Axis, readings: Readings) -> Iterator[Finding]:
    """Check the quick stop ramp and its duration from the cell's speed limit."""
    name, raw = quick_stop_ramp(readings)
    address, velocity = OBJECTS[name].address, axis.profile.velocity
    option = value_of(readings, "quick_stop_option")
    if raw is None:
        what = "missing or not readable: duration of a quick stop unknown"
        if option is None:
            yield axis.item("warn", address, what, "0x605A is missing too: only the proof of its stop shows it")
        elif option != BY_LIMIT:
            yield axis.item("fail", address, what, "set 0x605A to 3 (current limit) in the drive, if it takes that")
        return
    if raw == 0:
        yield axis.item("fail", address, "0: the quick stop has no ramp", "set the deceleration in the drive")
        return
    counts = counts_per_revolution(axis.profile, readings)
    unit_rad_s2 = None if velocity is None else velocity.ramp_rad_s2(counts)
    if unit_rad_s2 is None:
        what = f"{raw}: duration of a quick stop unknown, because the profile has no [velocity]"
        advice = "state [velocity] in the profile, of a packaged one in a copy"
        if option is not None:
            advice += ", or set 0x605A to 3 (current limit) in the drive"
        yield axis.item("fail", address, what, advice)
        return
    config = axis.config
    speed_rad_s = config.speed_limit_rad_s * abs(config.gear_ratio.value)
    ramp_s = speed_rad_s / (raw * unit_rad_s2)
    what = f"{ramp_s:.2g} s from {config.speed_limit_rad_s:g} rad/s to rest"
    if velocity is not None and velocity.ramp_counts_s2 is None:
        what += ", if its unit is the velocity unit per second"
    if ramp_s > LONG_S:
        advice = f"raise it in the drive: more than {TOO_LONG_S:g} s is refused; or lower speed_limit_rad_s; or "
        advice += "state the unit as ramp_counts_s2 in [velocity] of the profile"
        yield axis.item("fail" if ramp_s > TOO_LONG_S else "warn", address, what, advice)
    else:
        yield axis.item("ok", address, what)
