"""Cells: an arm under a condition, its visits, and mechanisms beyond the nuisance effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm, Stated, draw_arm
from benchmarks.nature.assembly import ASSEMBLY
from benchmarks.nature.drives import DRIVES
from benchmarks.nature.effect import Mechanism, TableRows, rows_of
from benchmarks.nature.levels import CONDITIONS, levels_of
from benchmarks.nature.measuring import OutlierVisit, measure
from benchmarks.nature.springs import SPRINGS, Maker
from benchmarks.nature.strength import Absorbing, absorbing, strength
from benchmarks.nature.unmodelled import UNMODELLED
from benchmarks.nature.wiring import WIRING
from sim.draw import choose_poses
from sim.offline import PlannedVisit

Array = NDArray[np.float64]

ORDINARY = "ordinary"
#: Kinds of cells with an effect beyond the nuisances, and their shares.
KINDS = {"one": 0.55, "several": 0.25, "strange": 0.12, "wiring": 0.08}
NAMED: dict[str, Maker] = SPRINGS | ASSEMBLY | DRIVES
LEAST_STRENGTH, MOST_STRENGTH = 1.5, 20.0
VISIT_S, CHANGE_S, REPEATED = 28.0, 240.0, 4
#: Number of arms and sizes tried until a mechanism is near the drawn strength.
TRIES, STEPS = 4, 5
#: No mechanism beside another one that acts on the same joint in nearly the same way.
CLASH = ({"gas_balancer", "coil_balancer"}, {"offset_sensor", "one_way_drag"}, {"shifted_zero", "stiffening_gear"})


@dataclass(frozen=True, slots=True)
class NatureCell:
    """One cell.

    Attributes
    ----------
    seed, condition, kind : what it was drawn from; `kind` is one of `ordinary` (no mechanism), `one`, `several`,
    `strange` (unmodelled), `wiring`
    arm, stated : the real arm, and the statements of its owner
    visits : of the first recording, in order of time
    effects, strengths : mechanisms beyond the nuisance effects, and their strength in these visits
    """

    seed: int
    condition: str
    kind: str
    arm: NatureArm
    stated: Stated
    visits: tuple[PlannedVisit, ...]
    effects: tuple[Mechanism, ...]
    strengths: tuple[float, ...]

    def measure(
        self, visits: Sequence[PlannedVisit], stream: int = 0
    ) -> tuple[dict[str, NDArray[Any]], tuple[OutlierVisit, ...]]:
        """Columns of a measured table, and which visits went wrong; `stream` makes later recordings differ."""
        rng = np.random.default_rng([self.seed, CONDITIONS.index(self.condition), 7, stream])
        return measure(self.arm, visits, self.effects, rng)

    def poses(self, count: int, stream: int) -> Array:
        """Return further poses (count, 6) that are informative about load and links."""
        rng = np.random.default_rng([self.seed, CONDITIONS.index(self.condition), 9, stream])
        return choose_poses(self.arm.chain, self.arm.floor_nm, self.arm.links_std, count, rng)


def draw_cell(seed: int, condition: str, kind: str = ORDINARY) -> NatureCell:
    """Cell of a seed under a condition.

    Raises
    ------
    KeyError
        No such condition.
    """
    kinds = (ORDINARY, *KINDS)
    rng = np.random.default_rng([seed, CONDITIONS.index(condition), kinds.index(kind), 41])
    arm, stated = draw_arm(levels_of(condition), rng)
    poses = choose_poses(arm.chain, arm.floor_nm, arm.links_std, int(rng.integers(10, 15)), rng)
    visits = _visits(poses, rng)
    rows, taken = rows_of(visits), absorbing(arm, visits)
    effects, strengths = [], []
    for maker in _mechanisms(kind, rng):
        effect, size = scaled(arm, rows, maker, taken, rng)
        effects.append(effect)
        strengths.append(size)
    return NatureCell(seed, condition, kind, arm, stated, visits, tuple(effects), tuple(strengths))


def draw_effect_cell(seed: int) -> NatureCell:
    """Cell with an effect beyond the nuisances."""
    condition, kind = drawn_kind(seed)
    return draw_cell(seed, condition, kind)


def drawn_kind(seed: int) -> tuple[str, str]:
    """Condition and kind of a cell with an effect beyond the nuisances; every second has all conditions together."""
    rng = np.random.default_rng([seed, 43])
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    condition = "all" if rng.random() < 0.5 else str(rng.choice(CONDITIONS[:-1]))
    return condition, kind


def _mechanisms(kind: str, rng: np.random.Generator) -> list[Maker]:
    if kind == ORDINARY:
        return []
    table = {"strange": UNMODELLED, "wiring": WIRING}.get(kind, NAMED)
    names = [str(name) for name in rng.permutation(sorted(table))]
    wanted = int(rng.integers(2, 4)) if kind == "several" else 1
    chosen: list[str] = []
    for name in names:
        if len(chosen) < wanted and not any({name, other} <= pair for other in chosen for pair in CLASH):
            chosen.append(name)
    return [table[name] for name in chosen]


def scaled(
    arm: NatureArm, rows: TableRows, maker: Maker, taken: Absorbing, rng: np.random.Generator
) -> tuple[Mechanism, float]:
    """An effect near a strength of 1.5 to 20, every factor as likely, as far as its physical limits let it."""
    wanted = float(np.exp(rng.uniform(np.log(LEAST_STRENGTH), np.log(MOST_STRENGTH))))
    best: tuple[Mechanism, float] | None = None
    for _ in range(TRIES):
        build, (least, most) = maker(arm, rows, rng)
        if least == most:
            return build(most), float("inf")
        size = max(least, 0.2 * most)
        effect = build(size)
        reached = strength(arm, rows, effect, taken)
        for _ in range(STEPS):
            if abs(np.log(max(reached, 1e-9) / wanted)) < 0.05:
                break
            size = float(np.clip(size * wanted / max(reached, 1e-9), least, most))
            effect = build(size)
            reached = strength(arm, rows, effect, taken)
        if best is None or abs(np.log(max(reached, 1e-9) / wanted)) < abs(np.log(max(best[1], 1e-9) / wanted)):
            best = effect, reached
        if reached > 0.9 * wanted:
            break
    if best is None:
        raise ValueError("no effect was drawn")
    return best


def _visits(poses: Array, rng: np.random.Generator) -> tuple[PlannedVisit, ...]:
    """Every pose bare and loaded, in one of the orders that people keep."""
    all_ = np.arange(len(poses))
    half, few = len(poses) // 2, all_[:REPEATED]
    orders = [
        [("none", all_), ("tool", all_)],
        [("tool", all_), ("none", all_)],
        [("none", all_), ("tool", all_), ("tool", few), ("none", few)],
        [("none", all_[:half]), ("tool", all_), ("none", all_[half:])],
        [("tool", all_[:half]), ("none", all_), ("tool", all_[half:])],
    ]
    visits: list[PlannedVisit] = []
    now_s, before = float(rng.uniform(0.0, 300.0)), ""
    for load, numbers in orders[int(rng.integers(len(orders)))]:
        now_s += CHANGE_S * float(rng.uniform(0.5, 2.0)) * (before not in ("", load))
        for number in numbers:
            visits.append(PlannedVisit(int(number), load, now_s, poses[number]))
            now_s += VISIT_S
        before = load
    return tuple(visits)
