"""Command group `profiles`: list and show drive profiles, and draft new ones."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drives.files import replace_file
from gateway.commands.bus import DEFAULT_BUS
from gateway.commands.interview import answer_of_line
from gateway.commands.shared_options import (
    FILE,
    NEW_FILE,
    common,
    json_option,
    key_values,
    reserve,
    session_of,
    show_remarks,
    write_json,
)
from gateway.errors import ConfigError

if TYPE_CHECKING:
    from drives.draft.answers import ProfileAnswers
    from drives.draft.device import Device

#: Number of hints printed with an open question.
HINTS_SHOWN = 1


@click.group()
def profiles() -> None:
    """Drive profiles: units, objects and limits of each drive model."""


@profiles.command("list")
@json_option
@common
def profiles_list(json_out: str | None) -> None:
    """List every profile: name, description, torque object, and whether motion is allowed.

    \b
    Example:
      servo-gateway profiles list
    """
    from drives.profile_file import list_profiles, load_profile
    from gateway.commands.console import grid

    columns = ["name", "description", "torque", "nature", "moved"]
    rows: list[list[str]] = []
    for name in list_profiles():
        profile = load_profile(name)
        moved = "read only" if profile.obstacles else "moved"
        rows.append([name, profile.description, profile.torque.kind, profile.torque.nature, moved])
    write_json(json_out, {"schema": 1, "profiles": [dict(zip(columns, row, strict=True)) for row in rows]})
    session_of().show(grid("drive profiles", columns, rows, left=len(columns)))


@profiles.command("show")
@click.argument("name")
@common
def profiles_show(name: str) -> None:
    """Print a profile as TOML (a name of the list, or a file).

    \b
    Example:
      servo-gateway profiles show generic-cia402
    """
    from drives.profile_file import load_profile

    click.echo(load_profile(name).text, nl=False)


@profiles.command("schema")
@common
def profiles_schema() -> None:
    """Print the JSON schema of a profile.

    \b
    Example:
      servo-gateway profiles schema > profile.schema.json
    """
    from drives.profile_file import profile_schema

    write_json("-", profile_schema())


@profiles.command("new")
@click.option("--eds", required=True, metavar="FILE", type=FILE, help="EDS or DCF of the drive.")
@click.option("--from-drive", "node_id", metavar="NODE", type=click.IntRange(1, 127), help="Also read this drive.")
@click.option("--bus", "bus_spec", metavar="SPEC", help=f"Bus of that drive; default: {DEFAULT_BUS}.")
@click.option("--answers", "answer_file", metavar="FILE", type=FILE, help="Answers as TOML, one key each.")
@click.option(
    "--answer", "typed", metavar="KEY=VALUE", multiple=True, help="One answer; takes precedence over the answer file."
)
@click.option("--name", metavar="NAME", help="Name of the profile; default: name of the output file.")
@click.option("-o", "--output", required=True, metavar="PROFILE.toml", type=NEW_FILE, help="Draft to write.")
@json_option
@common
def profiles_new(
    eds: Path,
    node_id: int | None,
    bus_spec: str | None,
    answer_file: Path | None,
    typed: tuple[str, ...],
    name: str | None,
    output: Path,
    json_out: str | None,
) -> None:
    """Draft a profile from an EDS or DCF; missing facts are asked at a terminal, or given with --answer.

    A draft with open questions about the torque can be read by every command, but motion is refused. The drive is only
    read, and not accessed at all if another master is active on the bus.

    \b
    Example:
      servo-gateway profiles new --eds drive.eds --from-drive 1 -o drive.toml
    """
    from drives.draft.device import device_of_sheet
    from drives.draft.questions import open_questions
    from drives.draft.text import draft, profile_name
    from drives.profile_file import list_profiles, parse_profile
    from gateway.newcell.answers import profile_answers

    if node_id is None and bus_spec is not None:
        raise click.UsageError("--bus SPEC belongs to --from-drive NODE.")
    if output.suffix != ".toml":
        raise click.UsageError(f"-o {output}: the file name of a profile must end with .toml.")
    if output.stem in list_profiles():
        raise ConfigError(f"{output}: this name is used by a built-in profile: choose another name")
    answers = profile_answers(answer_file, key_values("--answer", typed))
    device = device_of_sheet(eds)
    show_remarks(str(eds), device.sheet.remarks)
    if node_id is not None:
        device = _ask_drive(device, node_id, bus_spec or DEFAULT_BUS)
    if _at_terminal():
        answers = _ask(device, answers)
    text = draft(device, answers, name or profile_name(output.stem))
    profile = parse_profile(text, str(output), output.parent)
    replace_file(output, text)
    left = open_questions(device, answers)
    session = session_of()
    session.show(f"draft: {output}")
    for question in left:
        session.show(f"open: {question.key}: {question.asks}")
        for hint in question.ways[:HINTS_SHOWN]:
            session.show(f"      {hint}")
    for obstacle in profile.obstacles:
        session.show(f"refuses motion: {obstacle}")
    if not profile.obstacles:
        session.show(f'next: name it in the cell file, profile = "{output.stem}", then servo-gateway check CELL')
    asked = [{"key": each.key, "asks": each.asks, "ways": list(each.ways)} for each in left]
    body = {"schema": 1, "profile": str(output), "name": profile.name, "open": asked}
    body |= {"obstacles": list(profile.obstacles), "left_out": [str(remark) for remark in device.sheet.remarks]}
    write_json(json_out, body)


def _at_terminal() -> bool:
    """Return whether questions can be asked at a terminal."""
    return sys.stdin.isatty()


def _ask_drive(device: Device, node_id: int, bus_spec: str) -> Device:
    from drives.bus import BusSpec, open_bus
    from drives.draft.device import ask_drive

    spec = BusSpec.parse(bus_spec)
    reserve(spec)
    with open_bus(spec) as bus:
        return ask_drive(bus, node_id, device)


def _ask(device: Device, answers: ProfileAnswers) -> ProfileAnswers:
    """Ask the open questions one by one; Enter leaves a question open."""
    from drives.draft.questions import next_question
    from gateway.newcell.forms import plain_text

    asked: set[str] = set()
    while (question := next_question(device, answers, asked)) is not None:
        session_of().note(f"\n{question.asks}")
        for hint in question.ways:
            session_of().note(f"  - {hint}")
        form = question.form
        answer = answer_of_line(question.key, lambda line, form=form: form(plain_text(line), 0), optional=True)
        if answer is not None:
            answers = answers.model_copy(update={question.key: answer})
        asked.add(question.key)
    return answers
