"""A path of its own for every seed: the intervals of the force shall hold elsewhere than where settings were chosen."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.pair.bus_rig import CELL

Array = NDArray[np.float64]

#: Most that a path bends away from the example's: m along x, y, z, then rad of roll, pitch, yaw.
MOST = np.array([0.04, 0.04, 0.04, 0.1, 0.1, 0.1])
#: Of seeds that also draw arms: one number more, so that a path does not repeat what an arm was drawn from.
STREAM = 7


def drawn_cell(folder: Path, seed: int, refused: int = 0) -> Path:
    """The example with a path of this seed, the one that it draws after so many refused, in a folder that is there."""
    for source in CELL.parent.iterdir():
        if source.is_file():
            shutil.copy(source, folder)
    path = folder / "path.csv"
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    stated, rng = np.array(rows, dtype=float), np.random.default_rng([seed, STREAM])
    poses = [bent(stated, rng) for _ in range(refused + 1)][-1]
    text = [",".join(head), *(",".join(f"{value:.10f}" for value in row) for row in poses)]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    return folder / CELL.name


def bent(rows: Array, rng: np.random.Generator) -> Array:
    """Rows (M, 7) of a path [s, m, rad], bent at random; begun where it began, and at rest where it was at rest.

    By the share of the path that is done, so that it stays smooth in time: half a wave, a whole wave, and another end.
    """
    step = np.linalg.norm(np.diff(rows[:, 1:4], axis=0), axis=1)
    done = np.concatenate([[0.0], np.cumsum(step)])[:, None] / step.sum()
    half, full_turn, end = rng.uniform(-1.0, 1.0, (3, len(MOST))) * MOST
    off = half * np.sin(np.pi * done) + 0.5 * full_turn * np.sin(2.0 * np.pi * done) + end * done
    return np.column_stack([rows[:, 0], rows[:, 1:] + off])
