"""The draft itself: TOML with a comment wherever something was read, answered or left open."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from drives.cia402 import FOLLOWING, Mode, mode_supported
from drives.draft.answers import ProfileAnswers, address_of
from drives.draft.device import Address, Device, velocity_unit_rad_s
from drives.draft.questions import COUNTS, RATED, has_counts, is_current, open_questions, rated_address, torque_address
from drives.errors import ProfileError
from drives.objects import DataType
from drives.profile import CyclicMode, Watchdog, needed_writes
from drives.profile_file import contradictions, parse_profile
from drives.toml_text import toml_string

#: Written beside what bringing up needs, where the drive has it.
USEFUL_WRITES: Final = (
    0x1006, 0x1017, 0x1401, 0x1402, 0x1403, 0x1801, 0x1802, 0x1803, 0x1A01, 0x1A02, 0x605A, 0x60B2, 0x60C0, 0x60C2
)  # fmt: skip
#: Placeholder for an unknown encoder resolution; such a drive is not moved.
COUNTS_ASSUMED: Final = 65536
_ABORT_CONNECTION: Final = {"quick stop": 3, "disable voltage": 2}


def draft(device: Device, answers: ProfileAnswers, name: str) -> str:
    """Text of a profile.

    Parameters
    ----------
    device : Device
    answers : ProfileAnswers
    name : str
        Of the profile.

    Returns
    -------
    str
        TOML that the profile loader takes; it lists the obstacles that prevent motion.

    Raises
    ------
    ProfileError
        The name is none, or the sheet has no torque and none was named.
    """
    text = _text(device, answers, name, _reasons(device, answers))
    found = contradictions(parse_profile(text, name), device.sheet)
    return _text(device, answers, name, (*_reasons(device, answers), *found)) if found else text


def _text(device: Device, answers: ProfileAnswers, name: str, no_motion: Iterable[str]) -> str:
    sections = (
        _head(device, answers, name, tuple(no_motion)),
        _identity(device),
        _torque(device, answers),
        _velocity(device, answers),
        _position(device, answers),
        _TIMES.format(
            cyclic_mode=_cyclic_mode(device, answers),
            ignored=answers.ignored_status or "0",
        ),
        _heartbeat(device, answers),
        _write(device, answers),
        *(_WARNING.format(code=code.strip()) for code in (answers.warning_codes or "").split(",") if code),
    )
    return "\n".join(section for section in sections if section)


def profile_name(text: str) -> str:
    """A name that a profile may have, made of any text."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.") or "drive"


def _reasons(device: Device, answers: ProfileAnswers) -> tuple[str, ...]:
    """Return why this drive cannot be moved, as far as sheet and drive show it."""
    found = []
    modes = device.value_of(0x6502)
    if modes is not None and modes[0] and not any(mode_supported(modes[0], mode) for mode in FOLLOWING):
        found.append(f"neither cyclic synchronous nor interpolated position mode: {modes[1]} = 0x{modes[0]:X}")
    there = {index for index, _ in device.sheet.entries}
    denied = {index for (index, sub), value in device.live.items() if value is None and not device.has(index, sub)}
    lacking = [f"0x{index:04X}" for index in _needed(device, answers) if index not in there or index in denied]
    if lacking:
        found.append(f"no {', '.join(lacking)}: the drive lacks what bringing it up needs")
    return tuple(found)


def _cyclic_mode(device: Device, answers: ProfileAnswers) -> CyclicMode:
    """Return the mode as answered; else cyclic synchronous position, unless the drive states interpolated position."""
    modes, _ = device.value_of(0x6502) or (None, "")
    stated = [] if modes is None else [mode for mode in FOLLOWING if mode_supported(modes, mode)]
    return answers.cyclic_mode or (7 if stated == [Mode.INTERPOLATED_POSITION] else 8)


def _watchdog(device: Device) -> Watchdog:
    """Return the heartbeat, unless the drive has node guarding alone."""
    return "node guarding" if device.has(0x100C) and not device.has(0x1016, 1) else "heartbeat"


def _needed(device: Device, answers: ProfileAnswers) -> tuple[int, ...]:
    return needed_writes(_cyclic_mode(device, answers), _watchdog(device), has_option=device.has(0x6007))


def _head(device: Device, answers: ProfileAnswers, name: str, no_motion: tuple[str, ...]) -> str:
    sheet = device.sheet
    lines = [
        "# Draft of a drive profile: check every line that says `assumed`. Keys: docs/reference/drive-profile.md.",
        *(f"# Open: {question.key}: {question.asks}" for question in open_questions(device, answers)),
        f"name = {toml_string(name)}",
        f"description = {toml_string(' '.join((sheet.vendor_name, sheet.product_name)).strip() or sheet.name)}",
        f"source = {toml_string(_origin(device))}",
    ]
    if no_motion:
        lines += [
            "# The drive is read and not moved, by its data sheet. Remove a line only where the sheet is wrong.",
            "no_motion = [",
            *(f"    {toml_string(reason)}," for reason in no_motion),
            "]",
        ]
    return "\n".join(lines) + "\n"


