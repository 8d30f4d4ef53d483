"""What the peers get: rows of the unloaded and the loaded run, at rest as half-sums of both approach directions."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.moving.cells import PERIODS
from benchmarks.naming.cells import Cell
from gateway.model.visits import pair_visits

Floats = NDArray[np.float64]

#: Labels of the unloaded and of the loaded run.
BARE, TOOL = "none", "tool"

#: Samples of a period of which one is used.
THINNED = 4


@dataclass(frozen=True, slots=True)
class Run:
    """Times (n,) and rows (n, N) of one run; `tau` is the torque at the gear output."""

    time_s: Floats
    q: Floats
    qd: Floats
    qdd: Floats
    tau: Floats


def runs_of(cell: Cell, moving: bool) -> dict[str, Run]:
    """Return both runs by label; the half-sums are behind gears of the stated efficiency and free of friction."""
    return {label: _moving_run(cell, label) if moving else _rest_run(cell, label) for label in (BARE, TOOL)}


def _moving_run(cell: Cell, label: str) -> Run:
    table = cell.table
    rows = np.asarray(table.load) == label
    signals = (table.time_s, table.q_rad, table.qd_rad_s, table.qdd_rad_s2, table.tau_nm)
    return Run(*(values[rows] for values in signals))


def _rest_run(cell: Cell, label: str) -> Run:
    visits = pair_visits(cell.table, cell.efficiency)
    rows = (np.asarray(visits.load) == label) & np.isfinite(visits.sum_nm).all(axis=1)
    q, tau = visits.q_rad[rows], visits.sum_nm[rows]
    return Run(visits.time_s[rows], q, np.zeros_like(q), np.zeros_like(q), tau)


def thinned(run: Run) -> Run:
    """Return every fourth sample of the mean over the periods; a filter would blur where friction reverses."""
    signals = (run.time_s, run.q, run.qd, run.qdd, run.tau)
    return Run(*(values.reshape(PERIODS, -1, *values.shape[1:]).mean(axis=0)[::THINNED] for values in signals))


@contextlib.contextmanager
def quiet() -> Generator[None]:
    """Suppress what a peer prints, logs and warns."""
    before = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
