"""Compare drive readings with profile and cell: pure rules, one function each.

First identity, state and settings of a drive with its torque limits; then joint positions and ranges against the limits
of the cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from drives.cia402 import FAULTED, FOLLOWING, INTERNAL_LIMIT, Mode, State, decode_state, describe, mode_supported
from drives.emcy import code_class
from drives.objects import OBJECTS, object_name
from drives.profile import NO_RESOLUTION, Constant, DriveProfile, Reader, resolution
from drives.values import Identity
from gateway.cell.config import ArmConfig, AxisConfig, LoadedCell
from gateway.cell.conversion import AxisConversion
from gateway.errors import PlanRefused
from gateway.result.finding import Finding, Severity

#: Ratio of torque limits (drive to cell) above which a unit error is assumed.
IMPLAUSIBLE = 50.0
#: And below which an axis would drop when it is enabled: gravity takes a tenth of the peak torque and more.
TOO_WEAK = 0.1
#: Limits of the torque that a drive produces: of both directions, of one, and of the current.
TORQUE_LIMITS: Final = ("max_torque", "positive_torque_limit", "negative_torque_limit", "max_current")
CONFIRM_TORQUE: Final = "write the limit from the data sheet to the cell, and its source to torque_limit_source"
SATURATES: Final = "readings saturate there; lower torque_limit_nm or raise the drive's limit"
#: Following error windows beyond this multiple of the cell's limit are too wide to protect.
WIDE: Final = 4.0
_I32_MAX: Final = 0x7FFFFFFF
_NARROW: Final = "narrow position_limit_rad to that, or lower the resolution of positions in the drive (0x608F)"
#: Ranges of the drive, and what to do where they are narrower than the joint limits.
_RANGES: Final = {
    "position_limit": "the drive stops before the cell's limit: narrow position_limit_rad",
    "position_range": "the position wraps around at the end of this range: widen it, or narrow position_limit_rad",
}
#: Command that moves a joint into its range; CELL is replaced by the file name where it is known.
MOVE_HOME: Final = "servo-gateway move CELL --to home"

Address = tuple[int, int]
Readings = Mapping[Address, int | None]


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of the cell with its profile; joints count from 1."""

    joint: int
    config: AxisConfig
    profile: DriveProfile

    def item(self, severity: Severity, address: Address | None, what: str, advice: str = "") -> Finding:
        """Return an item about an object of this axis, or about the axis."""
        place = f"J{self.joint} node {self.config.node_id}"
        return Finding(severity, place if address is None else f"{place}:{object_name(*address)}", what, advice)


def judge_state(axis: Axis, readings: Readings) -> list[Finding]:
    """Check state and constants, which are refused again when the drive is enabled.

    Parameters
    ----------
    axis : Axis
    readings : mapping
        (index, subindex) -> value; None if the drive has no such object.
    """
    rules = (_state, _rated, _resolution, _conditions)
    return [item for rule in rules for item in rule(axis, readings)]


def judge_settings(axis: Axis, readings: Readings) -> list[Finding]:
    """Check the settings of the drive that no later step refuses; parameters as `judge_state`."""
    rules = (_obstacles, _mode, _torque_object, _torque_limits, _encoder, _scaling, _watchdog)
    return [item for rule in rules for item in rule(axis, readings)]


def value_of(readings: Readings, name: str) -> int | None:
    """Return the value of a named object; None if the drive does not have it."""
    value = readings.get(OBJECTS[name].address)
    return value if isinstance(value, int) else None


def judge_identity(axis: Axis, identity: Identity) -> list[Finding]:
    """Check the identity of the drive.

    Parameters
    ----------
    axis : Axis
    identity : Identity
    """
    items: list[Finding] = []
    if not identity.is_drive:
        what = f"device type {_hex(identity.device_type)} is not a CiA 402 drive"
        items.append(axis.item("fail", OBJECTS["device_type"].address, what, "check the node id"))
    advice = "check wiring and node ids, or choose the profile of this drive and firmware"
    for subindex, problem in identity.mismatches(axis.profile).items():
        what = f"{problem} (profile '{axis.profile.name}')"
        items.append(axis.item("fail", (0x1018, subindex), what, advice))
    parts = {
        "vendor": _hex(identity.vendor_id),
        "product": _hex(identity.product_code),
        "revision": _hex(identity.revision),
        "serial": _hex(identity.serial_number),
        "firmware": identity.software_version or "not reported",
    }
    return [*items, axis.item("info", None, ", ".join(f"{name} {value}" for name, value in parts.items()))]


