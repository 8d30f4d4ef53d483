"""Repeated periods of a motion: which samples repeat which, and the torque noise between the periods.

Two periods of one excitation under one load have the same motion, arm and model error; they differ by noise alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table, numbered

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Columns of a table that say which excitation a row belongs to (a number), which period, and the time in it [s].
EXCITATION, PERIOD, PHASE_S = "x_excitation", "x_period", "x_phase_s"
#: Column with the frequency up to which the motion of a row was kept [Hz]; the torque has all frequencies.
MOTION_HZ = "x_motion_hz"
#: Minimum number of periods for a noise estimate.
FEWEST = 2


def repeats(table: Table) -> Mask:
    """Return a mask (n,) of the samples that belong to a period of an excitation."""
    columns = [table.extra.get(name, np.full(len(table), np.nan)) for name in (EXCITATION, PERIOD, PHASE_S)]
    return np.asarray(table.moving & np.isfinite(columns).all(axis=0))


def excitation_runs(table: Table) -> Ints:
    """Return the number (n,) of the excitation and load of each sample, within one file; -1 without excitation."""
    out, rows = np.full(len(table), -1), np.flatnonzero(repeats(table))
    if len(rows):
        file = [table.file[row] for row in rows]
        out[rows] = numbered(file, table.load[rows], table.extra[EXCITATION][rows])[1]
    return out


def uninterrupted(table: Table) -> Ints:
    """Return the number (n,) of the part of a recording that each sample is of: a load, and a period of its excitation.

    A recording that was continued later begins its time again, so times are in order within such a part alone.
    """
    none = np.full(len(table), np.nan)
    marks = (np.nan_to_num(table.extra.get(name, none), nan=-1.0) for name in (EXCITATION, PERIOD))
    return numbered(table.file, table.run, table.load, *marks)[1]


def noise_between_periods(table: Table, turns: Mask) -> Floats:
    """Return the standard deviation (N,) [Nm] of one torque sample from differences between periods; NaN without
    repeats.

    Uses the mean square deviation of each period from the mean of all periods, then the median over the periods, so
    that a disturbed period has no influence; pooled over excitations and loads.

    Parameters
    ----------
    table : Table
    turns : bool array of shape (n, N)
        Where an axis moves. The torque of an axis at rest varies within its friction from period to period.
    """
    squares, counts = np.zeros((2, table.axes))
    for rows in _stacks(table):
        torque, there = table.tau_nm[rows], turns[rows].all(axis=0)
        spread = np.where(there, torque - torque.mean(axis=0), 0.0)
        instants = there.sum(axis=0)
        each = (spread**2).sum(axis=1) / np.maximum(instants, 1) * len(rows) / (len(rows) - 1)
        squares += np.nan_to_num(np.median(each, axis=0) * instants)
        counts += np.where(np.isfinite(each).all(axis=0), instants, 0)
    return np.sqrt(np.divide(squares, counts, out=np.full(table.axes, np.nan), where=counts > 0))


def _stacks(table: Table) -> Iterator[Ints]:
    """Yield the sample indices (periods, instants) of every excitation and load with at least two periods."""
    runs = excitation_runs(table)
    for number in range(runs.max(initial=-1) + 1):
        mine = np.flatnonzero(runs == number)
        period = table.extra[PERIOD][mine]
        parts = [mine[period == value] for value in np.unique(period)]
        parts = [part[np.argsort(table.extra[PHASE_S][part], kind="stable")] for part in parts]
        length = int(np.median([len(part) for part in parts]))
        complete = [part for part in parts if len(part) == length]
        if len(complete) >= FEWEST:
            yield np.array(complete)
