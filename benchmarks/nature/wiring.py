"""Mistakes of commissioning: a sign, two cables exchanged, rms taken for peak. They change the table, not the arm."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows
from benchmarks.nature.springs import Build, Maker

Columns = dict[str, NDArray[Any]]


def turned_sign(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """The torque of one axis has the wrong sign."""
    axis = int(rng.integers(1, 6))

    def wired(columns: Columns) -> Columns:
        tau = columns["tau_nm"].copy()
        tau[:, axis] *= -1.0
        return columns | {"tau_nm": tau}

    return lambda size: Mechanism("turned_sign", (axis + 1,), size, wired=wired), (1.0, 1.0)


def exchanged_cables(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """Two drives are bolted to each other's joints: positions and torques are in each other's columns."""
    first, second = sorted(int(axis) for axis in rng.choice(np.arange(1, 6), 2, replace=False))

    def wired(columns: Columns) -> Columns:
        order = np.arange(6)
        order[[first, second]] = second, first
        return columns | {
            name: values[:, order] for name, values in columns.items() if np.ndim(values) == 2 and name != "dir"
        }

    return lambda size: Mechanism("exchanged_cables", (first + 1, second + 1), size, wired=wired), (1.0, 1.0)


def rms_for_peak(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """The drive of one axis reports peak where rms is expected, or the other way round."""
    axis, factor = int(rng.integers(1, 6)), float(rng.choice([np.sqrt(2.0), np.sqrt(0.5)]))

    def wired(columns: Columns) -> Columns:
        tau, std = columns["tau_nm"].copy(), columns["tau_std_nm"].copy()
        tau[:, axis] *= factor
        std[:, axis] *= factor
        return columns | {"tau_nm": tau, "tau_std_nm": std}

    return lambda size: Mechanism("rms_for_peak", (axis + 1,), size, wired=wired), (1.0, 1.0)


WIRING: dict[str, Maker] = {
    "turned_sign": turned_sign,
    "exchanged_cables": exchanged_cables,
    "rms_for_peak": rms_for_peak,
}