def _hex(value: int | None) -> str:
    return "not reported" if value is None else f"0x{value:X}"


def _state(axis: Axis, readings: Readings) -> Iterator[Finding]:
    word = value_of(readings, "statusword")
    address = OBJECTS["statusword"].address
    if word is None:
        yield axis.item("fail", address, "the drive has no statusword", "this is not a CiA 402 drive")
        return
    state = decode_state(word)
    if state in FAULTED:
        code = value_of(readings, "error_code")
        what = f"{describe(word)}, error code {'not readable' if code is None else f'0x{code:04X}, {code_class(code)}'}"
        yield axis.item("fail", address, what, "remove the cause, then reset the fault at the drive")
    elif state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
        what = f"{describe(word)}: the drive is energised, although this command has not enabled it"
        advice = "stop the other master; after an interrupted run `servo-gateway restore CELL` disables the drive"
        yield axis.item("fail", address, what, advice)
    elif state is State.SWITCHED_ON:
        yield axis.item(
            "warn", address, describe(word), "`servo-gateway restore CELL` disables it, unless a master uses it"
        )
    elif word & INTERNAL_LIMIT & ~axis.profile.state_machine.ignored_status:
        advice = "see its position limits (0x607D), limit switches (0x60FD), warnings; where a warning that may stay "
        advice += "sets the bit, set ignored_status = 0x0800 in [state_machine] of its profile"
        yield axis.item("warn", address, f"{describe(word)} (bit 11)", advice)
    else:
        yield axis.item("ok", address, describe(word))


def used_objects(profile: DriveProfile) -> dict[Address, str]:
    """Return the objects by which every drive is moved, with their types; some drives do not let them be read."""
    named = [OBJECTS[name] for name in ("controlword", "mode", "mode_display")]
    stated = (profile.target_position, profile.position.object)
    return {each.address: each.type for each in named} | {(each.index, each.subindex): each.type for each in stated}


def _conditions(axis: Axis, readings: Readings) -> Iterator[Finding]:
    if not axis.profile.safety:
        what = "STO, emergency stop and enable input are not read: the profile names no [[safety]] object"
        yield axis.item("info", None, what, "write object, bit and source from the manual to the profile")
    if axis.profile.reference is None:
        what = "whether the encoder kept its turns without supply is not read: the profile names no [reference]"
        advice = "compare the joint angle with the arm after each power-up; home a single-turn or incremental encoder"
        yield axis.item("info", OBJECTS["position"].address, what, advice)
    for condition in axis.profile.conditions:
        address = (condition.object.index, condition.object.subindex)
        value = readings.get(address)
        if value is None:
            what = f"{condition.what}: the drive does not have this status object"
            yield axis.item("fail", address, what, "correct [safety] or [reference] of the profile")
        elif not condition.holds(value):
            is_reference = condition is axis.profile.reference
            advice = "reference the encoder at the drive" if is_reference else "release it before the arm moves"
            yield axis.item("fail", address, f"{condition.what}: {condition.describe(value)}", advice)
        else:
            yield axis.item("ok", address, f"0x{value:X}: ready for motion")


