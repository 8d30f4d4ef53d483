"""Import and export of the measured table (CSV), and data of recordings and tables as one table."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.cell.conversion import AxisConversion
from gateway.data.csv_text import CsvColumns, empty_cell, read_columns, text_cells
from gateway.data.labels import LONGEST, label_refused
from gateway.data.recording.recorded import Recording
from gateway.data.rows import MOVING, Table, concatenate, without_duplicates
from gateway.errors import InputError

__all__ = ["MOVING", "Table", "concatenate", "read_csv", "without_duplicates", "write_csv"]

LARGEST_INTEGER = 2**31 - 1
RECORDING_SUFFIXES = (".h5", ".hdf5")


def read_csv(path: Path, axes: AxisConversion | None) -> Table:
    """Read a measured table.

    Parameters
    ----------
    path : Path
    axes : AxisConversion or None
        Required for motor currents; without it, motor torques stay on the motor side.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        With file and line: unknown, missing or doubled column, cell that is not a finite number, duplicate rows that
        differ, current without the torque constants of a cell.
    """
    path = Path(path)
    columns = read_columns(path)
    if columns.axes < FEWEST_AXES:
        raise InputError(f"{columns.file}:1: columns of {columns.axes} axes; {FEWEST_AXES} to {MOST_AXES} are handled")
    if axes is not None and columns.axes != len(axes.ratio):
        raise InputError(
            f"{columns.file}:1: columns of {columns.axes} axes, and the arm of the cell has {len(axes.ratio)}; name the"
            " cell of the arm that was measured"
        )
    pose, moving = _rest_or_moving(columns)
    tau, tau_std, motor = _torques(columns, axes, moving)
    n_rows = len(columns.line)
    table = Table(
        file=(str(path),) * n_rows,
        line=columns.line,
        run=_label(columns, "run", path.stem),
        load=_label(columns, "load", "none"),
        pose=pose,
        time_s=columns.values.get("time_s", np.full(n_rows, np.nan)),
        q_rad=_by_axis(columns, "q{}_rad", needed=np.ones(n_rows, dtype=bool)),
        qd_rad_s=np.nan_to_num(_by_axis(columns, "qd{}_rad_s", needed=moving)),
        qdd_rad_s2=np.nan_to_num(_by_axis(columns, "qdd{}_rad_s2", needed=moving)),
        moving=moving,
        direction=_directions(columns),
        tau_nm=tau,
        tau_std_nm=tau_std,
        count=_integers(columns, "n", 1) if "n" in columns.values else np.ones(n_rows, dtype=int),
        q2nd_rad=_by_axis(columns, "q2nd{}_rad"),
        temperature_c=_by_axis(columns, "temp{}_c"),
        motor_torque_nm=motor,
        extra={name: values for name, values in columns.values.items() if name.startswith("x_")},
    )
    return without_duplicates(table)


def _label(columns: CsvColumns, name: str, default: str) -> np.ndarray:
    n_rows = len(columns.line)
    if name not in columns.values:
        return np.full(n_rows, default)
    cells = [cell.strip() for cell in columns.values[name]]
    for row, cell in enumerate(cells):
        if not cell or not cell.isprintable() or len(cell) > LONGEST:
            raise InputError(f"{columns.where(row)}: {name}: a label is needed, of printable characters")
        if name == "load" and (wrong := label_refused(cell)):
            raise InputError(f"{columns.where(row)}: load '{cell}' {wrong}")
    return np.array(cells)


def _integers(columns: CsvColumns, name: str, least: int) -> np.ndarray:
    values = columns.values[name]
    blank = np.isnan(values)
    bad = ~blank & ((values != np.round(values)) | (values < least) | (values > LARGEST_INTEGER))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(f"{columns.where(row)}: {name}: {values[row]:g} is not an integer of at least {least}")
    return np.where(blank, MOVING, np.nan_to_num(values)).astype(int)


def _rest_or_moving(columns: CsvColumns) -> tuple[np.ndarray, np.ndarray]:
    """Return pose (n,) and moving (n,): a sample with a velocity or without pose is moving."""
    n_rows = len(columns.line)
    speeds = _by_axis(columns, "qd{}_rad_s")
    pose = _integers(columns, "pose", MOVING) if "pose" in columns.values else np.full(n_rows, MOVING)
    has_speed = np.isfinite(speeds).any(axis=1)
    moving = (pose == MOVING) | (np.nan_to_num(speeds) != 0).any(axis=1)
    lost = moving & ~has_speed
    if lost.any():
        row = int(np.argmax(lost))
        raise InputError(
            f"{columns.where(row)}: a row at rest needs a pose number (column 'pose'), a moving row needs qd1_rad_s to "
            f"qd{columns.axes}_rad_s and qdd1_rad_s2 to qdd{columns.axes}_rad_s2"
        )
    if moving.any():
        times = columns.values.get("time_s")
        if times is None:
            raise InputError(f"{columns.file}:1: column 'time_s' is missing; moving rows need it")
        if np.isnan(times[moving]).any():
            row = int(np.argmax(moving & np.isnan(times)))
            raise InputError(f"{columns.where(row)}: time_s is empty; a moving row needs it")
    return np.where(moving, MOVING, pose), moving


def _by_axis(columns: CsvColumns, pattern: str, needed: np.ndarray | None = None) -> np.ndarray:
    """Return the columns of all axes as one array, NaN where absent; in rows marked by `needed` none may be empty."""
    n_rows = len(columns.line)
    out = np.full((n_rows, columns.axes), np.nan)
    for joint in range(columns.axes):
        name = pattern.format(joint + 1)
        if name in columns.values:
            out[:, joint] = columns.values[name]
        elif needed is not None and needed.any():
            raise InputError(f"{columns.file}:1: column '{name}' is missing (row at line {columns.line[needed][0]})")
    if needed is not None:
        empty = needed[:, None] & np.isnan(out)
        if empty.any():
            row, joint = np.argwhere(empty)[0]
            raise InputError(f"{columns.where(int(row))}: {pattern.format(joint + 1)} is empty; a moving row needs it")
    return out


def _directions(columns: CsvColumns) -> np.ndarray:
    values = np.nan_to_num(_by_axis(columns, "dir{}"))
    bad = ~np.isin(values, (-1, 0, 1))
    if bad.any():
        row, joint = np.argwhere(bad)[0]
        raise InputError(
            f"{columns.where(int(row))}: dir{joint + 1}: {values[row, joint]:g} is not one of -1, 0 (unknown), 1"
        )
    return values.astype(np.int8)


def _torques(
    columns: CsvColumns, axes: AxisConversion | None, moving: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joint torque, its standard deviation, and motor torque: (n, N) each, NaN where not measured."""
    tau, taum, current = (_by_axis(columns, pattern) for pattern in ("tau{}_nm", "taum{}_nm", "i{}_a"))
    found = 0
    for axis in range(1, columns.axes + 1):
        stated = [name for name in (f"tau{axis}_nm", f"taum{axis}_nm", f"i{axis}_a") if name in columns.values]
        if len(stated) > 1:
            raise InputError(f"{columns.file}:1: axis {axis} is given as {' and '.join(stated)}; keep one of them")
        found += len(stated)
        for name in (f"tau{axis}_std_nm", f"taum{axis}_std_nm", f"i{axis}_std_a"):
            if name in columns.values and name.replace("_std", "") not in columns.values:
                raise InputError(f"{columns.file}:1: column '{name}' has no column '{name.replace('_std', '')}'")
    if not found:
        raise InputError(f"{columns.file}:1: no torque or current column (tau1_nm .., taum1_nm .. or i1_a ..)")
    tau_std, taum_std, current_std = (
        _spread(columns, p, moving) for p in ("tau{}_std_nm", "taum{}_std_nm", "i{}_std_a")
    )
    if np.isfinite(current).any():
        if axes is None:
            raise InputError(f"{columns.file}:1: motor currents need the torque constants of a cell file; give --cell")
        measured = np.isfinite(current)
        taum = np.where(measured, axes.motor_torque_of_current(current), taum)
        taum_std = np.where(measured, axes.motor_torque_of_current(current_std), taum_std)
    if axes is not None:
        measured = np.isfinite(tau)
        tau = np.where(measured, tau, axes.joint_torque(taum))
        tau_std = np.where(measured, tau_std, axes.joint_torque_std(taum_std))
    return tau, tau_std, taum


