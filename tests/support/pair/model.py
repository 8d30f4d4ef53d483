"""The numpy tier: every row of the comparison over several seeds, without bus and without masses.

`figures(seeds)` gives one dict per cycle of every run, `gaps(seeds)` those of the distance sensors; what is made of
them is in `model_verdicts`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gateway.pair.embodiments import EMBODIMENTS, Embodiment, with_gains
from gateway.pair.learning_update import LearningRule
from gateway.pair.speed_table import ExtrapolationWarning, SpeedTable
from gateway.pair.transform_function import TransformFunction
from sim.pair.errors import PairErrors, draw, ideal, without_lag
from tests.support.pair.model_rig import BASES, Run, Track, controller, exact, fixed_function, run_all, teach, track
from tests.support.pair.model_rows import cycle_rows
from tests.support.pair.model_tune import stored

Row = dict[str, object]

QUASI_STATIC, SLOW, BETWEEN, USUAL, BEYOND, FAST = 0.05, 0.75, 1.1, 1.5, 1.8, 3.0
STATIC_SYNC_S = 0.02
E2_CYCLES = 6
BLOCK = 3
UPDATES = 4
FROZEN_CYCLES = 20
SNAG_BLOCK = 5
#: The whole warm-up of 10 min in 9 cycles.
WARM_CYCLES, WARM_FROZEN, WARM_S = 9, 2, 75.0


@dataclass(frozen=True, slots=True)
class Scope:
    """How much is run.

    Attributes
    ----------
    frozen_cycles : cycles of C8 with learning off
    updates : of the learners that take three cycles for each
    each_cycles : cycles of the learners that update every cycle
    static_sync_s : sampling of the path that is run nearly at rest
    crossed : speeds at which stored functions are used without learning there
    stages : which stages, in this order
    skip : rows that are left out
    """

    frozen_cycles: int = FROZEN_CYCLES
    updates: int = UPDATES
    each_cycles: int = E2_CYCLES
    static_sync_s: float = STATIC_SYNC_S
    crossed: tuple[float, ...] = (BETWEEN, BEYOND)
    stages: tuple[str, ...] = ("static", "usual", "even", "speeds", "fast", "snag", "skew", "drift")
    skip: tuple[str, ...] = ()

    @property
    def learning(self) -> int:
        """Cycles of a learner by blocks, the one after the last update included."""
        return 1 + BLOCK * self.updates


@dataclass(frozen=True, slots=True, eq=False)
class Stock:
    """Seeds and their taught functions."""

    errors: list[PairErrors]
    nine: list[TransformFunction]
    seventeen: list[TransformFunction]

    def first(self, row: Embodiment, index: int) -> TransformFunction:
        """First function of a row for one seed."""
        return fixed_function() if row.first == "fixed" else self.nine[index]


ALL = Scope()


def figures(seeds: Sequence[int], scope: Scope = ALL) -> list[Row]:
    """All cycles of all rows.

    Parameters
    ----------
    seeds : sequence of int
    scope : Scope

    Returns
    -------
    list of dict
        Keys of `model_rows.cycle_rows`: row, seed, speed, cycle, force_n, moment_nm, rms_n, p99_n, share_above, ...
    """
    stock = take_stock(seeds)
    rows: list[Row] = []
    learned: dict[str, list[Run]] = {}
    for stage in scope.stages:
        rows += STAGES[stage](stock, scope, learned)
    return rows


def take_stock(seeds: Sequence[int]) -> Stock:
    """Teach every pair of arms at 9 and at 17 points."""
    on, errors = track(USUAL), [draw(seed, BASES) for seed in seeds]
    return Stock(errors, teach(on, errors, on.path.uniform(9)), teach(on, errors, on.path.uniform(17)))


def row_of(name: str) -> Embodiment:
    """A row with the gains that were tuned for the comparison with impedance alone."""
    return with_gains(EMBODIMENTS[name], stored())


def collect(on: Track, runs: list[Run], scope: Scope) -> list[Row]:
    """Run side by side what is not to be skipped; one dict per cycle."""
    runs[:] = [run for run in runs if run.name not in scope.skip]
    run_all(on, runs)
    return [row for run in runs for row in cycle_rows(run, on.path)]


def _static(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """Geometry alone: nearly standing still, no correction, no learning."""
    on = track(QUASI_STATIC, scope.static_sync_s)
    runs = []
    for index, errors in enumerate(stock.errors):
        firsts = {
            "A": fixed_function(),
            "C1": stock.nine[index],
            "C1 N=17": stock.seventeen[index],
            "O": exact(on, errors),
        }
        for label, first in firsts.items():
            runs.append(Run(label, errors, controller(on, row_of(label.split()[0]), first)))
    return collect(on, runs, scope)


def _usual(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """Override 1.5: the comparison, the noise floor, the learners; C8 stays on with learning frozen."""
    on = track(USUAL)
    runs = []
    learning = scope.learning
    for index, errors in enumerate(stock.errors):
        nine = stock.nine[index]
        for name in ("A", "B", "C1", "C1i"):
            runs.append(Run(name, errors, controller(on, row_of(name), stock.first(row_of(name), index))))
        for name in ("C2m", "C2c", "C6"):
            runs.append(Run(name, errors, controller(on, row_of(name), nine), scope.each_cycles))
        runs.append(Run("C2m no lag", without_lag(errors), controller(on, row_of("C2m"), nine), scope.each_cycles))
        runs.append(Run("floor", ideal(errors), controller(on, row_of("B"), fixed_function())))
        runs.append(Run("O", errors, controller(on, row_of("O"), exact(on, errors))))
        for name in ("C7", "C8r"):
            runs.append(Run(name, errors, controller(on, row_of(name), nine), learning))
        frozen = learning - 1 + scope.frozen_cycles
        runs.append(Run("C8", errors, controller(on, row_of("C8"), nine), frozen, freeze_after=learning - 1))
    rows = collect(on, runs, scope)
    for run in runs:
        learned.setdefault(run.name, []).append(run)
    return rows


def _even(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """C8u: as many learning points as C8 ended with, evenly spread."""
    on = track(USUAL)
    runs = []
    for index, errors in enumerate(stock.errors):
        count = len(learned["C8"][index].controller.function)
        first = teach(on, [errors], on.path.uniform(count))[0]
        runs.append(Run("C8u", errors, controller(on, row_of("C8u"), first), scope.learning))
    return collect(on, runs, scope)


def _speeds(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """E3: functions learned at .75 and 1.5, used at 1.1 and 1.8 without any learning there."""
    on = track(SLOW)
    slow = [
        Run("C2c", errors, controller(on, row_of("C2c"), stock.nine[index]), scope.each_cycles)
        for index, errors in enumerate(stock.errors)
    ]
    rows = collect(on, slow, scope)
    fast = learned["C2c"]
    for speed in scope.crossed:
        on = track(speed)
        runs = []
        for index, errors in enumerate(stock.errors):
            known = {
                0.0: stock.nine[index],
                SLOW: slow[index].controller.function,
                USUAL: fast[index].controller.function,
            }
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ExtrapolationWarning)
                table = SpeedTable(known).at(speed)
            firsts = {"C1i": known[0.0], "C3": table, "C3 nearest": known[USUAL]}
            for label, first in firsts.items():
                runs.append(Run(label, errors, controller(on, row_of(label.split()[0]), first)))
                bare = replace(row_of(label.split()[0]), corrects="none")
                runs.append(Run(f"{label}, no impedance", errors, controller(on, bare, first)))
        rows += collect(on, runs, scope)
    return rows


def _fast(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """Override 3: where impedance alone does not suffice."""
    on = track(FAST)
    runs = []
    printed = {"lead_s": 0.0, "smooth_s": 0.0}
    literal = replace(row_of("C8"), learning=replace(_rule("C8"), **printed))
    each = replace(row_of("C2c"), learning=replace(_rule("C2c"), **printed))
    learning = scope.learning
    for index, errors in enumerate(stock.errors):
        for name in ("A", "B", "C1i"):
            runs.append(Run(name, errors, controller(on, row_of(name), stock.first(row_of(name), index))))
        for label, row, cycles in (
            ("C2m", row_of("C2m"), scope.each_cycles),
            ("C2c", row_of("C2c"), scope.each_cycles),
            ("C2c no lead", each, scope.each_cycles),
            ("C7", row_of("C7"), learning),
            ("C8", row_of("C8"), learning - 1 + scope.frozen_cycles),
            ("C8 no lead", literal, learning),
        ):
            freeze = learning - 1 if label == "C8" else 10**6
            runs.append(Run(label, errors, controller(on, row, stock.nine[index]), cycles, freeze_after=freeze))
        runs.append(Run("floor", ideal(errors), controller(on, row_of("B"), fixed_function())))
    rows = collect(on, runs, scope)
    learned["C8 fast"] = [run for run in runs if run.name == "C8"]
    return rows


def _snag(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """A cable pulls arm 2 for one cycle: what the function makes of it by mean and by median, and with learning off."""
    on = track(USUAL)
    rows: list[Row] = []
    runs: dict[tuple[str, int], list[Run]] = {}
    for kind in ("mean", "median"):
        row = replace(row_of("C7"), learning=replace(_rule("C7"), cycles=SNAG_BLOCK, kind=kind))
        for snag in (0, 3):
            runs[kind, snag] = [
                Run(f"C7 {kind}", errors, controller(on, row, stock.nine[index]), SNAG_BLOCK, snag_cycle=snag)
                for index, errors in enumerate(stock.errors)
            ]
    off = [
        Run("C7 off", errors, controller(on, row_of("C7"), stock.nine[index]), BLOCK, 0, snag_cycle=2)
        for index, errors in enumerate(stock.errors)
    ]
    run_all(on, [run for group in runs.values() for run in group] + off)
    for index, errors in enumerate(stock.errors):
        moved = {kind: _difference(runs[kind, 0][index], runs[kind, 3][index]) for kind in ("mean", "median")}
        same = np.array_equal(off[index].controller.function.knots, stock.nine[index].knots)
        rows.append(
            {"tier": "numpy", "row": "snag", "seed": errors.seed, "speed": USUAL, "mean_m": moved["mean"]}
            | {"median_m": moved["median"], "ratio": moved["median"] / moved["mean"], "frozen_identical": float(same)}
        )
    return rows


def _difference(one: Run, two: Run) -> float:
    """Largest distance [m] between the knots of two runs' functions."""
    first, second = one.controller.function, two.controller.function
    return float(np.linalg.norm(first.position_m - second.position_m, axis=1).max())