def _mode(axis: Axis, readings: Readings) -> Iterator[Finding]:
    for address in used_objects(axis.profile):
        if readings.get(address, 0) is None:
            what = f"the drive does not have this object, which profile {axis.profile.name} uses for every motion"
            yield axis.item("fail", address, what, "make its profile from the EDS of this firmware")
    modes = value_of(readings, "supported_modes")
    address = OBJECTS["supported_modes"].address
    if modes is None:
        yield axis.item("info", address, "the drive does not report its modes; the mode is read back when it is set")
        return
    mode = Mode(axis.profile.state_machine.cyclic_mode)
    others = [each.value for each in FOLLOWING if each is not mode and mode_supported(modes, each)]
    if mode_supported(modes, mode):
        yield axis.item("ok", address, f"{mode} is supported")
        return
    advice = f"enable mode {mode.value} in the drive"
    if others:
        advice += f", or write cyclic_mode = {others[0]} to [state_machine] of its profile"
    yield axis.item("fail", address, f"0x{modes:X}: no {mode} mode", advice)


def _torque_object(axis: Axis, readings: Readings) -> Iterator[Finding]:
    torque = axis.profile.torque
    address = (torque.object.index, torque.object.subindex)
    if torque.nature != "measured":
        what = f"the torque object of the profile is {torque.nature}, not measured: a load cannot be estimated from it"
        yield axis.item("fail", address, what, "use the measured torque or current of the drive in the profile")
    elif readings.get(address) is None:
        yield axis.item("fail", address, "the drive does not have the torque object", "use another profile")
    elif torque.assumed:
        yield axis.item("warn", address, f"assumed, {torque.kind.replace('_', ' ')} ({torque.source})")
    else:
        yield axis.item("ok", address, f"measured, {torque.kind.replace('_', ' ')} ({torque.source})")


def _obstacles(axis: Axis, readings: Readings) -> Iterator[Finding]:
    del readings
    config = axis.config
    if config.torque_limit_is_assumed:
        what = f"torque_limit_nm = {config.torque_limit_nm:g} is not confirmed ({config.torque_limit_source})"
        yield axis.item("fail", None, what, CONFIRM_TORQUE)
    profile = axis.profile
    for obstacle in profile.obstacles:
        what, _, advice = obstacle.partition(": ")
        yield axis.item("fail", None, f"profile {profile.name} refuses motion: {what}", advice or "use another drive")


def _rated(axis: Axis, readings: Readings) -> Iterator[Finding]:
    rated = axis.profile.torque.rated
    if rated is None:
        return
    if rated.object is None:
        yield axis.item("info", None, f"rated value {rated.value:g} from {rated.source}")
        return
    address = (rated.object.index, rated.object.subindex)
    value = readings.get(address)
    if not isinstance(value, int) or value <= 0:
        what = "missing" if value is None else f"{value}: all torques would be zero"
        yield axis.item("fail", address, what, "set the rated value of the motor in the drive")
    else:
        unit = "A" if axis.profile.torque.is_current else "Nm"
        yield axis.item("ok", address, f"{value * (rated.unit or math.nan):g} {unit} is 1000 per mille")


def reader(readings: Readings) -> Reader:
    """Return the function that looks objects of a profile up among readings."""
    return lambda reference: readings.get((reference.index, reference.subindex))


def joint_torque_limit_nm(axis: Axis, readings: Readings, name: str = "max_torque") -> float | None:
    """Return the joint torque that a limit of the drive allows [Nm]; None if unknown.

    The limit is in per mille of the rated torque; that of the current, and where the drive states no rated torque, in
    per mille of the rated current.
    """
    limit, profile, config, read = value_of(readings, name), axis.profile, axis.config, reader(readings)
    rated_nm = None if name == "max_current" else profile.rated_torque_nm(read)
    rated_a = profile.rated_current_a(read) if rated_nm is None else None
    if rated_a is not None:
        rated_nm = rated_a * config.torque_constant_nm_per_a.value
    return None if limit is None or rated_nm is None else abs(config.gear_ratio.value) * rated_nm * limit / 1000.0


