"""Pass conditions of the comparison on the figures of the numpy tier: figures first, verdict from them alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.support.pair.model import BETWEEN, FAST, QUASI_STATIC, USUAL, Row
from tests.support.pair.model_gap import GapFigures
from tests.support.pair.model_rig import LIMIT_N

GAP_KEPT_M, GAP_BEFORE_M = 0.1e-3, 1e-3
FLOOR_FACTOR = 1.3
#: Adjustment limit of teaching plus the bias that the force estimate may have [N].
TAUGHT_N = 3.0 + 15.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """One condition.

    Attributes
    ----------
    name, demands : the condition
    value, unit : the one figure that decides
    figures : of all seeds
    passed : whether it is met
    """

    name: str
    demands: str
    value: float
    unit: str
    figures: str
    passed: bool


class Figures:
    """Rows by name, speed and seed."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self._rows = rows
        self.seeds = sorted({int(str(row["seed"])) for row in rows})

    def cycles(self, name: str, speed: float, key: str = "force_n") -> list[list[float]]:
        """Values per seed and cycle; empty where the row was not run."""
        found = [row for row in self._rows if row["row"] == name and row["speed"] == speed and key in row]
        per_seed = [[float(str(row[key])) for row in found if row["seed"] == seed] for seed in self.seeds]
        return per_seed if all(per_seed) else []

    def last(self, name: str, speed: float, key: str = "force_n") -> np.ndarray:
        """Last cycle's value per seed; empty where the row was not run."""
        return np.array([cycles[-1] for cycles in self.cycles(name, speed, key)])


def verdicts(rows: Sequence[Row], gaps: Sequence[GapFigures] = ()) -> list[Verdict]:
    """All conditions that the rows allow to judge."""
    given = Figures(rows)
    found = [condition(given) for condition in CONDITIONS]
    return [item for item in found if item is not None] + ([_gap(gaps)] if gaps else [])


def _list(values: Sequence[float] | np.ndarray, digits: int = 0) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)


def _enough(count: int, of: int, share: float = 0.9) -> bool:
    return bool(count >= int(np.floor(share * of + 1e-9)))


def _p1(given: Figures) -> Verdict | None:
    force = given.last("A", USUAL)
    if not len(force):
        return None
    passed = bool(np.all(force > LIMIT_N))
    return Verdict("P1", "A exceeds the limit in every seed", force.min(), "N, smallest", f"A {_list(force)} N", passed)


def _p2(given: Figures) -> Verdict | None:
    usual = given.last("A", USUAL), given.last("B", USUAL)
    fast = given.last("A", FAST), given.last("B", FAST)
    if not len(usual[1]) or not len(fast[1]):
        return None
    ratio = [a / b for a, b in (usual, fast)]
    above = [int(np.sum(b > LIMIT_N)) for _, b in (usual, fast)]
    passed = bool(np.all(ratio[0] >= 3.0)) and max(above) >= 0.6 * len(given.seeds)
    text = "; ".join(
        f"at {speed} B {_list(b)} N, A/B {_list(r, 1)}, above the limit {count} of {len(b)}"
        for speed, (_, b), r, count in zip((USUAL, FAST), (usual, fast), ratio, above, strict=True)
    )
    demands = "at 1.5 B is 3 times better than A, yet above the limit in 60 % of seeds at 1.5 or 3"
    return Verdict("P2", demands, max(above), "seeds above the limit", text, passed)


def _p3(given: Figures) -> Verdict | None:
    a, nine, more = (given.last(name, QUASI_STATIC) for name in ("A", "C1", "C1 N=17"))
    if not len(a) or not len(more):
        return None
    passed = bool(np.all(nine <= 0.2 * a) and np.all(more <= 0.75 * nine))
    text = f"C1/A {_list(nine / a, 2)}; N=17 over N=9 {_list(more / nine, 2)}"
    text += f"; oracle {_list(given.last('O', QUASI_STATIC))} N"
    demands = "nearly at rest: C1 N=9 at most .2 A, N=17 at most .75 of N=9"
    return Verdict("P3", demands, (more / nine).max(), "N=17 over N=9, largest", text, passed)


