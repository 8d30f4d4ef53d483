"""What a drive said of itself, judged against profile and cell: pure rules, one function each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from drives.cia402 import FAULTED, Mode, State, decode_state, describe, mode_supported
from drives.objects import OBJECTS, object_name
from drives.profile import Constant, DriveProfile
from drives.values import Identity
from gateway.cell.conversion import AxisConversion
from gateway.config import ArmConfig, AxisConfig

Severity = Literal["ok", "info", "warn", "fail"]
#: Drive's and cell's torque limit farther apart than this are no choice but a mistake of units.
IMPLAUSIBLE = 50.0

Address = tuple[int, int]
Readings = Mapping[Address, int | None]


@dataclass(frozen=True, slots=True)
class CheckItem:
    """One line of the check.

    Parameters
    ----------
    severity : str
        `ok`, `info`, `warn` or `fail`.
    where : str
        `J2 node 2:6077:00 (torque)`.
    what : str
        What was found.
    advice : str
        What to do; empty where nothing is.
    """

    severity: Severity
    where: str
    what: str
    advice: str = ""

    def as_json(self) -> dict[str, str]:
        """Plain values, the shape of a finding."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of the cell with its profile; joints count from 1."""

    joint: int
    config: AxisConfig
    profile: DriveProfile


class _Lines:
    """Collects the lines of one axis."""

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.items: list[CheckItem] = []

    def add(self, severity: Severity, address: Address | None, what: str, advice: str = "") -> None:
        place = f"J{self.axis.joint} node {self.axis.config.node_id}"
        if address is not None:
            place += f":{object_name(*address)}"
        self.items.append(CheckItem(severity, place, what, advice))


def judge_axis(axis: Axis, readings: Readings) -> list[CheckItem]:
    """Judge what one drive said.

    Parameters
    ----------
    axis : Axis
    readings : mapping
        (index, subindex) -> value, None where the drive has no such object.

    Returns
    -------
    list of CheckItem
    """
    lines = _Lines(axis)
    for rule in (_state, _mode, _torque_object, _rated, _torque_limit, _scaling, _offsets, _watchdog):
        rule(lines, readings)
    return lines.items


def _value(readings: Readings, name: str) -> int | None:
    value = readings.get(OBJECTS[name].address)
    return value if isinstance(value, int) else None


def judge_identity(axis: Axis, identity: Identity) -> list[CheckItem]:
    """Judge who the drive says it is.

    Parameters
    ----------
    axis : Axis
    identity : Identity
    """
    lines = _Lines(axis)
    address = OBJECTS["vendor_id"].address
    if not identity.is_drive:
        what = f"device type {_hex(identity.device_type)} is not a CiA 402 drive"
        lines.add("fail", OBJECTS["device_type"].address, what, "check the node id")
    for problem in identity.mismatches(axis.profile):
        what = f"{problem} (profile '{axis.profile.name}')"
        lines.add("fail", address, what, "check wiring and node ids, or choose the profile of this drive and firmware")
    parts = {
        "vendor": _hex(identity.vendor_id),
        "product": _hex(identity.product_code),
        "revision": _hex(identity.revision),
        "serial": _hex(identity.serial_number),
        "firmware": identity.software_version or "not told",
    }
    lines.add("info", None, ", ".join(f"{name} {value}" for name, value in parts.items()))
    return lines.items


def _hex(value: int | None) -> str:
    return "not told" if value is None else f"0x{value:X}"


def _state(lines: _Lines, readings: Readings) -> None:
    word = _value(readings, "statusword")
    address = OBJECTS["statusword"].address
    if word is None:
        lines.add("fail", address, "the drive has no statusword", "this is not a CiA 402 drive")
        return
    state = decode_state(word)
    if state in FAULTED:
        lines.add("fail", address, describe(word), "read the fault, remove its cause, reset it at the drive")
    elif state is State.OPERATION_ENABLED:
        lines.add("warn", address, describe(word), "somebody else has enabled this drive; find out who")
    else:
        lines.add("ok", address, describe(word))