def _torque_limits(axis: Axis, readings: Readings) -> Iterator[Finding]:
    stated_nm = axis.config.torque_limit_nm
    for name in TORQUE_LIMITS:
        limit, address, is_total = value_of(readings, name), OBJECTS[name].address, name == "max_torque"
        joint_nm = joint_torque_limit_nm(axis, readings, name)
        if limit == 0:
            advice = "set the torque limit in the drive" if is_total else "set the limit in the drive"
            yield axis.item("fail", address, "0: the drive produces no torque", advice)
        elif joint_nm is None:
            if is_total and limit is not None and limit < 1000:
                yield axis.item("warn", address, f"{limit} per mille of the rated torque", SATURATES)
        elif is_total and joint_nm < TOO_WEAK * stated_nm:
            what = f"{limit} per mille is {joint_nm:.3g} Nm at the joint, too little for an axis of {stated_nm:g} Nm"
            advice = "raise it in the drive, or correct the unit of the rated torque (uNm, mNm) or gear_ratio"
            yield axis.item("fail", address, what, advice)
        elif is_total and joint_nm > IMPLAUSIBLE * stated_nm:
            what = f"{limit} per mille is {joint_nm:.3g} Nm at the joint, the cell allows {stated_nm:g} Nm"
            advice = "rated torque in another unit (uNm, mNm) or a wrong gear_ratio: correct it"
            yield axis.item("fail", address, what, advice)
        elif joint_nm < stated_nm:
            what = f"{limit} per mille is {joint_nm:.0f} Nm at the joint, the cell allows {stated_nm:g} Nm"
            yield axis.item("warn", address, what, SATURATES)
        elif is_total:
            yield axis.item("ok", address, f"{limit} per mille is {joint_nm:.0f} Nm at the joint")


def _encoder(axis: Axis, readings: Readings) -> Iterator[Finding]:
    """Compare 0x608F of the drive with the counts per motor revolution of the profile."""
    increments, turns = value_of(readings, "encoder_increments"), value_of(readings, "encoder_revolutions")
    profile, counts = axis.profile, resolution(increments, turns)
    assumed = profile.position.counts_per_revolution
    if counts is None:
        return
    if isinstance(assumed, Constant):
        if counts != assumed.value:
            what = f"the drive counts {increments} in {turns} motor revolutions, profile {profile.name} assumes "
            what += f"{assumed.value:g} in one"
            advice = "correct counts_per_revolution of the profile, or 0x608F in the drive"
            yield axis.item("warn" if turns == 1 else "fail", OBJECTS["encoder_increments"].address, what, advice)
        return
    reads_increments = (assumed.object.index, assumed.object.subindex) == OBJECTS["encoder_increments"].address
    if assumed.per is None and reads_increments and turns != 1:
        what = f"{turns}: 608F:01 counts {turns} motor revolutions, profile {profile.name} takes them for one: every "
        what += f"joint moves {turns} times as far as reported"
        advice = 'add per = { index = 0x608F, subindex = 2, type = "u32" } to counts_per_revolution of the profile'
        yield axis.item("fail", OBJECTS["encoder_revolutions"].address, what, advice)


def _scaling(axis: Axis, readings: Readings) -> Iterator[Finding]:
    polarity = value_of(readings, "polarity")
    if polarity:
        what = f"0x{polarity:02X}: the drive inverts position or velocity, possibly not torque"
        advice = "set it to 0 and use position_sign and torque_sign of the cell file"
        yield axis.item("fail", OBJECTS["polarity"].address, what, advice)
    motor, shaft = value_of(readings, "gear_motor_revolutions"), value_of(readings, "gear_shaft_revolutions")
    if motor is not None and shaft is not None and motor != shaft:
        what = f"{motor}:{shaft}: the drive applies a gear ratio to the position"
        advice = "set it to 1:1; state the ratio in the cell file"
        yield axis.item("fail", OBJECTS["gear_motor_revolutions"].address, what, advice)
    # a feed constant of 1:1 or of the encoder counts; other values scale the position
    feed, turns = value_of(readings, "feed_constant_feed"), value_of(readings, "feed_constant_revolutions")
    counts = counts_per_revolution(axis.profile, readings)
    if feed is not None and turns is not None and feed != turns and (counts is None or feed != counts * turns):
        what = f"{feed}:{turns}: the drive scales the position by a feed constant"
        advice = "set it to 1:1, or to the counts of one motor revolution"
        yield axis.item("fail", OBJECTS["feed_constant_feed"].address, what, advice)
    offset = value_of(readings, "position_offset")
    if offset:
        what = f"{offset} counts are added to every target position"
        yield axis.item(
            "fail", OBJECTS["position_offset"].address, what, "set it to 0; use zero_offset_rad of the cell file"
        )
    torque_offset = value_of(readings, "torque_offset")
    if torque_offset:
        what = f"{torque_offset} per mille torque offset is active"
        advice = "set it to 0: a remaining torque offset biases readings"
        yield axis.item("warn", OBJECTS["torque_offset"].address, what, advice)


