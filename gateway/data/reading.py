"""Read measured data from a mix of recordings (HDF5) and tables (CSV)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gateway.cell.conversion import AxisConversion
from gateway.data.recording.recorded import Recording
from gateway.data.table import Table, concatenate, read_csv, without_duplicates
from gateway.errors import InputError

RECORDING_SUFFIXES = (".h5", ".hdf5")


def read_data(paths: Sequence[Path | str], recordings: Sequence[Recording], axes: AxisConversion | None) -> Table:
    """Return the samples of all files as one table; a sample that is in two files counts once.

    Parameters
    ----------
    paths : sequence of Path or str
        `.h5` recordings and `.csv` tables.
    recordings : sequence of Recording
        Recordings among the paths that are already read and bound to their arm.
    axes : AxisConversion or None
        Converts motor torques and currents of tables.

    Raises
    ------
    InputError
        A file that cannot be used, an unknown kind of file, or contradictory samples.
    """
    by_path = {recording.path: recording for recording in recordings}
    return without_duplicates(concatenate([_rows(Path(path), by_path, axes) for path in paths]))


def is_recording(path: Path) -> bool:
    """Return whether a path has the suffix of a recording."""
    return path.suffix.lower() in RECORDING_SUFFIXES


def _rows(path: Path, recordings: dict[Path, Recording], axes: AxisConversion | None) -> Table:
    if path.suffix.lower() == ".csv":
        return read_csv(path, axes)
    if is_recording(path):
        return recordings[path].table()
    raise InputError(f"{path}: neither a recording (.h5) nor a measured table (.csv)")
