"""From the rows over PyBullet and CAN to the figures: counts for two seeds, verdicts for ten."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.figure import clopper_pearson, figure
from benchmarks.pair.bus_rows import BETWEEN, FAST, LEARNING, STATIC, USUAL

Row = dict[str, Any]
Figure = dict[str, Any]
NAN = float("nan")


class Table:
    """Cycles by row, speed and seed."""

    def __init__(self, rows: Sequence[Row], limit_n: float) -> None:
        self.rows, self.limit_n = list(rows), limit_n
        self.seeds = sorted({row["seed"] for row in rows})

    def cycles(self, name: str, speed: float, seed: int) -> list[Row]:
        """All cycles of one run in order."""
        return [row for row in self.rows if (row["row"], row["speed"], row["seed"]) == (name, speed, seed)]

    def force(self, name: str, speed: float, seed: int, cycle: int = -1) -> float:
        """Largest true force of a cycle [N], the last one if none is named; NaN where it was not run."""
        found = self.cycles(name, speed, seed)
        return float(found[cycle]["force_n"]) if len(found) > max(cycle, 0) else NAN

    def count(self, holds: Callable[[int], bool | None]) -> tuple[int, int]:
        """On how many seeds something holds, of how many it is known for."""
        known = [answer for seed in self.seeds if (answer := holds(seed)) is not None]
        return sum(known), len(known)

    def after_learning(self, name: str, speed: float, seed: int) -> bool | None:
        """Whether every cycle after the fourth update stays below the limit."""
        found = self.cycles(name, speed, seed)[LEARNING - 1 :]
        return None if not found else all(row["force_n"] < self.limit_n for row in found)

    def most_after_learning(self, name: str, speed: float, seed: int) -> float:
        """Largest true force of all cycles after the fourth update [N]; NaN where they were not run."""
        found = self.cycles(name, speed, seed)[LEARNING - 1 :]
        return max((row["force_n"] for row in found), default=NAN)

    def cycles_until_inside(self, name: str, speed: float, seed: int) -> float:
        """Number of the first cycle from which on the force stays below the limit; NaN where it never does."""
        found = self.cycles(name, speed, seed)
        outside = [number for number, row in enumerate(found, start=1) if row["force_n"] >= self.limit_n]
        first = max(outside, default=0) + 1
        return float(first) if first <= len(found) else (NAN if not found else float(len(found) + 1))


def _less(a: float, b: float) -> bool | None:
    return None if np.isnan(a) or np.isnan(b) else a < b


def _either(one: bool | None, two: bool | None) -> bool | None:
    return None if one is None and two is None else bool(one) or bool(two)


def _share(hits: int, total: int, goal: str, needed: float | None) -> Figure:
    value = hits / total if total else NAN
    met = None if needed is None or not total else value >= needed
    return figure(value, unit=f"of {total} seeds", interval=clopper_pearson(hits, total)) | {"goal": goal, "met": met}


def _value(values: Sequence[float], unit: str, goal: str, met: Callable[[Sequence[float]], bool] | None) -> Figure:
    known = [value for value in values if not np.isnan(value)]
    if not known:
        return figure(NAN, unit=unit)
    entry = figure(float(np.median(known)), unit=f"{unit}, {len(known)} seeds", interval=(min(known), max(known)))
    return entry | {"goal": goal, "met": bool(met(known)) if met else None}


def _most(limit: float) -> Callable[[Sequence[float]], bool]:
    return lambda values: max(values) <= limit


def _middle(limit: float) -> Callable[[Sequence[float]], bool]:
    return lambda values: bool(np.median(values) <= limit)


def figures(rows: Sequence[Row], limit_n: float, *, judged: bool) -> dict[str, Figure]:
    """Every figure; without `judged` counts only, no verdict."""
    table = Table(rows, limit_n)
    out: dict[str, Figure] = {}

    def share(name: str, holds: Callable[[int], bool | None], goal: str, needed: float | None) -> None:
        hits, total = table.count(holds)
        if total:
            out[name] = _share(hits, total, goal if judged else "count", needed if judged else None)

    def above(name: str, speed: float) -> Callable[[int], bool | None]:
        return lambda seed: _less(limit_n, table.force(name, speed, seed, 0))

    share("P1: A exceeds the limit", above("A", USUAL), "all", 1.0)
    ratio = [table.force("A", USUAL, seed) / table.force("B", USUAL, seed) for seed in table.seeds]
    out["P2: A over B"] = _value(
        ratio, "median, least and most", "all >= 3" if judged else "", (lambda v: min(v) >= 3) if judged else None
    )
    share("P2: B exceeds the limit, speed 1.5", above("B", USUAL), "reported", None)
    share("P2: B exceeds the limit, speed 3", above("B", FAST), "reported", None)
    share(
        "P2: B exceeds the limit, speed 1.5 or 3",
        lambda s: _either(above("B", USUAL)(s), above("B", FAST)(s)),
        ">= 0.6",
        0.6,
    )
    share(
        "P4: C2c, cycle 6 below cycle 1",
        lambda seed: _less(table.force("C2c", USUAL, seed), table.force("C2c", USUAL, seed, 0)),
        ">= 0.9",
        0.9,
    )
    share("P6: C7 inside the limit after 4 updates", lambda s: table.after_learning("C7", USUAL, s), ">= 0.9", 0.9)
    share("P7: C8 inside the limit, then frozen", lambda s: table.after_learning("C8", USUAL, s), "all", 1.0)
    share("P7: C8 at speed 3, then frozen", lambda s: table.after_learning("C8", FAST, s), "all", 1.0)
    for speed, goal_n in ((USUAL, 20.0), (FAST, 40.0)):
        most = [table.most_after_learning("C8", speed, seed) for seed in table.seeds]
        goal = f"all <= {goal_n:g}" if judged else ""
        out[f"C8 at speed {speed:g}: largest force after learning, and while frozen"] = _value(
            most, "N, median, least and most", goal, _most(goal_n) if judged else None
        )
        until = [table.cycles_until_inside("C8", speed, seed) for seed in table.seeds]
        goal = "median <= 4" if judged and speed == USUAL else ""
        out[f"C8 at speed {speed:g}: cycles until the force stays inside the limit"] = _value(
            until, "median, least and most", goal, _middle(4.0) if goal else None
        )
    for speed in (USUAL, FAST):
        last = [table.force("C8 elsewhere", speed, seed) for seed in table.seeds]
        path = f"C8 along a path of the seed, speed {speed:g}"
        out[f"{path}: last learning cycle"] = _value(last, "N, median, least and most", "reported", None)
        until = [table.cycles_until_inside("C8 elsewhere", speed, seed) for seed in table.seeds]
        out[f"{path}: cycles until the force stays inside the limit"] = _value(
            until, "median, least and most", "reported", None
        )
    out |= _intervals(table.rows)
    if judged:
        out |= _judged(table)
    out |= _gaps(table)
    out |= _hostile(table)
    for name in ("A", "B", "C1", "C1i", "C2m", "C2c", "C7", "C8", "C8u", "C8r"):
        forces = [table.force(name, USUAL, seed) for seed in table.seeds]
        if not np.isnan(forces).all():
            out[f"largest force of the last cycle, {name}"] = _value(forces, "N, median, least and most", "", None)
    for name in ("A", "B", "C8"):
        last = [table.cycles(name, USUAL, seed)[-1:] for seed in table.seeds]
        moved = [1e3 * float(one[0]["part_off_m"]) for one in last if one and "part_off_m" in one[0]]
        goal = "all <= 1" if judged and name == "C8" else ""
        out[f"part off the path of the master alone, {name}"] = _value(
            moved, "mm, median, least and most", goal, _most(1.0) if goal else None
        )
    return {name: figure for name, figure in out.items() if not np.isnan(figure["value"])}


def _intervals(rows: Sequence[Row]) -> dict[str, Figure]:
    """What the intervals of the force hold, over all cycles and commands, and how wide they are."""
    held_rows = [row for row in rows if "held" in row]
    if not held_rows:
        return {}
    held = np.array([row["held"] for row in held_rows])
    share, each = float(held.mean()), held.mean(axis=0)
    unit = f"of {len(held_rows)} cycles; least and most of six components"
    half = float(np.median([row["half_n"] for row in held_rows]))
    return {
        "95 % intervals of the force that hold the truth": figure(
            share, "0.93 .. 0.97", unit, (float(each.min()), float(each.max()))
        ),
        "half width of these intervals, median": figure(half, "<= 10", "N"),
    }


def _gaps(table: Table) -> dict[str, Figure]:
    """Distance sensors: largest true deviation of any gap, by one relation and in the last two cycles."""
    label = "E5 in the cell: largest gap error"
    return {
        f"{label} before learning": _value(
            _gap_mm(table, "gap"), "mm, median, least and most", "all >= 1", lambda values: min(values) >= 1.0
        ),
        f"{label} after learning": _value(_gap_mm(table, "E5"), "mm, median, least and most", "all <= 0.1", _most(0.1)),
    }


def _hostile(table: Table) -> dict[str, Figure]:
    """Another day: what shall be borne within the limit, and what shall be stopped below twice of it and named."""
    met = [row for row in table.rows if row["row"] == "hostile"]
    out: dict[str, Figure] = {}
    for name in dict.fromkeys(row["trouble"] for row in met):
        rows = [row for row in met if row["trouble"] == name]
        apart, goes_on = "gap_m" in rows[0], rows[0]["goes_on"]
        most = [1e3 * row["gap_m"] if apart else row["force_n"] for row in rows]
        stopped, named = (sum(bool(row[key]) for row in rows) for key in ("stopped", "named"))
        good = stopped == 0 if goes_on else named == len(rows)
        goal = "no stop" if goes_on else "stopped and named"
        if not apart:
            limit = table.limit_n if goes_on else 2.0 * table.limit_n
            good = good and max(most) <= limit
            goal = f"all <= {limit:g}, {goal}"
        unit = f"{'mm off' if apart else 'N'}, median, least and most; stopped {stopped}, named {named}"
        out[f"another day: {name}"] = _value(most, unit, goal, lambda _, good=good: good)
    return out


def _gap_mm(table: Table, name: str) -> list[float]:
    found = [table.cycles(name, USUAL, seed)[-2:] for seed in table.seeds]
    return [1e3 * max(float(cycle["gap_m"]) for cycle in last) for last in found if last]


def _judged(table: Table) -> dict[str, Figure]:
    seeds, out = table.seeds, {}
    static = [table.force("C1", STATIC, s) / table.force("A", STATIC, s) for s in seeds]
    out["P3: C1 over A at rest, 9 points"] = _value(static, "median, least and most", "all <= 0.2", _most(0.2))
    finer = [table.force("C1 N=17", STATIC, s) / table.force("C1", STATIC, s) for s in seeds]
    out["P3: 17 points over 9"] = _value(finer, "median, least and most", "all <= 0.75", _most(0.75))
    finest = [table.force("C1 N=33", STATIC, s) / table.force("C1", STATIC, s) for s in seeds]
    out["P3: 33 points over 9"] = _value(finest, "median, least and most", "reported", None)
    speed = [table.force("C3", BETWEEN, s, 0) / table.force("C1i", BETWEEN, s, 0) for s in seeds]
    out["P5: C3 over C1i at 1.1"] = _value(speed, "median, least and most", "median <= 0.8", _middle(0.8))
    known = [table.force("C3", BETWEEN, s, 1) / table.force("C1i", BETWEEN, s, 1) for s in seeds]
    out["P5: the same in the second cycle"] = _value(known, "median, least and most", "reported", None)
    there = [table.force("C2c", BETWEEN, s) / table.force("C1i", BETWEEN, s, 0) for s in seeds]
    out["P5: learned at 1.1 itself over C1i"] = _value(there, "median, least and most", "reported", None)
    even = [table.force("C8", USUAL, s, LEARNING - 1) / table.force("C8u", USUAL, s) for s in seeds]
    out["P7b: C8 over C8u, last learning cycle"] = _value(even, "median, least and most", "reported", None)
    lower = [ratio for ratio in even if not np.isnan(ratio)]
    if lower:
        out["P7b: C8 below C8u"] = _share(sum(ratio < 1.0 for ratio in lower), len(lower), "reported", None)
    snags = [row for row in table.rows if row["row"] == "snag"]
    if snags:
        same = sum(bool(row["frozen_identical"]) for row in snags)
        out["P8: learning off, function unchanged"] = _share(same, len(snags), "all", 1.0)
        kinds = [row["median_m"] / row["mean_m"] for row in snags]
        out["P8: median over mean after a snag"] = _value(kinds, "median, least and most", "all < 0.1", _most(0.1))
        for what, name in (("mean", "mean_m"), ("median", "median_m"), ("median, no snag at all", "repeat_m")):
            moved = [1e3 * row[name] for row in snags if name in row]
            if moved:
                unit = "mm, median, least and most"
                out[f"P8: function moved by a snag, {what}"] = _value(moved, unit, "reported", None)
    for label, goal in (("C8 skew .5 ms", "all"), ("C8 jitter 1 ms", "reported")):
        hits, total = table.count(lambda s, label=label: table.after_learning(label, USUAL, s))
        if total:
            out[f"P9: {label} inside the limit"] = _share(hits, total, goal, 1.0 if goal == "all" else None)
    stops = [row for row in table.rows if row["row"] == "stop"]
    if stops:
        out["P10: SYNCs until the stop along the path begins"] = _value(
            [row["begun_syncs"] for row in stops], "median, least and most", "all <= 3", _most(3.0)
        )
        out["P10: SYNCs until all twelve are disabled"] = _value(
            [row["syncs"] for row in stops], "median, least and most", "reported", None
        )
        after = [row["force_after_n"] for row in stops]
        out["P10: force after the stop"] = _value(after, "N, median, least and most", "reported", None)
    half = [abs(table.force("C1i, half the step", USUAL, s) / table.force("C1i", USUAL, s) - 1.0) for s in seeds]
    out["P11: change with half the step"] = _value(half, "median, least and most", "all < 0.02", _most(0.02))
    return out
