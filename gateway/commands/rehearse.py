"""Command `rehearse`: what a plan would find on a robot, before the robot is there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from gateway.commands.console import grid
from gateway.commands.measure import arm_option
from gateway.commands.shared_options import (
    FILE,
    cell_argument,
    common,
    effect_names,
    recording_file,
    session_of,
    write_json,
)
from gateway.errors import InputError


@click.command()
@cell_argument
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="REHEARSAL.json",
    type=FILE,
    callback=recording_file,
    help="Answer, written again after each place of an effect.",
)
@click.option("--resume", is_flag=True, help="Continue REHEARSAL.json: measure only what is missing.")
@click.option("--plan", "plan_file", metavar="PLAN.json", type=FILE, help="Plan file; default: the plan of the cell.")
@click.option("--effects", callback=effect_names, metavar="EFFECT,..", help="Effects to put in; default: all.")
@click.option(
    "--clean-arms",
    type=click.IntRange(min=1),
    default=24,
    show_default=True,
    metavar="N",
    help="Arms without an effect, for the load and for false names.",
)
@arm_option
@common
def rehearse(
    cell: Path,
    output: Path,
    resume: bool,
    plan_file: Path | None,
    effects: frozenset[str],
    clean_arms: int,
    arm_name: str | None,
) -> None:
    """What a plan would find on this robot: known effects are put into simulated arms, and found again or not.

    Nothing moves, and no bus is needed. A quarter of an hour on two processors with all effects.

    \b
    Example:
      servo-gateway rehearse cell.toml -o rehearsal.json
    """
    from gateway.jobs.rehearse import rehearse as rehearsed
    from gateway.report import rehearsal_page
    from gateway.result.numerals import significant
    from gateway.result.origin import read_rehearsal, sealed

    session, earlier = session_of(), None
    if resume:
        earlier = read_rehearsal(output)
    elif output.exists():
        raise InputError(f"{output} exists: continue it with --resume, or choose another file")
    with session.progress(0.0, "rehearsal") as bar:

        def done(body: Mapping[str, Any], places: int, total: int) -> None:
            write_json(str(output), sealed(body))
            bar.set(places, total, f"{places} of {total} places")

        answer = rehearsed(cell, arm_name, plan_file, effects, clean_arms, earlier=earlier, done=done)
    rows, head = [rehearsal_page.effect_cells(entry) for entry in answer["effects"]], rehearsal_page.COLUMNS
    session.show(grid("effects, and the size from which half of the arms show them by name", head, rows, left=5))
    for family in answer["families"]:
        session.show(f"{family['name']}: {rehearsal_page.family_sentence(family)}")
    for pair in answer["confused"]:
        session.show(rehearsal_page.pair_sentence(pair))
    for name, case in answer["load"].items():
        if case is not None:
            session.show(rehearsal_page.load_sentence(name, case))
    minutes = significant(answer["time_under_power_s"] / 60.0, 2)
    session.show(f"time under power, without and with the load: {minutes} min")
    session.show(f"named on arms without an effect: {answer['false_names']} of {answer['clean_arms']}")
    session.show(f"{output}: all arms; `servo-gateway report {output} -o PAGE.html` draws every effect")
