"""Report of the benchmark of different arms on its runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.pair.bus_rig import inline_rig
from benchmarks.pair.bus_rows import USUAL, Bench
from benchmarks.pair.unequal import CELLS, FOLDER, ROWS, cycles_until_inside, figures_of_cell
from gateway.pair.transform_function import constant_function


def run(row: str, seed: int, forces_n: list[float], held: float) -> dict[str, Any]:
    inside = cycles_until_inside(forces_n, 40.0)
    each = {"cell": "c", "row": row, "seed": seed, "limit_n": 40.0, "force_n": forces_n}
    return {**each, "inside_after": inside, "held": [held] * 5 + [held - 0.1]}


def test_what_is_missed_is_said() -> None:
    """A seed that ends above the limit, and intervals that hold too little, are both missed; the worst seed counts."""
    plain = [run(row, seed, [60.0 + seed], 0.8) for row in ("A", "B", "C1i") for seed in (0, 1)]
    figures = figures_of_cell("c", [*plain, run("C8", 0, [50.0, 20.0], 0.8), run("C8", 1, [50.0, 41.0], 0.8)])
    assert figures["c: row B, true force"]["value"] == 61.0
    assert (figures["c: C8, last cycle"]["value"], figures["c: C8, last cycle"]["met"]) == (41.0, False)
    assert figures["c: C8, cycles before it stays inside"]["value"] == ROWS["C8"]
    assert "1 never" in figures["c: C8, cycles before it stays inside"]["unit"]
    assert figures["c: truth held by intervals"]["met"] is False
    assert figures["c: truth held by intervals"]["value"] == pytest.approx(100.0 * (0.8 - 0.1 / 6.0))
    assert figures["c: truth held, worst run and component"]["value"] == pytest.approx(70.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS[1:])
def test_arms_without_errors_stay_below_the_limit_and_report_their_force(name: str) -> None:
    """Over PyBullet and CAN by the relation of the grasps alone: what is left are gears that wind up, and friction."""
    with inline_rig(None, cell_file=FOLDER / f"{name}.toml") as rig:
        bench = Bench(rig, constant_function(rig.cell.nominal_relation), 0)
        bench.run("B", bench.row_of("B"), USUAL)
        assert rig.world.joints == sum(arm.axes for arm in rig.cell.arms)
    (row,) = bench.rows
    assert row["complete"]
    assert row["force_n"] < 40.0
    assert np.mean(row["held"]) > 0.9
