"""Robots of a plant over a year, as nature would have them: products of what changes, waves of many lengths.

Shares no formula with the analysis: a gain is a product (constant, magnet, load, wear), friction falls with warmth as
oil does. The random walk is a sum of waves whose lengths and phases are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

AXES = 6
DAYS = 365
FIRST = datetime(2025, 1, 1, 5, 30)
#: Loss of a gain in a year [1].
WEAR = 0.02
PROGRAMS = ("pick", "place", "weld")
WAVES = 40
#: Size of the random walk over the noise of a check, of a usual robot.
LIKE = 0.4
#: Lengths of the waves over 2 pi [d].
LENGTH_DAY = (1.2, 60.0)


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """One robot and its truth.

    Attributes
    ----------
    name : str
    worn : axis whose gain drifts, -1 = none
    noise : of the gain of every axis, from check to check (6,)
    random_walk : standard deviation of the random walk of every gain (6,)
    day : (n,) of every check
    temperature_c : (n, 6)
    load_kg : (n,)
    """

    name: str
    worn: int
    noise: np.ndarray
    random_walk: np.ndarray
    day: np.ndarray
    temperature_c: np.ndarray
    load_kg: np.ndarray
    columns: dict[str, np.ndarray | list[str]]


def draw(seed: int, number: int, worn_axes: int, lag_differences: float) -> Robot:
    """A robot with a check a day; a few days are missing.

    Parameters
    ----------
    seed, number : int
    worn_axes : int
        1: the gain of one axis drifts; 0: none does.
    lag_differences : float
        Standard deviation of the logarithm of random walk over noise: 0 = homogeneous fleet.
    """
    rng = np.random.default_rng([seed, number])
    day = np.flatnonzero(rng.random(DAYS) > 0.03) + rng.uniform(-0.1, 0.1)
    count = len(day)
    hall = 21.0 + 7.0 * np.sin(2 * np.pi * (day + rng.uniform(0, 365)) / 365.0) + rng.normal(0, 1.5, count)
    warm = hall[:, None] + rng.uniform(3, 15, AXES) + rng.normal(0, 1.5, (count, AXES))
    masses = rng.uniform(1.0, 20.0, len(PROGRAMS))
    program = rng.integers(0, len(PROGRAMS), count)
    noise = 0.0015 * rng.lognormal(0.0, 0.3, AXES)
    size_of = LIKE * noise * rng.lognormal(0.0, lag_differences, AXES)
    random_walk = _waves(rng, day, size_of)
    axis = int(rng.integers(AXES)) if worn_axes else -1
    wear = np.ones((count, AXES))
    if worn_axes:
        wear[:, axis] += WEAR * day / 365.25
    magnet = 1.0 + rng.normal(-0.0008, 0.0003, AXES) * (warm - 20.0)
    bending = 1.0 + rng.normal(0.0, 1e-4, AXES) * masses[program][:, None]
    gain = rng.normal(1.0, 0.02, AXES) * magnet * bending * wear + random_walk - 1.0
    columns: dict[str, np.ndarray | list[str]] = {"load": [PROGRAMS[each] for each in program]}
    for joint in range(AXES):
        oil = np.exp(-rng.uniform(0.003, 0.012) * (warm[:, joint] - 20.0))
        size = rng.uniform(1.0, 40.0)
        slow = _waves(rng, day, np.array([0.004]))[:, 0]
        columns |= {
            f"gain{joint + 1}": gain[:, joint] + noise[joint] * rng.standard_normal(count),
            f"gain{joint + 1}_std": np.full(count, 0.015),
            f"friction_band{joint + 1}_nm": size * oil * (1 + slow + rng.normal(0, 0.01, count)),
            f"coulomb{joint + 1}_nm": size * 1.1 * oil * (1 + slow + rng.normal(0, 0.02, count)),
            f"viscous{joint + 1}_nm_s_rad": size * 2.0 * oil**3 * (1 + rng.normal(0, 0.03, count)),
            f"temp{joint + 1}_c": warm[:, joint],
        }
    columns["mass_kg"] = masses[program] * (1 + rng.normal(0, 0.002, count))
    columns["mass_std_kg"] = 0.01 * masses[program]
    return Robot(f"hall{number // 100}_{number % 100:02d}", axis, noise, size_of, day, warm, masses[program], columns)


def _waves(rng: np.random.Generator, day: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sum (n, M) of waves of drawn lengths and phases, from a week to a year, of that standard deviation (M,)."""
    length = np.exp(rng.uniform(*np.log(LENGTH_DAY), (len(size), WAVES)))
    power = length * rng.exponential(1.0, (len(size), WAVES))
    power *= (size**2 / power.sum(axis=1))[:, None]
    cosine, sine = rng.standard_normal((2, len(size), WAVES)) * np.sqrt(power)
    angle = day[:, None, None] / length
    return (cosine * np.cos(angle) + sine * np.sin(angle)).sum(axis=2)


@cache
def _likeness() -> tuple[np.ndarray, np.ndarray]:
    """Distances [d] and the correlation of the random walk there, as the mean over all drawn waves."""
    away = np.arange(0.0, DAYS + 1.0, 0.1)
    length = np.linspace(*LENGTH_DAY, 4000)
    return away, np.array([np.cos(each / length).mean() for each in away])


def likeness(day: np.ndarray) -> np.ndarray:
    """Correlation (n, n) of the random walk on these days."""
    return np.interp(np.abs(day[:, None] - day), *_likeness())


def covariance(robot: Robot, axis: int) -> np.ndarray:
    """Covariance (n, n) of the checks of a gain, from the truth."""
    return robot.random_walk[axis] ** 2 * likeness(robot.day) + robot.noise[axis] ** 2 * np.eye(len(robot.day))


def write(robots: list[Robot], path: Path) -> int:
    """A table of summaries of some robots; how many rows it has."""
    tables = []
    for number, robot in enumerate(robots):
        count = len(robot.day)
        table_columns: dict[str, object] = {
            "cell": [robot.name] * count,
            "arm": ["main"] * count,
            "software": ["servo-gateway 0.1.0"] * count,
            "time_utc": [FIRST + timedelta(days=float(day)) for day in robot.day],
        }
        table_columns |= {f"serial{joint}": np.full(count, 1000 * number + joint) for joint in range(1, AXES + 1)}
        tables.append(pa.table(table_columns | robot.columns))
    table = pa.concat_tables(tables)
    pq.write_table(table, path)
    return table.num_rows
