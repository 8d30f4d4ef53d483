"""Cells of the benchmark: tables and statements that a method may read, and the truth that only the scorer reads.

A cell is a folder with `robot.urdf` (links as the owner states them), `table.csv` (measured table, unloaded and with
the load `tool`) and `statements.json`. The arms come from `benchmarks.nature`, which shares no formula with the
gateway.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.mechanisms import MECHANISMS
from benchmarks.nature.arm import Stated
from benchmarks.nature.moving_arm import StatedMoving
from benchmarks.nature.nature_cell import KINDS, NatureCell, draw_cell, drawn_kind
from gateway.data.table import Table, read_csv, write_csv
from tests.support.rigs.tables import simulated_table

Floats = NDArray[np.float64]

#: First seed of the cells for development, and of the test cells, which are run once.
FIRST = {"dev": 50_000, "test": 60_000}
#: Every fourth cell has no missing effect.
CLEAN_EVERY = 4
TRUTH = "truth.jsonl"


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell as a method reads it.

    Attributes
    ----------
    name : folder name
    urdf : robot model as stated
    table : rows of all visits
    link_std : relative standard deviation of link masses and first moments
    gain_std, efficiency : (N,) relative standard deviation of the torque constants, stated gear efficiencies
    gear_ratio : (N,) or None
    """

    name: str
    urdf: str
    table: Table
    link_std: float
    gain_std: tuple[float, ...]
    efficiency: tuple[float, ...]
    gear_ratio: tuple[float, ...] | None


def drawn(seed: int) -> NatureCell:
    """Draw the cell of a seed; wiring mistakes are left out, because regressions have no column for them."""
    if seed % CLEAN_EVERY == 0:
        return draw_cell(seed, "base")
    condition, kind = drawn_kind(seed)
    return draw_cell(seed, condition, "one" if kind == "wiring" else kind)


def write_cells(
    seeds: Sequence[int], folder: Path, truth_folder: Path, draw: Callable[[int], NatureCell] = drawn
) -> None:
    """Write the cells of the seeds to `folder`, and their truth to a file in `truth_folder`."""
    lines = []
    for number, seed in enumerate(seeds):
        cell, name = draw(seed), f"cell{number:04}"
        place = folder / name
        write_place(place, cell.stated, cell.stated.gear_ratio)
        write_csv(simulated_table(cell.measure(cell.visits)[0], name), place / "table.csv")
        lines.append(json.dumps({"cell": name, "seed": seed, **_truth(cell)}))
    truth_folder.mkdir(parents=True, exist_ok=True)
    (truth_folder / TRUTH).write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_cells(folder: Path) -> Iterator[Cell]:
    """Yield the cells of a folder in the order of their names."""
    for place in sorted(path for path in folder.iterdir() if (path / "table.csv").is_file()):
        stated: dict[str, Any] = json.loads((place / "statements.json").read_text(encoding="utf-8"))
        ratio = stated["gear_ratio"]
        yield Cell(
            place.name,
            (place / "robot.urdf").read_text(encoding="utf-8"),
            read_csv(place / "table.csv", None),
            stated["link_std"],
            tuple(stated["gain_std"]),
            tuple(stated["efficiency"]),
            None if ratio is None else tuple(ratio),
        )


def write_place(place: Path, stated: Stated | StatedMoving, gear_ratio: Floats | None) -> None:
    """Write the robot model and the statements of a cell to its folder."""
    place.mkdir(parents=True, exist_ok=True)
    (place / "robot.urdf").write_text(stated.urdf, encoding="utf-8")
    statements = {
        "link_std": float(stated.link_std),
        "gain_std": [float(value) for value in stated.gain_std],
        "efficiency": [float(value) for value in stated.efficiency],
        "gear_ratio": None if gear_ratio is None else [float(value) for value in gear_ratio],
    }
    (place / "statements.json").write_text(json.dumps(statements, indent=1) + "\n", encoding="utf-8")


def _truth(cell: NatureCell) -> dict[str, Any]:
    effects = [
        {"mechanism": each.mechanism, "names": MECHANISMS[each.mechanism], "joints": each.joints, "strength": strength}
        for each, strength in zip(cell.effects, cell.strengths, strict=True)
    ]
    tool = cell.arm.tool
    load = [float(value) for value in np.array([tool.mass_kg, *tool.com_m])]
    kind = cell.kind if cell.kind in KINDS else "clean"
    return {"kind": kind, "effects": effects, "load": load, "misstated": bool(cell.stated.misstated)}