def _mode(lines: _Lines, readings: Readings) -> None:
    modes = _value(readings, "supported_modes")
    address = OBJECTS["supported_modes"].address
    if modes is None:
        lines.add("info", address, "the drive does not say which modes it has; the mode is read back when it is set")
    elif not mode_supported(modes, Mode.CYCLIC_SYNC_POSITION):
        lines.add("fail", address, f"0x{modes:X}: no cyclic synchronous position mode", "enable mode 8 in the drive")
    else:
        lines.add("ok", address, "cyclic synchronous position is supported")


def _torque_object(lines: _Lines, readings: Readings) -> None:
    torque = lines.axis.profile.torque
    address = (torque.object.index, torque.object.subindex)
    if torque.nature != "measured":
        what = f"the profile says this torque is {torque.nature}, not measured: a load cannot be estimated from it"
        lines.add("fail", address, what, "name the drive's measured torque or current in the profile")
    elif readings.get(address) is None:
        lines.add("fail", address, "the drive does not have the torque object", "use another profile")
    else:
        lines.add("ok", address, f"measured, {torque.kind.replace('_', ' ')} ({torque.source})")


def _rated(lines: _Lines, readings: Readings) -> None:
    rated = lines.axis.profile.torque.rated
    if rated is None:
        return
    if rated.object is None:
        lines.add("info", None, f"rated value {rated.value:g} from {rated.source}")
        return
    address = (rated.object.index, rated.object.subindex)
    value = readings.get(address)
    if not isinstance(value, int) or value <= 0:
        what = "missing" if value is None else f"{value}: every torque would be zero"
        lines.add("fail", address, what, "set the rated value of the motor in the drive")
    else:
        unit = "A" if lines.axis.profile.torque.is_current else "Nm"
        lines.add("ok", address, f"{value * (rated.unit or math.nan):g} {unit} is 1000 per mille")


def joint_torque_limit_nm(axis: Axis, readings: Readings) -> float | None:
    """Torque that the drive's own limit allows at the joint [Nm]; None where the drive does not tell."""
    limit, torque = _value(readings, "max_torque"), axis.profile.torque
    if limit is None or torque.rated is None or torque.is_current:
        return None
    full = torque.rated.value
    if torque.rated.object is not None:
        word = readings.get((torque.rated.object.index, torque.rated.object.subindex))
        full = word * (torque.rated.unit or math.nan) if isinstance(word, int) else None
    return abs(axis.config.gear_ratio.value) * full * limit / 1000.0 if full else None


def _torque_limit(lines: _Lines, readings: Readings) -> None:
    config, limit = lines.axis.config, _value(readings, "max_torque")
    address = OBJECTS["max_torque"].address
    joint = joint_torque_limit_nm(lines.axis, readings)
    if joint is None:
        return
    if limit == 0:
        lines.add("fail", address, "0: the drive gives no torque", "set the torque limit in the drive")
    elif not 1.0 / IMPLAUSIBLE < joint / config.torque_limit_nm < IMPLAUSIBLE:
        what = f"{limit} per mille is {joint:.3g} Nm at the joint, the cell allows {config.torque_limit_nm:g} Nm"
        lines.add("fail", address, what, "rated torque in another unit (uNm, mNm) or a wrong gear_ratio: correct it")
    elif joint < config.torque_limit_nm:
        what = f"{limit} per mille is {joint:.0f} Nm at the joint, the cell allows {config.torque_limit_nm:g} Nm"
        lines.add("warn", address, what, "readings saturate there; lower torque_limit_nm or raise the drive's limit")
    else:
        lines.add("ok", address, f"{limit} per mille is {joint:.0f} Nm at the joint")


def _scaling(lines: _Lines, readings: Readings) -> None:
    polarity = _value(readings, "polarity")
    if polarity:
        what = f"0x{polarity:02X}: position or velocity is turned round in the drive, torque perhaps not"
        lines.add("warn", OBJECTS["polarity"].address, what, "set it to 0 and use position_sign and torque_sign")
    motor, shaft = _value(readings, "gear_motor_revolutions"), _value(readings, "gear_shaft_revolutions")
    if motor is not None and shaft is not None and motor != shaft:
        what = f"{motor}:{shaft}: the drive applies a gear ratio of its own to the position"
        advice = "set it to 1:1; the ratio belongs in the cell file"
        lines.add("fail", OBJECTS["gear_motor_revolutions"].address, what, advice)
    counts = counts_per_revolution(lines.axis.profile, readings)
    if counts is None:
        what = "encoder resolution is missing or zero"
        lines.add("fail", OBJECTS["encoder_increments"].address, what, "set it in the drive or give it in the profile")