def _origin(device: Device) -> str:
    text = f"{device.sheet.name}, read by a program"
    if device.identity is not None:
        firmware = device.identity.software_version or "not stated"
        text += f"; node {device.identity.node_id} (firmware {firmware}), read from drive"
    return text


def _identity(device: Device) -> str:
    known = device.sheet if device.identity is None else device.identity
    entries = (("vendor_id", known.vendor_id), ("product_code", known.product_code), ("revision_min", known.revision))
    lines = [f"{key} = 0x{value:08X}" for key, value in entries if value]
    if not lines:
        return "# No [identity]: the data sheet does not say of which device it is. Matches every vendor and product.\n"
    return "\n".join(("# 0x1018. revision_min: older firmware may count otherwise.", "[identity]", *lines)) + "\n"


def _torque(device: Device, answers: ProfileAnswers) -> str:
    address = torque_address(device, answers)
    if address is None:
        advice = "answer torque_object, such as torque_object=0x30D1:02; without one this drive can weigh no load"
        raise ProfileError(f"{device.sheet.name} has neither 0x6077 nor 0x6078 to read a torque from", advice=advice)
    kind = _number(device, "torque_object", address)
    missing = _missing_for_torque(device, answers)
    source = answers.torque_source or "source not stated"
    if missing:
        source = f"assumed, not answered: {', '.join(missing)}"
    lines = [
        "# What one bit of the torque is. With basis `assumed` the drive is read and not moved.",
        "[torque]",
        f"kind = {toml_string(answers.torque_kind or 'permille_rated_torque')}",
        f"object = {_object(address, kind)}",
        f'nature = "{answers.torque_nature or "unknown"}"',
        f"signed = {'true' if kind.startswith('i') else 'false'}",
        "filter_s = 0.001  # assumed",
        f"source = {toml_string(source)}",
        f'basis = "{_basis(answers, missing)}"',
    ]
    if answers.internal_unit_a is not None:
        lines.append(f"internal_unit_a = {_constant(answers.internal_unit_a, source)}")
    for key in ("current_reference", "torque_constant_per") if is_current(answers) else ():
        value = getattr(answers, key)
        lines.append(f'{key} = "{value}"' if value else f'# {key} = "rms" or "peak"')
    return "\n".join([*lines, *_rated(device, answers, source)]) + "\n"


def _number(device: Device, key: str, address: Address) -> DataType:
    """Return the type of an object that an answer names; raises `ProfileError` where the sheet has no number there."""
    kind = device.type_of(*address)
    if kind is None:
        advice = f"answer {key} with an object of the data sheet that is a number"
        raise ProfileError(f"{device.sheet.name} has no number at {_where(address)}", advice=advice)
    return kind


def _missing_for_torque(device: Device, answers: ProfileAnswers) -> list[str]:
    """Keys without which the torque arithmetic is a guess."""
    about = {
        "torque_kind", "torque_nature", "rated_unit", "rated_value", "internal_unit_a", "current_reference",
        "torque_constant_per", "torque_source",
    }  # fmt: skip
    missing = [question.key for question in open_questions(device, answers) if question.key in about]
    return missing if missing or answers.torque_is_sourced else ["torque_source"]


def _basis(answers: ProfileAnswers, missing: list[str]) -> str:
    if missing:
        return "assumed"
    return "measured" if (answers.torque_source or "").strip().lower().startswith("measured") else "manual"


def _rated(device: Device, answers: ProfileAnswers, source: str) -> list[str]:
    if (answers.torque_kind or "permille_rated_torque") not in RATED:
        return []
    if answers.rated_value is not None:
        return ["", "[torque.rated]", f"value = {answers.rated_value!r}", f"source = {toml_string(source)}"]
    address = rated_address(device, answers)
    if address is None:
        return ["", "# [torque.rated]: the data sheet has no object for it, and no value was answered"]
    kind, shown = _number(device, "rated_object", address), device.value_of(*address)
    lines = ["", f"# {shown[1]}: {shown[0]}" if shown is not None else f"# {_where(address)} is read from the drive"]
    said = source if answers.rated_unit is not None else "assumed: CiA 402-2 counts in thousandths; some drives do not"
    lines += [
        "[torque.rated]",
        f"object = {_object(address, kind)}",
        f"unit = {answers.rated_unit or 0.001!r}",
        f"source = {toml_string(said)}",
    ]
    return lines