def _resolution(axis: Axis, readings: Readings) -> Iterator[Finding]:
    if counts_per_revolution(axis.profile, readings) is None:
        advice = "set it in the drive, or give it in the profile"
        yield axis.item("fail", OBJECTS["encoder_increments"].address, NO_RESOLUTION, advice)


def _watchdog(axis: Axis, readings: Readings) -> Iterator[Finding]:
    profile = axis.profile
    missing = [name for name in profile.loss_objects if value_of(readings, name) is None]
    for name in missing:
        what = "missing: the drive does not detect loss of the master"
        advice = 'write watchdog = "node guarding" to [heartbeat] of the profile if it has 0x100C'
        if name == "abort_connection_option":
            what = "missing: the reaction of the drive to loss of the master cannot be set"
            advice = "remove abort_connection from the profile: the proof of its stop then decides"
        yield axis.item("fail", OBJECTS[name].address, what, advice)
    if profile.heartbeat.abort_connection is None:
        what = "the drive has no 0x6007: only the proof of its stop shows what it does without its master"
        yield axis.item("info", None, what)
    if not missing:
        entry = OBJECTS[profile.loss_objects[0]]
        yield axis.item("ok", entry.address, f"the drive can monitor the master's {profile.heartbeat.watchdog}")


def counts_per_revolution(profile: DriveProfile, readings: Readings) -> float | None:
    """Return the position counts per motor revolution; None if unknown."""
    return profile.position.counts(reader(readings))


# -- positions and ranges ----------------------------------------------------------------------------------------------


def judge_place(axis: Axis, arm: ArmConfig, readings: Readings) -> list[Finding]:
    """Check the joint position, which is checked again before each motion.

    Parameters
    ----------
    axis : Axis
    arm : ArmConfig
        For the conversion from motor to joint; coupled joints need all motors and are checked during the run.
    readings : mapping
        (index, subindex) -> value.
    """
    turn, position = counts_per_revolution(axis.profile, readings), value_of(readings, "position")
    if turn is None or position is None or arm.coupling is not None:
        return []
    low, high = axis.config.position_limit_rad
    q_rad = _joint_rad(arm, axis.joint, position / turn)
    inside = low <= q_rad <= high
    what = f"is at {q_rad:.3f} rad, limits {low:g} to {high:g} rad"
    remedy = f"bring the joint inside its limits ({MOVE_HOME}), or correct zero_offset_rad and position_sign"
    advice = "" if inside else remedy
    return [axis.item("ok" if inside else "fail", OBJECTS["position"].address, what, advice)]


def judge_ranges(axis: Axis, arm: ArmConfig, readings: Readings) -> Iterator[Finding]:
    """Check software limits, position range and following error window; parameters as `judge_place`."""
    turn = counts_per_revolution(axis.profile, readings)
    if turn is None:
        return
    yield from _following(axis, readings, turn)
    beyond = beyond_counts(arm, axis.joint, turn)
    if beyond is not None:
        yield axis.item("fail", OBJECTS["target_position"].address, beyond, _NARROW)
    low, high = axis.config.position_limit_rad
    for name, advice in _RANGES.items() if arm.coupling is None else ():
        drive, address = drive_range_rad(axis, arm, readings, name), OBJECTS[f"{name}_min"].address
        if drive is not None:
            what = f"drive {drive[0]:.3f} to {drive[1]:.3f} rad, cell {low:g} to {high:g} rad"
            covers = drive[0] <= low and drive[1] >= high
            yield axis.item("ok" if covers else "fail", address, what, "" if covers else advice)
        elif name == "position_limit":
            what = "no software limits in the drive; the gateway applies those of the cell file"
            yield axis.item("info", address, what)