def _spread(columns: CsvColumns, pattern: str, moving: np.ndarray) -> np.ndarray:
    """Return the standard deviations (n, N); they are optional for moving samples, which are not means."""
    values = _by_axis(columns, pattern)
    for joint in range(columns.axes):
        name = pattern.format(joint + 1)
        empty = np.isnan(values[:, joint]) & ~moving
        if name in columns.values and empty.any():
            raise empty_cell(columns.where(int(np.argmax(empty))), name)
    bad = values < 0
    if bad.any():
        row, joint = np.argwhere(bad)[0]
        raise InputError(f"{columns.where(int(row))}: {pattern.format(joint + 1)} is negative")
    return values


def write_csv(table: Table, path: Path) -> None:
    """Write a table that `read_csv` reads back: joint torques, without empty columns.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as stream:
            stream.write(csv_of(table))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def csv_of(table: Table) -> str:
    """Return the CSV text of a table: joint torques, without empty columns.

    Raises
    ------
    InputError
        An axis was measured in some rows only.
    """
    columns = _columns_to_write(table)
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return stream.getvalue()


def _columns_to_write(table: Table) -> dict[str, list[object]]:
    columns: dict[str, list[object]] = {"run": text_cells(table.run.tolist()), "load": text_cells(table.load.tolist())}
    if (~table.moving).any():
        columns["pose"] = ["" if moves else int(pose) for pose, moves in zip(table.pose, table.moving, strict=True)]
    if np.isfinite(table.time_s).any():
        columns["time_s"] = _cells(table.time_s)
    by_axis = {"q{}_rad": table.q_rad}
    if table.moving.any():
        rest = ~table.moving[:, None]
        by_axis |= {"qd{}_rad_s": np.where(rest, np.nan, table.qd_rad_s)}
        by_axis |= {"qdd{}_rad_s2": np.where(rest, np.nan, table.qdd_rad_s2)}
    if table.direction.any():
        by_axis |= {"dir{}": table.direction}
    on_motor = np.isnan(table.tau_nm).all(axis=0)
    torque_nm = np.where(on_motor, table.motor_torque_nm, table.tau_nm)
    missing = np.isnan(torque_nm).mean(axis=0)
    partly = (missing > 0) & (missing < 1)
    if partly.any():
        raise InputError(
            f"axis {int(np.argmax(partly)) + 1} was measured in some rows only; in a table, each axis has a torque in"
            " all rows or in none: export each recording separately"
        )
    by_axis |= {"tau{}_nm": table.tau_nm, "taum{}_nm": np.where(on_motor, table.motor_torque_nm, np.nan)}
    by_axis |= {"tau{}_std_nm": np.where(on_motor, np.nan, table.tau_std_nm)}
    by_axis |= {"q2nd{}_rad": table.q2nd_rad, "temp{}_c": table.temperature_c}
    for pattern, values in by_axis.items():
        for joint in range(table.axes):
            if np.isfinite(values[:, joint]).any():
                columns[pattern.format(joint + 1)] = _cells(values[:, joint])
    if (table.count != 1).any():
        columns["n"] = table.count.tolist()
    return columns | {name: text_cells(_cells(values)) for name, values in table.extra.items()}


def _cells(values: np.ndarray) -> list[object]:
    """Return the shortest decimals that read back to the same number; empty for NaN."""
    return ["" if value != value else value for value in values.tolist()]


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
