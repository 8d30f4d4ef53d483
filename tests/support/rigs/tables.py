"""Measured tables for the tests: from columns that a test makes up, and from those of the simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gateway.data.rows import MOVING, Table


def make_table(
    load: Sequence[str] | np.ndarray, pose: ArrayLike, q: ArrayLike, tau: ArrayLike, **extra_columns: Any
) -> Table:
    """Build a table from rows; pose -1 is a moving row.

    Other columns by name: `run`, `time`, `qd`, `qdd`, `direction`, `std`, `count`, `q2nd`, `temperature`, `motor`,
    `extra` and `file`. A column left out is unknown (at rest). One value holds for all rows and axes.
    """
    n, axes = len(load), np.shape(q)[1]

    def by_axis(value: ArrayLike, kind: type = float) -> np.ndarray:
        values = np.asarray(value)
        return np.broadcast_to(values[:, None] if values.shape == (n,) else values, (n, axes)).astype(kind)

    return Table(
        file=(extra_columns.get("file", "made.csv"),) * n,
        line=np.arange(2, n + 2),
        run=np.asarray(extra_columns.get("run", ["r"] * n)),
        load=np.asarray(load),
        pose=np.asarray(pose),
        time_s=np.asarray(extra_columns.get("time", np.full(n, np.nan)), dtype=float),
        q_rad=np.asarray(q, dtype=float),
        qd_rad_s=by_axis(extra_columns.get("qd", 0.0)),
        qdd_rad_s2=by_axis(extra_columns.get("qdd", 0.0)),
        moving=np.asarray(pose) == MOVING,
        direction=by_axis(extra_columns.get("direction", 0), np.int8),
        tau_nm=by_axis(tau),
        tau_std_nm=by_axis(extra_columns.get("std", np.nan)),
        count=np.broadcast_to(extra_columns.get("count", 1), n).astype(int),
        q2nd_rad=by_axis(extra_columns.get("q2nd", np.nan)),
        temperature_c=by_axis(extra_columns.get("temperature", np.nan)),
        motor_torque_nm=by_axis(extra_columns.get("motor", np.nan)),
        extra=dict(extra_columns.get("extra", {})),
    )


def simulated_table(columns: Mapping[str, Any], run: str = "bench") -> Table:
    """The columns of `sim.offline.measure`: rest visits of one run."""
    return make_table(
        columns["load"],
        columns["pose"].astype(int),
        columns["q_rad"],
        columns["tau_nm"],
        file=run,
        run=[run] * len(columns["pose"]),
        time=columns["time_s"],
        direction=columns["dir"],
        std=columns["tau_std_nm"],
        count=columns["n"],
        q2nd=columns["q2nd_rad"],
        temperature=columns["temp_c"],
    )
