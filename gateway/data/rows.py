"""Table of measured samples as arrays: one per rest-pose visit or per instant of a moving run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from gateway.errors import InputError

MOVING = -1
COMPARED = (
    "q_rad",
    "qd_rad_s",
    "qdd_rad_s2",
    "tau_nm",
    "motor_torque_nm",
    "tau_std_nm",
    "count",
    "q2nd_rad",
    "temperature_c",
)


@dataclass(frozen=True, slots=True)
class Table:
    """Measured samples; joints count from 0 along the second axis.

    Attributes
    ----------
    file : tuple of str, one per row
        File of the sample.
    line : int array of shape (n,)
        Line in the CSV file, or visit number in the recording.
    run, load : str arrays of shape (n,)
        Recording of the sample; label of the load on the flange (`none` = unloaded arm).
    pose : int array of shape (n,)
        Number of the rest pose; -1 in moving rows.
    time_s : array of shape (n,)
        NaN where unknown.
    q_rad, qd_rad_s, qdd_rad_s2 : arrays of shape (n, N)
        Joint motion in the convention of the robot model; derivatives are zero at rest.
    moving : bool array of shape (n,)
    direction : int8 array of shape (n, N)
        Sign of each joint's last motion before it came to rest; 0 = unknown.
    tau_nm : array of shape (n, N)
        Joint-side actuator torque: ratio, sign and coupling applied, efficiency not; NaN = axis not measured.
    tau_std_nm : array of shape (n, N)
        Standard deviation of the averaged samples; NaN = unknown.
    count : int array of shape (n,)
        Samples averaged; 1 if unknown.
    q2nd_rad, temperature_c : arrays of shape (n, N)
        Secondary encoder and motor or drive temperature; NaN where absent.
    motor_torque_nm : array of shape (n, N)
        Motor-side torque where the source gave torque or current of the motor; NaN otherwise.
    extra : dict of str to array of shape (n,)
        Columns whose name starts with `x_`.
    """

    file: tuple[str, ...]
    line: np.ndarray
    run: np.ndarray
    load: np.ndarray
    pose: np.ndarray
    time_s: np.ndarray
    q_rad: np.ndarray
    qd_rad_s: np.ndarray
    qdd_rad_s2: np.ndarray
    moving: np.ndarray
    direction: np.ndarray
    tau_nm: np.ndarray
    tau_std_nm: np.ndarray
    count: np.ndarray
    q2nd_rad: np.ndarray
    temperature_c: np.ndarray
    motor_torque_nm: np.ndarray
    extra: dict[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.file)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.q_rad.shape[1]

    def with_torque_scaled(self, scale: np.ndarray) -> Table:
        """Return a copy with the torque of each axis multiplied by `scale` (N,)."""
        scaled = ("tau_nm", "tau_std_nm", "motor_torque_nm")
        return replace(self, **{name: getattr(self, name) * scale for name in scaled})

    def take(self, rows: np.ndarray) -> Table:
        """Return the selected samples as a new table.

        Parameters
        ----------
        rows : bool mask of shape (n,) or int indices
        """
        index = np.flatnonzero(rows) if np.asarray(rows).dtype == bool else np.asarray(rows, dtype=int)
        chosen: dict[str, Any] = {
            item.name: getattr(self, item.name)[index] for item in fields(self) if item.name not in ("file", "extra")
        }
        chosen["file"] = tuple(self.file[i] for i in index)
        chosen["extra"] = {name: values[index] for name, values in self.extra.items()}
        return Table(**chosen)

    def where(self, row: int) -> str:
        """Return `file:line` of a sample, for messages."""
        return f"{self.file[row]}:{self.line[row]}"


def numbered(*columns: Iterable[Any]) -> tuple[tuple[tuple[Any, ...], ...], np.ndarray]:
    """Return the distinct rows of columns (n,) in their order, and the number (n,) of each row among them."""
    plain = (column.tolist() if isinstance(column, np.ndarray) else column for column in columns)
    keys = list(zip(*plain, strict=True))
    number = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    return tuple(number), np.array([number[key] for key in keys], dtype=int)


def concatenate(tables: Sequence[Table]) -> Table:
    """Return the samples of several tables in one; a user column missing in a table becomes NaN there.

    Raises
    ------
    InputError
        No table, or tables with different numbers of axes.
    """
    if not tables:
        raise InputError("no measured data: name a recording (.h5) or a table (.csv)")
    if len({table.axes for table in tables}) > 1:
        counts = ", ".join(f"{table.file[0] if table.file else 'a file without rows'} {table.axes}" for table in tables)
        raise InputError(f"the data are of arms with different numbers of axes ({counts}); give the data of one arm")
    joined: dict[str, Any] = {
        item.name: np.concatenate([getattr(table, item.name) for table in tables])
        for item in fields(Table)
        if item.name not in ("file", "extra")
    }
    joined["file"] = tuple(name for table in tables for name in table.file)
    names = dict.fromkeys(name for table in tables for name in table.extra)
    joined["extra"] = {
        name: np.concatenate([table.extra.get(name, np.full(len(table), np.nan)) for table in tables]) for name in names
    }
    return Table(**joined)


def without_duplicates(table: Table) -> Table:
    """Remove samples that repeat an earlier one in every value.

    Two samples are the same visit or instant if run, load, pose, directions and time agree; a value missing in one of
    them is not a difference.

    Raises
    ------
    InputError
        Two samples of the same visit or instant have different values.
    """
    _, run = np.unique(table.run, return_inverse=True)
    _, load = np.unique(table.load, return_inverse=True)
    direction = np.where(table.moving[:, None], 0, table.direction)
    time_s = np.nan_to_num(table.time_s, nan=-np.inf)
    key = np.column_stack([run, load, table.pose, table.moving, direction, time_s])
    order = np.lexsort(key.T)
    again = np.flatnonzero((key[order][1:] == key[order][:-1]).all(axis=1)) + 1
    if not len(again):
        return table
    earlier = order[again - 1]
    later = order[again]
    compared = {name: getattr(table, name) for name in COMPARED} | table.extra
    for name, values in compared.items():
        one, two = values[earlier].reshape(len(earlier), -1), values[later].reshape(len(later), -1)
        differs = ((one != two) & (one == one) & (two == two)).any(axis=1)
        if differs.any():
            first = int(np.argmin(np.where(differs, later, len(table))))
            row, before = int(later[first]), int(earlier[first])
            raise InputError(
                f"{table.where(row)}: repeats {table.where(before)} (run {table.run[row]}, load {table.load[row]}, "
                f"pose {table.pose[row]}) with another {name}; keep one, or give a repeated visit its own time_s"
            )
    keep = np.ones(len(table), dtype=bool)
    keep[order[again]] = False
    return table.take(keep)
