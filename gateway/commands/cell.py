"""Command group `cell`: create and view cell files (the description of an arm with its drives)."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drives.files import replace_file
from gateway.commands.console import findings_table, grid
from gateway.commands.interview import answer_of_line
from gateway.commands.measure import arm_option
from gateway.commands.shared_options import (
    FILE,
    NEW_FILE,
    PAGE_FILE,
    cell_argument,
    cell_context,
    common,
    json_option,
    key_values,
    note_remarks,
    refuse_unwritable,
    reserve,
    session_of,
    write_json,
)
from gateway.errors import ConfigError

if TYPE_CHECKING:
    from drives.draft.questions import Question
    from gateway.newcell.answers import Answer, CellAnswers
    from gateway.newcell.interview import Draft


@click.group()
def cell() -> None:
    """Cell files: description of an arm, its drives and gears."""


@cell.command("schema")
@common
def cell_schema() -> None:
    """Print the JSON schema of a cell file, for editors.

    \b
    Example:
      servo-gateway cell schema > cell.schema.json
    """
    from gateway.cell.config import cell_schema as schema

    write_json("-", schema())


@cell.command("view")
@cell_argument
@arm_option
@click.option(
    "-o", "--output", metavar="PAGE.html", type=PAGE_FILE, help="Page to write; default: beside the cell file."
)
@common
def cell_view(cell: Path, arm_name: str | None, output: Path | None) -> None:
    """Draw the arm at its named postures with the keep-out boxes, and list the assumptions. Needs no bus.

    \b
    Example:
      servo-gateway cell view cell.toml
    """
    from gateway.cell.config import load_cell
    from gateway.commands.pages import write_page
    from gateway.commands.plan_view import LOAD_COLUMNS, loads_in_words, space_in_words, view_of_cell
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.motion.workspace import workspace_of
    from gateway.result.library import library_of

    loaded = load_cell(cell)
    config = arm_named(loaded, arm_name)
    robot = arm_robot(loaded, config)
    note_remarks(robot)
    workspace = workspace_of(config, robot)
    target, session = output or cell.with_suffix(".html"), session_of()
    refuse_unwritable(target, "-o")
    loads = loads_in_words(cell)
    write_page(target, view_of_cell(config, workspace, loads))
    session.show("\n  ".join([f"arm '{config.name}': {target}", *space_in_words(workspace)]))
    if loads:
        session.show(grid(f"loads in {library_of(cell)}: value ± half of the 95 % interval", LOAD_COLUMNS, loads))


@cell.command("new")
@click.option("--robot", help="URDF of the arm; or `dh` to enter Denavit-Hartenberg parameters.")
@click.option(
    "--tip", metavar="LINK", help="Last link of the arm, if the URDF also contains jaws, fingers or a second arm."
)
@click.option("--bus", metavar="SPEC", help="Bus of the drives; node ids, ratings and limits are read from the drives.")
@click.option("--offline", is_flag=True, help="Use no bus: only EDS and DCF files and answers.")
@click.option(
    "--eds", multiple=True, metavar="FILE", help="EDS or DCF: one per axis starting at the base, or one for all."
)
@click.option("--answers", type=FILE, help="Answer file (TOML); no questions are asked.")
@click.option(
    "--answer", "typed", multiple=True, metavar="KEY=VALUE", help="One answer; takes precedence over the answer file."
)
@click.option("--save-answers", metavar="FILE", type=NEW_FILE, help="Write the answers of this run to an answer file.")
@click.option(
    "--listen", "listen_s", type=click.FloatRange(0.05, 60.0), default=1.0, show_default=True, help="Seconds."
)
@click.option("-o", "--output", required=True, metavar="CELL", type=NEW_FILE, help="Cell file to write.")
@json_option
@common
def cell_new(
    robot: str | None,
    tip: str | None,
    bus: str | None,
    offline: bool,
    eds: Sequence[str],
    answers: Path | None,
    typed: Sequence[str],
    save_answers: Path | None,
    listen_s: float,
    output: Path,
    json_out: str | None,
) -> None:
    """Create a cell file: reads what it can, asks for the rest, and marks assumed values.

    Joint limits come from the URDF; node ids, profiles, ratings and limits from the drives, or from EDS and DCF files.
    Nothing is written to a drive and nothing moves.

    \b
    Example:
      servo-gateway cell new --robot robot.urdf --bus socketcan:can0 -o cell.toml
    """
    from gateway.model.arm_model import arm_robot
    from gateway.newcell import questions
    from gateway.newcell.answers import CellAnswers, GivenAnswer, given_answers
    from gateway.newcell.cell_text import left_over
    from gateway.newcell.interview import interview
    from gateway.newcell.nodes import BusEyes
    from gateway.preflight.drive_check import require_passed
    from gateway.result.values import plain_values

    session, kept = session_of(), output.with_suffix(".answers.toml")
    resumed = given_answers(kept, {}, questions.KEYS) if answers is None and kept.is_file() else {}
    if resumed:
        session.note(f"{kept}: {len(resumed)} answers of an earlier run are reused; delete the file to answer again")
    named = {"robot": robot, "tip": tip, "bus": bus, "offline": offline or None, "eds": list(eds) or None}
    answered = {key: GivenAnswer(value, f"--{key}", Path.cwd()) for key, value in named.items() if value is not None}
    answered = given_answers(answers, key_values("--answer", typed), questions.KEYS) | answered
    said = CellAnswers(answered, str(answers or "answers"), None if answers is not None else _ask, resumed)
    try:
        draft = interview(said, BusEyes(listen_s, reserve), output.stem, session.note)
        _write(draft, output)
    except BaseException as error:
        if said.typed:  # the answers are kept, so that they need not be typed again when a drive does not answer
            _save(said, kept)
            error.add_note(f"the answers are kept in {kept}: run the same command again to continue")
        raise
    finally:
        if save_answers is not None and said.said:
            _save(said, save_answers)
    if answers is None:
        kept.unlink(missing_ok=True)
    context = cell_context(output)
    (arm,) = context.arms
    arm_robot(context.loaded, arm)
    context.profiles(arm)
    left, items = left_over(draft), [context.bus_load(arm), *(context.check_drives(arm) if draft.looked else ())]
    session = session_of()
    shown = [item for item in items if item.severity in ("warn", "fail")]
    if shown:
        session.show(findings_table(shown, "differences between drives and cell file"))
    guesses = [entry for entry in left if entry.key]
    if guesses:
        rows = [[entry.key, entry.value, entry.why, entry.how] for entry in guesses]
        session.show(grid("assumed, to be determined", ["key", "value", "why", "how to determine it"], rows, left=4))
    for entry in left:
        if not entry.key:
            session.show(f"to do: {entry.why}")
    session.show(f"{output}: {len(said.said)} answers, {len(guesses)} keys assumed; next: servo-gateway check {output}")
    write_json(
        json_out,
        {
            "schema": 1,
            "cell": str(output),
            "answers": len(said.said),
            "left": [{"key": entry.key, "value": entry.value, "why": entry.why, "how": entry.how} for entry in left],
            "findings": plain_values(items),
        },
    )
    require_passed(items, f"{output} is written, but the drives fail the check")


def _ask(
    question: Question, offer: Answer | None, number: int, most: int, read: Callable[[Any], Answer]
) -> Answer | None:
    """Ask at the terminal until the answer is valid; Enter accepts the proposed value."""
    from gateway.newcell.cell_text import short

    place = f"question {number} of {most}" + (" at most" if most > number else "")
    click.echo(f"\n{place}: {question.asks}\n  {question.ways[0]}", err=True)
    if offer is not None:
        click.echo(f"  Enter: {short(offer.value)} ({offer.source})", err=True)
    return answer_of_line(question.key, read, optional=offer is not None)


def _named_from(folder: Path) -> Callable[[str], str]:
    """Return a function: path of a file -> its name relative to a folder."""
    return lambda name: os.path.relpath(Path(name).resolve(), folder.resolve())


def _write(draft: Draft, output: Path) -> None:
    """Write the cell file after it has passed the strict reader."""
    from gateway.cell.config import parse_cell
    from gateway.newcell.cell_text import cell_text

    text = cell_text(draft, _named_from(output.parent))
    try:
        parse_cell(text, str(output))
    except ConfigError as error:
        shown = error.lines or (str(error),)
        raise ConfigError.of(
            [*shown, "nothing was written: the line numbers refer to the draft; correct the answers"]
        ) from error
    replace_file(output, text)


def _save(said: CellAnswers, path: Path) -> None:
    from gateway.newcell.answers import answers_text

    replace_file(path, answers_text(said, _named_from(path.parent)))