def _offsets(lines: _Lines, readings: Readings) -> None:
    offset = _value(readings, "torque_offset")
    if offset:
        what = f"{offset} per mille is added to the torque already"
        lines.add("warn", OBJECTS["torque_offset"].address, what, "clear it: a feedforward left behind biases readings")


def _watchdog(lines: _Lines, readings: Readings) -> None:
    missing = [name for name in ("abort_connection_option", "consumer_heartbeat") if _value(readings, name) is None]
    for name in missing:
        what = "missing: the drive would not notice that the master is gone"
        lines.add("fail", OBJECTS[name].address, what, "use a drive or firmware that watches the master's heartbeat")
    if not missing:
        lines.add("ok", OBJECTS["consumer_heartbeat"].address, "the drive can watch the master's heartbeat")


def counts_per_revolution(profile: DriveProfile, readings: Readings) -> float | None:
    """Position counts of one motor revolution, None where it cannot be known."""
    counts = profile.position.counts_per_revolution
    if isinstance(counts, Constant):
        return counts.value
    increments = readings.get((counts.object.index, counts.object.subindex))
    turns = readings.get((counts.per.index, counts.per.subindex))
    if not isinstance(increments, int) or not isinstance(turns, int) or increments <= 0 or turns <= 0:
        return None
    return increments / turns


def judge_limits(axis: Axis, arm: ArmConfig, readings: Readings) -> list[CheckItem]:
    """Judge where the joint stands and the drive's software limits against the limits of the cell.

    Parameters
    ----------
    axis : Axis
    arm : ArmConfig
        For the conversion from motor to joint; a coupled joint needs all six motors and is left to the run.
    readings : mapping
        (index, subindex) -> value.
    """
    lines = _Lines(axis)
    turn = counts_per_revolution(axis.profile, readings)
    if turn is None or arm.coupling is not None:
        return lines.items
    low, high = axis.config.position_limit_rad
    position = _value(readings, "position")
    if position is not None:
        q_rad = _joint_rad(arm, axis.joint, position / turn)
        inside = low <= q_rad <= high
        what = f"stands at {q_rad:.3f} rad, limits {low:g} to {high:g} rad"
        advice = "" if inside else "bring the joint inside its limits, or correct zero_offset_rad and position_sign"
        lines.add("ok" if inside else "fail", OBJECTS["position"].address, what, advice)
    _software_limits(lines, arm, readings)
    return lines.items


def software_range_rad(axis: Axis, arm: ArmConfig, readings: Readings) -> tuple[float, float] | None:
    """The drive's own range of the joint [rad], None where it has none or the joint is coupled."""
    turn = counts_per_revolution(axis.profile, readings)
    first, second = (_value(readings, name) for name in ("position_limit_min", "position_limit_max"))
    if turn is None or arm.coupling is not None or first is None or second is None or first == second:
        return None
    ends = [_joint_rad(arm, axis.joint, end / turn) for end in (first, second)]
    return min(ends), max(ends)


def _software_limits(lines: _Lines, arm: ArmConfig, readings: Readings) -> None:
    drive = software_range_rad(lines.axis, arm, readings)
    address = OBJECTS["position_limit_min"].address
    if drive is None:
        what = "no software limits in the drive; the gateway keeps to those of the cell file"
        lines.add("info", address, what)
        return
    low, high = lines.axis.config.position_limit_rad
    what = f"drive {drive[0]:.3f} to {drive[1]:.3f} rad, cell {low:g} to {high:g} rad"
    if drive[0] > low or drive[1] < high:
        lines.add("fail", address, what, "the drive stops before the cell's limit: narrow position_limit_rad")
    else:
        lines.add("ok", address, what)


def _joint_rad(arm: ArmConfig, joint: int, revolutions: float) -> float:
    motor = np.zeros(6)
    motor[joint - 1] = 2 * math.pi * revolutions
    return float(AxisConversion.from_arm(arm).joint_position(motor)[joint - 1])
