"""Command `cost`: cycle time and torque reserve before and after the load data are entered."""

from __future__ import annotations

import math
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import axis_names, grid, number
from gateway.commands.measure import arm_option
from gateway.commands.shared_options import (
    FILE,
    cell_argument,
    common,
    json_option,
    load_option,
    result_argument,
    session_of,
    write_json,
)

if TYPE_CHECKING:
    from gateway.cost.job import MoveCost, SegmentCost

#: Segments of a path that are listed at most; --json has all of them.
MOST_LISTED = 40
#: A smaller change of the cycle time counts as none.
SAME_SHARE = 0.005


@click.command()
@cell_argument
@result_argument
@load_option("label", "Load of RESULT, if it holds several.")
@click.option(
    "--path",
    "path_file",
    metavar="FILE",
    type=FILE,
    help="Path file of `follow`; default: standard moves, each joint alone and all joints at once.",
)
@arm_option
@json_option
@common
def cost(
    cell: Path,
    load_file: Path,
    label: str | None,
    path_file: Path | None,
    arm_name: str | None,
    json_out: str | None,
) -> None:
    """Cycle time and torque reserve of a path before and after the load data are entered. Nothing moves.

    RESULT is a result of this arm, or CELL.loads.json#LABEL. Each motion is planned as fast as the limits of the cell
    allow with no load, the rated load and the identified load in the torque model. The reserve of each plan is that
    with the identified load mounted.

    \b
    Example:
      servo-gateway cost cell.toml result.json --path path.toml
    """
    from gateway.cell.config import load_cell
    from gateway.cost.job import cost_of
    from gateway.follow.path import refuse_other_axes
    from gateway.model.arm_model import arm_named
    from gateway.result.numerals import SAID, half_width, with_interval
    from gateway.result.values import plain_values

    loaded = load_cell(cell)
    arm = arm_named(loaded, arm_name)
    refuse_other_axes(arm, "cost")
    session = session_of()
    with session.working("cycle times"):
        found = cost_of(loaded, arm, load_file, label, path_file)
    write_json(json_out, plain_values(found))
    session.show(f"load '{found.load}': {with_interval(found.mass_kg, found.mass_std_kg)} kg on arm '{found.arm}'")
    title = f"cycle time as planned with each load; torque reserve with the mounted load, % of the limit ({SAID})"
    has_gripper = math.isfinite(found.moves[0].settings[-1].load_acceleration_reserve)
    columns = ["path", "entered", "cycle s", *axis_names(len(arm.axis)), *(["load acc."] if has_gripper else [])]
    rows = []
    for move in found.moves:
        for setting in move.settings:
            reserves = zip(setting.torque_reserve, setting.torque_reserve_std, strict=True)
            cells = [f"{100 * reserve:.1f} ± {number(100 * half_width(std), 1)}" for reserve, std in reserves]
            if has_gripper:
                cells.append(number(100 * setting.load_acceleration_reserve, 1))
            rows.append([move.name, setting.name, number(setting.cycle_time_s), *cells])
    session.show(grid(title, columns, rows, left=2))
    names = [setting.name for setting in found.moves[0].settings]
    segments = [row for move in found.moves for row in _segment_rows(move)]
    session.show(grid("segments: duration and limit", ["path", "segment", *names], segments[:MOST_LISTED]))
    for move in found.moves:
        session.show(_answer(move))
    for remark in found.remarks:
        session.note(remark)


def _segment_rows(move: MoveCost) -> list[list[str]]:
    def cell(one: SegmentCost | None) -> str:
        return "not possible" if one is None else f"{one.duration_s:.2f} s, {one.limited_by}"

    each = zip_longest(*(setting.segments for setting in move.settings))
    return [[move.name, str(number), *map(cell, several)] for number, several in enumerate(each, start=1)]


def _answer(move: MoveCost) -> str:
    """Say in one sentence how much slower the path is with the entered load, and why."""
    before, after = move.settings[0], move.settings[-1]
    slower_s = after.cycle_time_s - before.cycle_time_s
    overloaded = [f"J{axis}" for axis, reserve in enumerate(before.torque_reserve, start=1) if reserve < 0]
    if slower_s < SAME_SHARE * before.cycle_time_s:
        return f"{move.name}: the entered load does not change the cycle time ({after.cycle_time_s:.2f} s)"
    pairs = zip(before.segments, after.segments, strict=True)
    limits = dict.fromkeys(
        name for old, new in pairs if new.duration_s > old.duration_s for name in new.limited_by.split(", ")
    )
    why = f"{move.name}: {slower_s:.2f} s slower ({100 * slower_s / before.cycle_time_s:.1f} %) than with no load "
    why += f"entered, limited by {', '.join(limits)}"
    return why + (f"; without the load data {', '.join(overloaded)} would be overloaded" if overloaded else "")