def _velocity(device: Device, answers: ProfileAnswers) -> str:
    kind = device.type_of(0x606C)
    unit = velocity_unit_rad_s(device)
    if answers.velocity_unit_rad_s is not None:
        unit = answers.velocity_unit_rad_s, answers.velocity_source or "assumed, answered without a source"
    if kind is None or unit is None:
        if answers.ramp_counts_s2 is not None:
            advice = "answer velocity_unit_rad_s as well, or leave ramp_counts_s2 out"
            raise ProfileError("ramp_counts_s2 is not used without the velocity unit of 0x606C", advice=advice)
        return "# No [velocity]: the unit of 0x606C is not known.\n"
    lines = ["[velocity]", f"object = {_object((0x606C, 0), kind)}", f"unit_rad_s = {_constant(*unit)}"]
    if answers.ramp_counts_s2 is not None:
        lines.append(f"ramp_counts_s2 = {_constant(answers.ramp_counts_s2, unit[1])}")
    return "\n".join(lines) + "\n"


def _position(device: Device, answers: ProfileAnswers) -> str:
    return "\n".join(("[position]", f"object = {_object((0x6064, 0), 'i32')}", *_counts(device, answers))) + "\n"


def _counts(device: Device, answers: ProfileAnswers) -> tuple[str, ...]:
    if answers.counts_object is not None:
        address = address_of(answers.counts_object)
        kind = _number(device, "counts_object", address)
        return (f"counts_per_revolution = {{ object = {_object(address, kind)} }}",)
    if answers.counts_per_revolution is not None:
        source = answers.position_source or answers.torque_source or "assumed, answered without a source"
        return (f"counts_per_revolution = {_constant(answers.counts_per_revolution, source)}",)
    counts, per = device.type_of(*COUNTS[0]), device.type_of(*COUNTS[1])
    if counts is not None and has_counts(device):
        named = f"object = {_object(COUNTS[0], counts)}" + ("" if per is None else f", per = {_object(COUNTS[1], per)}")
        note = "# Read from the drive each time; `check` fails where 0x6091 or 0x6092 scale the position once more."
        return note, f"counts_per_revolution = {{ {named} }}"
    return (f"counts_per_revolution = {_constant(COUNTS_ASSUMED, 'assumed, not answered: counts_per_revolution')}",)


_TIMES: Final = """\
# Long timeouts; shorter ones only where the manual gives them. Mode by 0x6502: 8 cyclic synchronous, 7 interpolated.
[state_machine]
cyclic_mode = {cyclic_mode}
ignored_status = {ignored}
transition_timeout_s = 2.0
brake_delay_s = 0.1

[sdo]
timeout_s = 0.5
slow_timeout_s = 3.0
"""
_WARNING: Final = """\
[[emcy]]
code = {code}
text = "a warning, as answered"
advice = "see the manual of the drive"
warning = true
"""


def _heartbeat(device: Device, answers: ProfileAnswers) -> str:
    answer = answers.lost_heartbeat
    said = "as answered" if answer else "assumed: quick stop"
    lines = [
        f"# 0x6007 when the heartbeat of the master is lost: 3 quick stop; with 2 it is not moved; {said}.",
        "# `servo-gateway check CELL --prove-stop` tries it.",
        "[heartbeat]",
        f'watchdog = "{_watchdog(device)}"',
        "consumer_ms = 500",
    ]
    if device.has(0x6007):
        lines.append(f"abort_connection = {_ABORT_CONNECTION[answer or 'quick stop']}")
    if device.has(0x1017) and _watchdog(device) == "heartbeat":
        lines.append("producer_ms = 100")
    return "\n".join(lines) + "\n"


def _write(device: Device, answers: ProfileAnswers) -> str:
    there = {index for index, _ in device.sheet.entries}
    allow = sorted({*_needed(device, answers), *USEFUL_WRITES} & there)
    rows = [", ".join(f"0x{index:04X}" for index in allow[at : at + 8]) for at in range(0, len(allow), 8)]
    lines = [
        "# Every object that the master may write. 0x6072 and 0x607D make a drive safer where their units are known.",
        "[write]",
        "allow = [",
        *(f"    {row}," for row in rows),
        "]",
    ]
    return "\n".join(lines) + "\n"


def _object(address: Address, kind: DataType) -> str:
    return f'{{ index = 0x{address[0]:04X}, subindex = {address[1]}, type = "{kind}" }}'


def _constant(value: float, source: str) -> str:
    return f"{{ value = {value!r}, source = {toml_string(source)} }}"


def _where(address: Address) -> str:
    return f"0x{address[0]:04X}:{address[1]:02X}"