def _p3_points(given: Figures) -> Verdict | None:
    force = given.last("C1", QUASI_STATIC, "at_first_knots_n")
    if not len(force):
        return None
    passed = bool(np.all(force <= TAUGHT_N))
    demands = f"force at taught points at most {TAUGHT_N:.0f} N"
    return Verdict("P3 points", demands, force.max(), "N, largest", f"{_list(force)} N", passed)


def _p4(given: Figures) -> Verdict | None:
    cycles, floor = given.cycles("C2c", USUAL), given.last("floor", USUAL)
    if not cycles or not len(floor):
        return None
    passed = [c[-1] < c[0] or c[0] < FLOOR_FACTOR * f for c, f in zip(cycles, floor, strict=True)]
    text = ", ".join(f"{c[0]:.0f}->{c[-1]:.0f}" for c in cycles) + f" N; floor {_list(floor)} N"
    demands = "C2c: last cycle below the first in 9 of 10 seeds"
    return Verdict("P4", demands, sum(passed), f"of {len(passed)} seeds", text, _enough(sum(passed), len(passed)))


def _p4_measured(given: Figures) -> Verdict | None:
    cycles, floor = given.cycles("C2m no lag", USUAL), given.last("floor", USUAL)
    if not cycles or not len(floor):
        return None
    passed = [c[-2] <= 0.9 * c[0] or min(c[0], c[-2]) < FLOOR_FACTOR * f for c, f in zip(cycles, floor, strict=True)]
    lagging = given.cycles("C2m", USUAL)
    text = ", ".join(f"{c[0]:.0f}->{c[-2]:.0f}" for c in cycles) + " N; with lag "
    text += ", ".join(f"{c[0]:.0f}->{c[-1]:.0f}" for c in lagging) + " N"
    return Verdict(
        "P4 measured", "C2m without lag converges", sum(passed), f"of {len(passed)} seeds", text, all(passed)
    )


def _p5(given: Figures) -> Verdict | None:
    table, taught = given.last("C3", BETWEEN), given.last("C1i", BETWEEN)
    if not len(table):
        return None
    ratio = table / taught
    text = f"C3 {_list(table)} N, C1i {_list(taught)} N, ratio {_list(ratio, 2)}, median {np.median(ratio):.2f}"
    demands = "C3 at 1.1 without learning there: median of C3/C1i at most .8"
    return Verdict("P5", demands, float(np.median(ratio)), "median of C3/C1i", text, bool(np.median(ratio) <= 0.8))


def _p5_bare(given: Figures) -> Verdict | None:
    table, taught = given.last("C3, no impedance", BETWEEN), given.last("C1i, no impedance", BETWEEN)
    if not len(table):
        return None
    ratio = table / taught
    nearest = given.last("C3 nearest, no impedance", BETWEEN) / taught
    text = f"ratio {_list(ratio, 2)}, median {np.median(ratio):.2f}; nearest stored speed {_list(nearest, 2)}"
    demands = "the same without impedance: median at most .8"
    return Verdict("P5 bare", demands, float(np.median(ratio)), "median", text, bool(np.median(ratio) <= 0.8))


def _p6(given: Figures) -> Verdict | None:
    force = given.last("C7", USUAL)
    if not len(force):
        return None
    inside = int(np.sum(force < LIMIT_N))
    fast = given.last("C7", FAST)
    text = f"{_list(force)} N; at 3: {_list(fast)} N"
    demands = "C7 within the limit after at most 4 updates in 9 of 10 seeds"
    return Verdict("P6", demands, inside, f"of {len(force)} seeds", text, _enough(inside, len(force)))