def _skew(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """The slave's SYNC comes late: constantly .5 ms, or anew each time between 0 and 1 ms."""
    on = track(USUAL)
    runs = []
    for index, errors in enumerate(stock.errors):
        for label, skew_s, jitter_s in (("C8 skew .5 ms", 0.5e-3, None), ("C8 jitter 1 ms", 0.0, 1e-3)):
            late = replace(errors, skew_s=skew_s)
            run = Run(label, late, controller(on, row_of("C8"), stock.nine[index]), scope.learning, jitter_s=jitter_s)
            runs.append(run)
    return collect(on, runs, scope)


def _drift(stock: Stock, scope: Scope, learned: dict[str, list[Run]]) -> list[Row]:
    """Both upper arms warm up while the pair runs: a function that is learned on, and one that is frozen early."""
    on = track(USUAL)
    runs = []
    for index, errors in enumerate(stock.errors):
        for label, freeze in (("C2c warming", 10**6), ("C2c warming, frozen", WARM_FROZEN)):
            under_test = controller(on, row_of("C2c"), stock.nine[index])
            runs.append(Run(label, errors, under_test, WARM_CYCLES, freeze_after=freeze, warming_s=WARM_S))
    return collect(on, runs, scope)


def _rule(name: str) -> LearningRule:
    rule = EMBODIMENTS[name].learning
    assert rule is not None
    return rule


STAGES: dict[str, Callable[[Stock, Scope, dict[str, list[Run]]], list[Row]]] = {
    "static": _static,
    "usual": _usual,
    "even": _even,
    "speeds": _speeds,
    "fast": _fast,
    "snag": _snag,
    "skew": _skew,
    "drift": _drift,
}
