"""Analyse a fleet: repeat the estimation of recordings, compute trends and states per robot, and store each at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any, Final

from drives.files import replace_file
from gateway.errors import GatewayError, InputError
from gateway.fleet.checks import Row, estimated_rows
from gateway.fleet.columns import ESTIMATE, columns, library
from gateway.fleet.history import history
from gateway.fleet.robot_state import judged, program_loads
from gateway.fleet.store import Store
from gateway.fleet.trends import NoiseShapes, noise_shapes_of, seen_likelihoods, trends_of
from gateway.fleet.workers import Spreading
from gateway.result.fleet import STATES, FleetHealth, RobotHealth, RobotLine
from gateway.result.origin import in_words, sealed, software
from gateway.result.values import json_text, plain_values

#: Estimates that are held before they are written.
_HELD: Final = 32
#: Number of robots used to estimate the correlated noise of the fleet: more would not change it.
_LEARNT_FROM: Final = 64
#: Robots that a worker is given at a time.
_TOGETHER: Final = 4
FLEET_FILE: Final = "fleet.json"


@dataclass(frozen=True, slots=True)
class _AssessRobots:
    """Assess some robots in a worker."""

    store: Store
    noise_shapes: NoiseShapes
    as_of: datetime

    def __call__(self, robots: Sequence[str]) -> tuple[list[RobotLine], list[str]]:
        lines, failed = [], []
        for robot in robots:
            try:
                found = health_of(self.store, robot, self.noise_shapes, self.as_of)
            except InputError as error:
                failed.append(str(error))
                (self.store.analysis / "robots" / f"{robot}.json").unlink(missing_ok=True)
                lines.append(RobotLine(robot, "", "", "cannot tell", 10.0, (str(error),), 0, "", ""))
                continue
            _write(self.store.analysis / "robots" / f"{robot}.json", found)
            lines.append(found.line)
        return lines, failed


@dataclass(frozen=True, slots=True)
class _Estimate:
    """Estimate a recording in a worker."""

    now: datetime

    def __call__(self, task: tuple[str, Path]) -> list[Row]:
        return estimated_rows(task[1], task[1].stem, self.now)


@dataclass(frozen=True, slots=True)
class _Learn:
    """Estimate the correlated noise of one robot in a worker."""

    store: Store

    def __call__(self, robot: str) -> dict[str, list[Any]]:
        return seen_likelihoods(history(self.store.read(robot)).series)


def run_analysis(
    store: Store, spread: Spreading, as_of: datetime, notify: Callable[[str, int], None] = lambda *_: None
) -> FleetHealth:
    """Estimate the recordings not yet estimated by this version, and assess every robot.

    Parameters
    ----------
    store : Store
    spread : Spreading
    as_of : datetime
        Time for which the robots are assessed, UTC.
    notify : callable
        Called with the completed step and its count.

    Returns
    -------
    FleetHealth
        Also on disk, with a file per robot; `failed` names what could not be read.
    """
    failed: list[str] = []
    estimated = _estimate(store, spread, failed, notify)
    robots = store.robots()
    step = max(1, len(robots) // _LEARNT_FROM)
    seen = [done for _, done in spread(_Learn(store), robots[::step][:_LEARNT_FROM])]
    noise_shapes = noise_shapes_of([each for each in seen if not isinstance(each, GatewayError)])
    lines: list[RobotLine] = []
    for _, done in spread(_AssessRobots(store, noise_shapes, as_of), _batches(robots)):
        if isinstance(done, GatewayError):
            failed.append(str(done))
            continue
        lines += done[0]
        failed += done[1]
        notify("robots", len(lines))
    lines.sort(key=lambda line: (STATES.index(line.state), -line.urgency, line.robot))
    fleet = FleetHealth(
        as_of=in_words(as_of),
        software=software(),
        robots=tuple(lines),
        checks=sum(line.checks for line in lines),
        estimated=estimated,
        failed=tuple(failed),
    )
    _write(store.analysis / FLEET_FILE, fleet)
    return fleet


def health_of(store: Store, robot: str, noise_shapes: NoiseShapes, as_of: datetime) -> RobotHealth:
    """Return the health of one robot.

    Raises
    ------
    InputError
        A file of it cannot be read.
    """
    rows = store.read(robot)
    past = history(rows)
    first = past.rows["time_utc"][0].as_py() if past.rows.num_rows else as_of
    trends, curves = trends_of(past.series, noise_shapes, first)
    loads = program_loads(past.rows, as_of)
    gross = int(past.series.set_aside.sum())
    remarks = [*past.remarks, *([f"{gross} outliers were rejected"] if gross else [])]
    return RobotHealth(
        line=judged(robot, past, trends, loads, as_of),
        as_of=in_words(as_of),
        software=software(),
        trends=trends,
        loads=loads,
        curves=curves,
        remarks=tuple(remarks),
        first_check=f"{first:%Y-%m-%d}",
    )


def _estimate(store: Store, spread: Spreading, failed: list[str], notify: Callable[[str, int], None]) -> int:
    """Estimate recordings; each result is stored as it arrives."""
    now = datetime.now(UTC)
    held: list[Row] = []
    count = 0
    try:
        for task, done in spread(_Estimate(now), _not_estimated(store)):
            if isinstance(done, GatewayError):
                failed.append(f"{task[1]}: {done}" if str(task[1]) not in str(done) else str(done))
                continue
            held += done
            count += 1
            notify("recordings", count)
            if len(held) >= _HELD:
                failed += _add(store, held)
                held = []
    finally:
        if held:
            failed += _add(store, held)
    return count


def _not_estimated(store: Store) -> Iterator[tuple[str, Path]]:
    """Yield recordings that this version has not estimated."""
    known: tuple[str, set[str] | None] = ("", None)
    for robot, path in store.recordings():
        if robot != known[0]:
            try:
                rows = store.read(robot)
                reported = zip(
                    rows["kind"].to_pylist(), rows["software"].to_pylist(), rows["sha256"].to_pylist(), strict=True
                )
                known = (robot, ({sha256 for kind, by, sha256 in reported if kind == ESTIMATE and by == software()}))
            except InputError:  # reported where the robot is assessed; nothing can be added to its files
                known = (robot, None)
        if known[1] is not None and path.stem not in known[1]:
            yield robot, path


def _add(store: Store, rows: list[Row]) -> tuple[str, ...]:
    """Add rows; return messages about files that cannot take them."""
    pa = library("pyarrow")
    reported = pa.schema([("robot", pa.string()), ("month", pa.string()), *columns()])
    with store.writing():
        return store.add(pa.Table.from_pylist(rows, schema=reported)).refused


def _batches(robots: Sequence[str]) -> Iterator[tuple[str, ...]]:
    left = iter(robots)
    while batch := tuple(islice(left, _TOGETHER)):
        yield batch


def _write(path: Path, health: FleetHealth | RobotHealth) -> None:
    replace_file(path, json_text(sealed(plain_values(health))))