def _kept(given: Figures, speed: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Last learning cycle, and the worst of all cycles after it, of C8."""
    cycles = given.cycles("C8", speed)
    if not cycles:
        return None
    frozen = given.cycles("C8", speed, "frozen")
    after = [max(f for f, off in zip(c, marks, strict=True) if off) for c, marks in zip(cycles, frozen, strict=True)]
    return np.array([c[0] for c in cycles]), np.array(after)


def _p7(given: Figures) -> Verdict | None:
    found = _kept(given, USUAL)
    if found is None:
        return None
    text = f"first cycle {_list(found[0])} N, worst cycle with learning off {_list(found[1])} N"
    demands = "C8 below the limit on every sample in every seed, learning off"
    return Verdict("P7", demands, found[1].max(), "N, largest", text, bool(np.all(found[1] < LIMIT_N)))


def _p7_fast(given: Figures) -> Verdict | None:
    found = _kept(given, FAST)
    if found is None:
        return None
    printed = given.cycles("C8 no lead", FAST)
    text = f"first cycle {_list(found[0])} N, worst cycle with learning off {_list(found[1])} N"
    if printed:
        text += f"; without lead and smoothing, last cycle {_list([c[-1] for c in printed])} N"
    demands = "the same at speed setting 3, with lead"
    return Verdict("P7 at 3", demands, found[1].max(), "N, largest", text, bool(np.all(found[1] < LIMIT_N)))


def _p7b(given: Figures) -> Verdict | None:
    even, chosen = given.last("C8u", USUAL), given.cycles("C8", USUAL)
    if not len(even) or not chosen:
        return None
    length = len(given.cycles("C8u", USUAL)[0])
    ratio = np.array([c[length - 1] for c in chosen]) / even
    lower, knots = int(np.sum(ratio < 1.0)), given.last("C8u", USUAL, "knots")
    text = f"C8/C8u {_list(ratio, 2)}, lower in {lower} of {len(ratio)}; knots {_list(knots)}"
    demands = "an advantage of chosen points is claimed only if lower in 8 of 10 seeds"
    return Verdict("P7b", demands, lower, f"of {len(ratio)} seeds", text, _enough(lower, len(ratio), 0.8))


def _p8(given: Figures) -> Verdict | None:
    ratio = given.last("snag", USUAL, "ratio")
    if not len(ratio):
        return None
    same = given.last("snag", USUAL, "frozen_identical")
    passed = bool(np.all(ratio < 0.1) and np.all(same == 1.0))
    text = f"median over mean {_list(ratio, 2)}; learning off: identical in {int(same.sum())} of {len(same)} seeds"
    demands = "cable snag: the median of 5 changes the function by less than .1 of what the mean does"
    return Verdict("P8", demands, float(np.median(ratio)), "median over mean, median of seeds", text, passed)


def _p9(given: Figures) -> Verdict | None:
    constant = given.last("C8 skew .5 ms", USUAL)
    if not len(constant):
        return None
    jitter = given.last("C8 jitter 1 ms", USUAL)
    text = f"{_list(constant)} N; jitter 0 to 1 ms {_list(jitter)} N"
    demands = "SYNC skew of .5 ms: C8 back below the limit"
    return Verdict("P9", demands, constant.max(), "N, largest", text, bool(np.all(constant < LIMIT_N)))


def _drift(given: Figures) -> Verdict | None:
    on, off = given.last("C2c warming", USUAL), given.last("C2c warming, frozen", USUAL)
    if not len(on):
        return None
    text = f"learned on {_list(on)} N, frozen after 2 cycles {_list(off)} N"
    passed = bool(np.all(on < LIMIT_N))
    return Verdict(
        "warm-up", "C2c below the limit while both upper arms grow by .1 mm", on.max(), "N, largest", text, passed
    )


def _gap(gaps: Sequence[GapFigures]) -> Verdict:
    before = np.array([gap.without_m for gap in gaps])
    after = np.array([gap.cycles_m[-1] for gap in gaps])
    text = f"before {_list(1e3 * before, 1)} mm, after {_list(1e3 * after, 3)} mm"
    passed = bool(np.all(before >= GAP_BEFORE_M) and np.all(after <= GAP_KEPT_M))
    demands = "gap kept within 0.1 mm, from 1 mm and more before"
    return Verdict("E5", demands, 1e3 * after.max(), "mm, largest", text, passed)


CONDITIONS = (_p1, _p2, _p3, _p3_points, _p4, _p4_measured, _p5, _p5_bare, _p6, _p7, _p7_fast, _p7b, _p8, _p9, _drift)
