"""Cell file with comments from a draft, and the list of open points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from drives.profile_file import list_profiles
from gateway.newcell import questions
from gateway.newcell.answers import UNSOURCED, Answer, toml_value
from gateway.newcell.interview import Draft, dh_table
from gateway.newcell.nodes import SeenNode
from gateway.newcell.offers import PLACEHOLDER

ARM: Final = "main"
BUS: Final = "a"


@dataclass(frozen=True, slots=True)
class Left:
    """An assumed or open value.

    Attributes
    ----------
    key : str
        Key in the cell file; "" for remarks on the drives.
    value : str
        Current value in the cell file.
    why : str
        Source of that value.
    how : str
        How to determine it.
    """

    key: str
    value: str
    why: str
    how: str


def left_over(draft: Draft) -> tuple[Left, ...]:
    """Return every assumption of a draft, and inconsistencies."""
    found: list[Left] = []
    for question in questions.ALL:
        answer = draft.answers.taken.get(question.key)
        if answer is not None and answer.guessed:
            found.append(Left(question.key, short(answer.value), answer.source, question.ways[0]))
    found += [Left("", "", remark, "") for remark in draft.remarks]
    return tuple(found)


def short(value: Any) -> str:
    """Return a value for a table; equal values of all axes once."""
    if isinstance(value, tuple) and value and all(part == value[0] for part in value):
        return toml_value(value[0])
    if isinstance(value, tuple):
        return (
            ", ".join(
                short(part)
                if isinstance(part, tuple)
                else (f"{part:.4g}" if isinstance(part, float) else toml_value(part))
                for part in value
            )
            or "none"
        )
    return "none" if value is None else toml_value(value)


def cell_text(draft: Draft, files: Callable[[str], str]) -> str:
    """Return the text of the cell file.

    Parameters
    ----------
    draft : Draft
    files : callable
        Path of a file -> its name from the folder of the cell.
    """
    spec, answers = draft.bus, draft.answers
    lines = [
        f"[bus.{BUS}]",
        f"interface = {toml_value(spec.interface)}",
        f"channel = {toml_value(spec.channel)}",
        f"bitrate_bit_s = {spec.bitrate_bit_s}",
        f"sync_period_s = {toml_value(answers.value(questions.SYNC_PERIOD))}",
        f"pacing = {toml_value(answers.value(questions.PACING))}",
    ]
    if spec.options:
        lines.append(f"options = {toml_value(dict(spec.options))}")
    lines = [
        f"# Cell of {draft.robot.name}, drafted by `servo-gateway cell new`. Values marked `assumed` are not",
        "# confirmed and affect result and motion. `servo-gateway check` compares the file with the drives.",
        f"name = {toml_value(draft.answers.value(questions.NAME))}",
        "",
        *lines,
        "",
        *_arm(draft, files),
    ]
    for axis in range(draft.robot.axes):
        lines += ["", *_axis(draft, axis, files)]
    poses = draft.answers.value(questions.POSES)
    lines += ["", "[poses]", *(f"{key} = {toml_value(value)}" for key, value in poses.items())]
    if not poses:
        lines += ["# count, samples, speed: docs/reference/cell-file.md; missing keys have defaults"]
    return "\n".join(lines) + "\n"


def _arm(draft: Draft, files: Callable[[str], str]) -> list[str]:
    answers = draft.answers
    lines = ["[[arm]]", f"name = {toml_value(ARM)}", f"bus = {toml_value(BUS)}"]
    if draft.urdf is not None:
        lines.append(f"robot = {toml_value(files(draft.urdf))}")
    if answers.value(questions.TIP):
        lines.append(_line("tip", answers.taken[questions.TIP.key]))
    lines.append(_line("inertials", answers.taken[questions.INERTIALS.key]))
    lines.append(_line("gravity_m_s2", answers.taken[questions.MOUNTING.key]))
    flange, turn = answers.taken[questions.FLANGE.key], answers.taken[questions.FLANGE_TURN.key]
    if flange.value:
        lines += [_line("flange_xyz_m", flange), _line("flange_rpy_rad", turn)]
        if turn.source != UNSOURCED:
            lines.append(f"flange_source = {toml_value(turn.source)}")
    else:
        lines.append(f"# flange_xyz_m = [0, 0, 0.1]   # {flange.source}")
    rated, load = answers.taken[questions.RATED_LOAD.key], answers.taken[questions.MAX_LOAD.key]
    if rated.value is None:
        lines.append(f"# rated_load_kg = {_sourced(5.0, 'data sheet')}   # {rated.source}")
    else:
        lines.append(f"rated_load_kg = {_sourced(rated.value, rated.source)}")
    lines.append(f"# max_load_kg = 5   # {load.source}" if load.value is None else _line("max_load_kg", load))
    com = answers.taken.get(questions.MAX_LOAD_COM.key)
    if com is not None:
        lines.append(_line("max_load_com_m", com) if com.value else f"# max_load_com_m = [0, 0, 0.25]   # {com.source}")
    if draft.urdf is None:
        rows = dh_table(answers)
        lines += ["", "[arm.dh]", f"convention = {toml_value(rows.convention)}"]
        lines += [
            f"{key} = {toml_value(getattr(rows, key))}" for key in ("alpha_rad", "a_m", "d_m", "theta_offset_rad")
        ]
    return lines


def _axis(draft: Draft, axis: int, files: Callable[[str], str]) -> list[str]:
    answers = draft.answers
    lines = [
        "[[arm.axis]]",
        f"# J{axis + 1}, {draft.robot.joint_names[axis]}: {_device(draft.nodes[axis])}",
        f"node_id = {answers.value(questions.NODES)[axis]}",
    ]
    profile = answers.taken[questions.PROFILE.key]
    name = profile.value[axis]
    shown = name if name in list_profiles() else files(name)
    lines.append(f"profile = {toml_value(shown)}{_remark(profile)}")
    for key in questions.FOR_ALL:
        answer = Answer(answers.taken[key].value[axis], answers.taken[key].source)
        if key in questions.SOURCED:
            lines.append(f"{key} = {_sourced(answer.value, answer.source)}")
        elif key != questions.PROFILE.key:
            lines.append(_line(key, answer))
    torque_source = answers.taken[questions.TORQUE_LIMIT.key].source
    if torque_source.startswith(PLACEHOLDER):
        lines.append("# Placeholder: motion is refused until torque_limit_nm is corrected and its source is stated.")
        lines.append(f"torque_limit_source = {toml_value(torque_source)}")
    return lines


def _sourced(value: float, source: str) -> str:
    return f"{{ value = {toml_value(value)}, source = {toml_value(source)} }}"


def _line(key: str, answer: Answer) -> str:
    return f"{key} = {toml_value(answer.value)}{_remark(answer)}"


def _remark(answer: Answer) -> str:
    return "" if answer.source == UNSOURCED else f"   # {answer.source}"


def _device(node: SeenNode | None) -> str:
    if node is None:
        return "no drive was read"
    who = node.identity
    parts = [who.name or "drive"]
    parts += [f"serial 0x{who.serial_number:X}"] if who.serial_number is not None else []
    parts += [f"firmware {who.software_version}"] if who.software_version else []
    return ", ".join([node.name, *parts])
