"""Checks of robots as a plant would log them, for tests: straight out of the random generator."""

from __future__ import annotations

import csv
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from gateway.errors import DataUnusable, GatewayError

FIRST = datetime(2026, 1, 1, 6, 0)


def checks(
    cell: str,
    *,
    days: Iterable[int] = range(60),
    gain_per_year: float = 0.0,
    per_k: float = 0.0005,
    noise: float = 0.0005,
    seed: int = 0,
    mass_kg: float = 5.0,
) -> list[dict[str, object]]:
    """A row a day of an arm of two axes whose second gain drifts, in a hall that warms up over the year."""
    rng = np.random.default_rng([seed, len(cell)])
    rows: list[dict[str, object]] = []
    for day in days:
        warm = 22.0 + 8.0 * np.sin(2 * np.pi * day / 365.0) + rng.normal(0, 1.5, 2)
        gain = [0.01, 0.02] + per_k * (warm - 22.0) + rng.normal(0, noise, 2)
        gain[1] += gain_per_year * day / 365.25
        band = 4.0 - 0.02 * (warm - 22.0) + rng.normal(0, 0.02, 2)
        rows.append(
            {"cell": cell, "arm": "main", "serial1": 11, "serial2": 12, "software": "servo-gateway 0.1.0",
             "time_utc": (FIRST + timedelta(days=int(day))).isoformat(), "gain1": gain[0], "gain2": gain[1],
             "gain1_std": 0.01, "gain2_std": 0.01, "friction_band1_nm": band[0], "friction_band2_nm": band[1],
             "temp1_c": warm[0], "temp2_c": warm[1], "load": "pick", "mass_kg": mass_kg + rng.normal(0, 0.01),
             "mass_std_kg": 0.02}
        )  # fmt: skip
    return rows


def write_table(path: Path, rows: Iterable[Mapping[str, object]]) -> Path:
    """A table of summaries."""
    rows = list(rows)
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def double_unless_killed(task: tuple[int, str]) -> int:
    """Twice the number; the first who comes to number 3 is killed, and leaves the mark that he was there."""
    number, mark = task
    if number == 3 and not Path(mark).exists():
        Path(mark).write_text("killed")
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def slowly_doubled(number: int) -> int:
    """Twice the number, after a while in which its scheduler can go away."""
    time.sleep(0.05)
    return 2 * number


def one_by_one(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    """Work in this process: a `gateway.fleet.workers.Spreading`."""
    for item in items:
        try:
            yield item, function(item)
        except GatewayError as error:
            yield item, error


def spoilt(item: int) -> int:
    """Return 0 of 0; 1 is an error of the data, anything else a defect."""
    if item == 1:
        raise DataUnusable("too few")
    return 0 // (item == 0)
