"""A fleet of ten simulated robots and one of them, as the commands hand them to their pages."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np

from benchmarks.fleet.drifts import NOW
from benchmarks.fleet.plant import DAYS, Robot, draw, write
from gateway.fleet.analysis import FLEET_FILE, AsOf, run_analysis
from gateway.fleet.ingest import ingest
from gateway.fleet.store import open_or_make
from gateway.report.fleet_page import render_fleet, render_robot
from gateway.result.fleet import read_fleet, read_robot
from tests.data.fleets import one_by_one

ROBOTS = 10
WORN, GONE, HEAVIER, YOUNG = 1, 3, 4, 7
#: Day from which a robot is not seen, from which its part is another one, and on which a new one is seen first.
LAST_DAY, OTHER_DAY, FIRST_DAY = 260, 200, 330


def fleet_pages() -> Iterator[tuple[str, str]]:
    """Name and text of the page of the fleet, and of the robot that is named first."""
    with tempfile.TemporaryDirectory() as name:
        store = open_or_make(Path(name) / "store")
        table = Path(name) / "checks.parquet"
        write([_robot(number) for number in range(ROBOTS)], table)
        ingest(store, [table], NOW + timedelta(days=1))
        run_analysis(store, one_by_one, AsOf(NOW))
        found = read_fleet(store.analysis / FLEET_FILE)
        yield "fleet", render_fleet(found)
        worn = next(line for line in found.robots if any("gain" in said for said in line.why))
        yield "fleet-robot", render_robot(read_robot(store.analysis / "robots" / f"{worn.robot}.json"))


def _robot(number: int) -> Robot:
    robot = draw(3, number, int(number == WORN), 0.0)
    if number == GONE:
        return _from_to(robot, 0, LAST_DAY)
    if number == YOUNG:
        return _from_to(robot, FIRST_DAY, DAYS)
    if number == HEAVIER:
        mass = np.asarray(robot.columns["mass_kg"], dtype=float)
        mass = np.where(robot.day > OTHER_DAY, 1.2 * mass, mass)
        return replace(robot, columns=robot.columns | {"mass_kg": mass})
    return robot


def _from_to(robot: Robot, first: int, last: int) -> Robot:
    """What was seen of it between two days."""
    use = slice(*np.searchsorted(robot.day, [first, last]).tolist())
    return replace(robot, day=robot.day[use], columns={name: column[use] for name, column in robot.columns.items()})
