"""Ingest, questions and the analysis of a simulated fleet: speed, power, false alarms."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import duckdb
import numpy as np

from benchmarks.figure import figure, share
from benchmarks.fleet.attainable import detected_on
from benchmarks.fleet.bound import earliest_day, threshold
from benchmarks.fleet.plant import DAYS, FIRST, Robot, draw, write
from gateway.fleet.analysis import run_analysis
from gateway.fleet.ingest import ingest
from gateway.fleet.store import Store, open_or_make
from gateway.fleet.workers import workers
from gateway.result.fleet import RobotHealth, read_robot

#: Every other robot wears.
ONE_WORN_IN = 2
PER_FILE = 50
#: Robots for which the earliest possible detection is computed.
BEST_OF = 100
NOW = FIRST.replace(tzinfo=UTC) + timedelta(days=DAYS)
QUESTIONS = {
    "the last check of every robot": "select robot, max(last_utc) from '{months}' group by robot",
    "gain of every axis, robot and month": "select robot, month, gain from '{months}' order by robot, month",
    "robots by the change of a gain over the year": "select robot, max(gain[2]) - min(gain[2]) as moved from '{months}'"
    " group by robot order by moved desc",
    "every check of one robot": "select time_utc, gain, friction_band_nm from"
    " read_parquet('{checks}/robot={robot}/*/*.parquet') order by time_utc",
    "one month of one robot": "select * from read_parquet('{checks}/robot={robot}/month=2025-07/*.parquet')",
}


@dataclass(frozen=True, slots=True)
class Plant:
    """Number of robots, their seed, and the spread of their random walks."""

    seed: int
    robots: int
    lag_differences: float = 0.0

    def fleet(self) -> Iterator[Robot]:
        """Robots, one after another."""
        for number in range(self.robots):
            yield draw(self.seed, number, int(number % ONE_WORN_IN == 0), self.lag_differences)


def filled(store: Path, plant: Plant, folder: Path) -> tuple[Store, dict[str, dict]]:
    """A store with a year of every robot, and how fast it was filled."""
    folder.mkdir(parents=True, exist_ok=True)
    rows, held, files = 0, [], []
    for number, robot in enumerate(plant.fleet(), start=1):
        held.append(robot)
        if len(held) == PER_FILE or number == plant.robots:
            files.append(folder / f"part{len(files):03d}.parquet")
            rows += write(held, files[-1])
            held = []
    opened = open_or_make(store)
    started, used = time.perf_counter(), time.process_time()
    done = ingest(opened, files, datetime.now(UTC))
    took, used = time.perf_counter() - started, time.process_time() - used
    assert done.added == rows, done
    started = time.perf_counter()
    again = ingest(opened, files[:1], datetime.now(UTC))
    assert again.added == 0, again
    return opened, {
        "summaries ingested": figure(rows, ">= 1"),
        "summaries ingested a second": figure(rows / took, ">= 5000", "1/s"),
        "the same, by processor time": figure(rows / used, unit="1/s"),
    }


def questions(store: Store) -> dict[str, dict]:
    """Time of every question that a fleet is asked, the slowest of three each."""
    robot = store.robots()[0]
    found = {}
    for said, text in QUESTIONS.items():
        asked = text.format(months=store.months, checks=store.path / "checks", robot=robot)
        took = []
        for _ in range(3):
            started = time.perf_counter()
            assert duckdb.connect().execute(asked).fetchall()
            took.append(time.perf_counter() - started)
        found[f"question: {said}"] = figure(max(took), "<= 2", "s")
    return found


def drifts(store: Store, plant: Plant) -> dict[str, dict]:
    """Return the day of detection of drifts over the earliest possible, power, and false alarms."""
    started = time.perf_counter()
    with workers(None) as spread:
        found = run_analysis(store, spread, NOW)
    took = time.perf_counter() - started
    assert not found.failed, found.failed
    named = {line.cell: line.robot for line in found.robots}
    in_time, over, best, false, series = [], [], [], 0, 0
    z = float("nan")
    for robot in plant.fleet():
        health = read_robot(store.analysis / "robots" / f"{named[robot.name]}.json")
        series = max(series, len(health.trends))
        z = threshold(len(health.trends)) if np.isnan(z) else z
        false += sum(
            trend.found_on is not None
            for trend in health.trends
            if not (trend.quantity == "gain" and trend.joint == robot.worn + 1)
        )
        if robot.worn < 0:
            continue
        possible = earliest_day(robot, z)
        if 1.2 * possible <= DAYS:
            day = _detected_on(health, robot)
            in_time.append(day <= 1.2 * possible)
            over.append(day / possible)
            if len(best) < BEST_OF:
                best.append(detected_on(robot, plant.lag_differences, len(health.trends)) <= 1.2 * possible)
    years = plant.robots * DAYS / 365.25
    spread_of = np.quantile(over, [0.05, 0.5, 0.95])
    return {
        "worn gains detected by 1.2 times the earliest possible day": share(np.array(in_time), ">= 0.95"),
        "the same, with the true law of the random walks": share(np.array(best), "printed"),
        "day of detection over the earliest possible: median": figure(float(spread_of[1]), "<= 1.2")
        | {"interval": [float(spread_of[0]), float(spread_of[2])]},
        "false alarms in a robot year, all axes and quantities": figure(false / years, "<= 0.01", "1/a")
        | {"interval": _poisson(false, years)},
        "robot years": figure(years, unit="a"),
        "series of a robot": figure(series),
        "least threshold by numbers": figure(z),
        "time of the analysis": figure(took, unit="s"),
        "load of the machine (processors: 2)": figure(os.getloadavg()[0]),
    }


def _detected_on(health: RobotHealth, robot: Robot) -> float:
    """Return the day on which the worn gain was detected; infinite = never."""
    for trend in health.trends:
        if trend.quantity == "gain" and trend.joint == robot.worn + 1 and trend.found_on is not None:
            return float((datetime.fromisoformat(trend.found_on) - FIRST).days + 1)
    return float("inf")


def _poisson(count: int, years: float) -> list[float]:
    from scipy.stats import chi2

    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return [float(low) / years, float(chi2.ppf(0.975, 2 * count + 2)) / 2 / years]
