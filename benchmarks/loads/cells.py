"""Cells of the benchmark: arms without a missing effect, at rest and in motion.

Both kinds come from `benchmarks.nature`, which shares no formula with the gateway. The folders have the files of a
cell of `benchmarks.naming` and are read by its `read_cells`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.moving.cells import MovingCell
from benchmarks.moving.cells import draw_cell as draw_moving_cell
from benchmarks.moving.scores import drawn_truth, load_truth
from benchmarks.naming.cells import TRUTH, write_cells, write_place
from benchmarks.nature.nature_cell import NatureCell
from benchmarks.nature.nature_cell import draw_cell as draw_rest_cell
from gateway.data.table import write_csv

#: First seed of the cells for development, and of the test cells, which are run once.
FIRST: Final = {"development": 70_000, "test": 75_000}
REST, MOTION = "rest", "motion"
#: True parameters of the axes that are compared.
AXIS_NAMES: Final = ("coulomb_nm", "viscous_nm_s_rad", "rotor_inertia_kg_m2", "gain")


def drawn_at_rest(seed: int) -> NatureCell:
    """Draw an arm with nuisance parameters only."""
    return draw_rest_cell(seed, "base")


def drawn_in_motion(seed: int) -> MovingCell:
    """Draw an arm and its motion, with torque constants as stated."""
    return draw_moving_cell(seed, "stated")


def write_rest_cells(seeds: Sequence[int], folder: Path) -> None:
    """Write cells of rest poses to `folder`/cells and their truth to `folder`/truth."""
    write_cells(seeds, folder / "cells", folder / "truth", drawn_at_rest)


def write_moving_cells(seeds: Sequence[int], folder: Path) -> None:
    """Write cells of moving runs to `folder`/cells and their truth to `folder`/truth."""
    lines = []
    for number, seed in enumerate(seeds):
        cell, name = drawn_in_motion(seed), f"cell{number:04}"
        place = folder / "cells" / name
        write_place(place, cell.stated, None)
        write_csv(cell.table(), place / "table.csv")
        axes = drawn_truth(cell.arm, cell.motion, cell.start_s, {}).axes
        values = {key: axes.get(key, cell.arm.gain) for key in AXIS_NAMES}
        entry = {
            "cell": name,
            "seed": seed,
            "kind": "clean",
            "load": load_truth(cell.arm.tool).tolist(),
            "axes": {key: value.tolist() for key, value in values.items()},
        }
        lines.append(json.dumps(entry))
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    (folder / "truth" / TRUTH).write_text("\n".join(lines) + "\n", encoding="utf-8")