def drive_range_rad(
    axis: Axis, arm: ArmConfig, readings: Readings, name: str = "position_limit"
) -> tuple[float, float] | None:
    """Return a joint range of the drive [rad]; None if it has none or the joint is coupled."""
    turn = counts_per_revolution(axis.profile, readings)
    first, second = (value_of(readings, f"{name}_{end}") for end in ("min", "max"))
    if turn is None or arm.coupling is not None or first is None or second is None or first == second:
        return None
    ends = [_joint_rad(arm, axis.joint, end / turn) for end in (first, second)]
    return min(ends), max(ends)


def beyond_counts(arm: ArmConfig, joint: int, turn: float) -> str | None:
    """Return why positions within the joint limits do not fit into 32 bits; None if they fit.

    Parameters
    ----------
    arm : ArmConfig
    joint : int
        From 1; for a coupled arm the number of the motor.
    turn : float
        Position counts of one motor revolution.
    """
    axes = AxisConversion.from_arm(arm)
    low, high = np.array([axis.position_limit_rad for axis in arm.axis]).T
    middle = axes.motor_position(0.5 * (low + high))
    half = np.abs(axes.ratio) * (np.abs(axes.coupling) @ (0.5 * (high - low)))
    ends = (middle + np.outer((-1.0, 1.0), half))[:, joint - 1] * turn / (2 * math.pi)
    most = max(ends, key=abs)
    if abs(most) <= _I32_MAX:
        return None
    beyond = f"{most:.0f} counts, a position has 32 bits: -{_I32_MAX} to {_I32_MAX} counts"
    if arm.coupling is not None:
        return f"the limits of the coupled joints let this motor go to {beyond}"
    at_rad, *fitting = (_joint_rad(arm, joint, counts / turn) for counts in (most, -_I32_MAX, _I32_MAX))
    return f"J{joint} at {at_rad:.3f} rad is at {beyond}, {min(fitting):.3f} to {max(fitting):.3f} rad"


def refuse_beyond_counts(loaded: LoadedCell, arm: ArmConfig) -> None:
    """Check that positions within the joint limits fit into 32 bits, if the profile gives the resolution.

    Raises
    ------
    PlanRefused
    ProfileError
        A profile cannot be read.
    """
    for joint, axis in enumerate(arm.axis, start=1):
        counts = loaded.profile(axis.profile).position.counts_per_revolution
        said = beyond_counts(arm, joint, counts.value) if isinstance(counts, Constant) else None
        if said is not None:
            raise PlanRefused(f"arm '{arm.name}', J{joint} node {axis.node_id}: {said}; {_NARROW}")


def _following(axis: Axis, readings: Readings, turn: float) -> Iterator[Finding]:
    window = value_of(readings, "following_error_window")
    if window is None:
        return
    config, address = axis.config, OBJECTS["following_error_window"].address
    error_rad = 2.0 * math.pi * window / turn / abs(config.gear_ratio.value)
    limit = f"following_error_limit_rad of the cell is {config.following_error_limit_rad:g}"
    if window == 0:
        what = "0: the drive does not monitor its following error, or faults at once"
        yield axis.item("warn", address, what, f"set the window in the drive; {limit}")
    elif error_rad > WIDE * config.following_error_limit_rad:
        what = f"{error_rad:.3g} rad at the joint: too wide for the drive to detect a collision without the master"
        yield axis.item("warn", address, what, f"narrow the window in the drive; {limit}")
    else:
        yield axis.item("ok", address, f"{error_rad:.3g} rad at the joint; {limit}")


def _joint_rad(arm: ArmConfig, joint: int, revolutions: float) -> float:
    motor = np.zeros(len(arm.axis))
    motor[joint - 1] = 2 * math.pi * revolutions
    return float(AxisConversion.from_arm(arm).joint_position(motor)[joint - 1])
