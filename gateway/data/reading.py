"""Measured data from files: recordings and tables, mixed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gateway.cell.config import LoadedCell
from gateway.cell.conversion import AxisConversion
from gateway.data.recording.reader import read
from gateway.data.table import Table, concatenate, read_csv, without_duplicates
from gateway.errors import InputError


def read_data(paths: Sequence[Path | str], cell: LoadedCell | None) -> Table:
    """Rows of all files; the same row in two files counts once.

    Parameters
    ----------
    paths : sequence of Path or str
        `.h5` recordings and `.csv` tables.
    cell : LoadedCell or None
        Its first arm converts motor torques and currents of tables; recordings carry their own cell.

    Raises
    ------
    InputError
        A file that cannot be used, an unknown kind of file, rows that contradict each other.
    """
    axes = None if cell is None else AxisConversion.from_arm(cell.cell.arm[0])
    return without_duplicates(concatenate([_read_one(Path(path), axes) for path in paths]))


def _read_one(path: Path, axes: AxisConversion | None) -> Table:
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return read_csv(path, axes)
    if suffix in (".h5", ".hdf5"):
        return read(path).table()
    raise InputError(f"{path}: neither a recording (.h5) nor a measured table (.csv)")
