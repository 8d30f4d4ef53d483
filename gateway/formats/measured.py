"""Import of a measured table from the log of another program, with a map of its columns.

Rest intervals are detected: poses, and the approach direction of each joint. A preview shows first values, ranges and
problems of the columns.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from gateway.cell.plausible import BOUNDS, LARGEST_ANGLE_RAD
from gateway.data.csv_text import text_cells
from gateway.data.labels import BARE_LABEL, label_refused
from gateway.data.regular_file import regular_size
from gateway.errors import InputError
from gateway.formats.log import Log
from gateway.formats.log_map import (
    NEEDS,
    TIME_UNITS,
    UNITS,
    LogMap,
    LogRest,
    kind_of,
    pattern_of,
    unit_named,
)
from gateway.formats.ros_bag import SUFFIXES, read_bag
from gateway.formats.smooth import SmoothedMotion, clock_of, motion_of
from gateway.formats.text_log import read_text_log

Floats = NDArray[np.float64]
#: Columns whose samples have a spread over a stretch of standing, and what that is called.
_SPREADS: Final = {"tau{}_nm": "tau{}_std_nm", "taum{}_nm": "taum{}_std_nm", "i{}_a": "i{}_std_a"}

#: Speeds are taken from so many rows at least, and not over a step that is so many times as wide as the others.
_FEWEST_ROWS: Final = 20
_WIDE: Final = 1.5
#: Slowest rate of a log of motion, above which the unit of its time is another one [s].
_SLOWEST_STEP_S: Final = 1.0
#: Samples lost in a row are interpolated over this share of a period of the cutoff at most.
_WIDE_PERIODS: Final = 0.25
#: Stamps beyond half a step from the clock, as a share of all, from which on it is unknown when rows were sampled.
_FAR_SHARE: Final = 0.01
#: Scatter of the stamps, as a share of the step, that makes a difference.
_NOTED_SHARE: Final = 1e-3
_RATES: Final = ("qd{}_rad_s", "qdd{}_rad_s2")


def table_from_log(path: Path, stated: LogMap) -> tuple[str, int, tuple[str, ...]]:
    """Convert a log to a measured table, with a map; return its text, its number of rows, and remarks.

    Parameters
    ----------
    path : Path
        `.mcap` and `.db3` are bags, anything else is text.
    stated : LogMap

    Raises
    ------
    InputError
        With file and line: a column is missing, a cell is no finite number, a time goes back, an angle can only be in
        another unit. Or nothing is kept.
    ConfigError
        A library is not installed.
    """
    log, time_s, labels, values = _kept_rows(path, stated)
    if stated.rest is not None:
        rows, poses, direction = at_rest(time_s, _joined(values, stated.axes), labels, stated.rest)
        if not rows:
            raise InputError(
                f"{path}: the arm is never at rest for {stated.rest.seconds:g} s within {stated.rest.within_rad:g} rad;"
                " see [rest] of the map"
            )
        at = [each.start for each in rows]
        means: dict[str, list[object]] = {"load": labels[at].tolist(), "pose": [*poses], "time_s": time_s[at].tolist()}
        means |= {f"dir{axis + 1}": signs.tolist() for axis, signs in enumerate(direction.T)}
        return _imported(means | _averages(rows, values))
    motion = _derived(log, stated, time_s, values)
    remarks: tuple[str, ...] = ()
    if motion is not None:
        time_s = motion.time_s
        if motion.clock.lost or np.abs(motion.clock.jitter_s).max() > _NOTED_SHARE * motion.clock.step_s:
            remarks = (_clock_remark(motion),)
        for pattern, columns in zip(_RATES, (motion.qd_rad_s, motion.qdd_rad_s2), strict=True):
            values = {pattern.format(axis + 1): columns[:, axis] for axis in range(stated.axes)} | values
    rows = slice(None, None, stated.rows.every)
    table: dict[str, list[object]] = {"load": labels[rows].tolist(), "time_s": time_s[rows].tolist()}
    return _imported(table | {name: _complete(name, cells[rows]) for name, cells in values.items()}, remarks)


def preview_of(path: Path, stated: LogMap) -> tuple[list[PreviewColumn], list[str]]:
    """Return a preview of the columns of a log with a map, and general remarks; errors as in `table_from_log`."""
    log, time_s, labels, values = _kept_rows(path, stated)
    sources = {
        target: f"{source} [{column.unit}]" for column in stated.column for source, target, _ in stated.names(column)
    }
    sources["time_s"] = f"{stated.time.column} [{stated.time.unit}]"
    motion = _derived(log, stated, time_s, values)
    remarks = [f"{len(time_s)} rows, {time_s[-1] - time_s[0]:.6g} s, load {', '.join(sorted(set(map(str, labels))))}"]
    if stated.load.column is None and stated.load.label == BARE_LABEL:
        remarks.append("no load is named: every row is of the unloaded arm; name the load under [load], or with --load")
    if log.units:
        line, _ = next(iter(log.units.values()))
        remarks.append(f"line {line} contains units and is omitted")
    if motion is not None:
        remarks.append(_clock_remark(motion))
    return list(preview(time_s, values, sources)), remarks


def _kept_rows(path: Path, stated: LogMap) -> tuple[Log, Floats, NDArray[np.object_], dict[str, Floats]]:
    """Return the rows that the map keeps: log, times, labels, and columns of the table."""
    regular_size(path)
    if path.suffix.lower() not in SUFFIXES:
        log = read_text_log(path, stated.log, *stated.needed())
    elif stated.joints is None:
        raise InputError(
            f"{path}: a bag identifies joints by name: write joints = [..] in the map, in the arm's order, or --joints"
        )
    else:
        log = read_bag(path, stated.log.topic, stated.joints)
    _refuse_unit(log, stated.time.column, stated.time.unit)
    stamps = log.times(stated.time.column)
    time_s = log.numbers(stated.time.column) * TIME_UNITS[stated.time.unit] if stamps is None else stamps
    # two recorders of one topic store each message twice
    mapped = {source for column in stated.column for source, _, _ in stated.names(column)}.intersection(log.columns)
    same = [np.diff(time_s) == 0, *(log.columns[name][1:] == log.columns[name][:-1] for name in mapped)]
    once = np.append(True, ~np.all(same, axis=0))
    log, time_s = log.take(once), time_s[once]
    back = np.diff(time_s) <= 0
    if back.any():
        row = int(np.argmax(back)) + 1
        what = "goes back" if time_s[row] < time_s[row - 1] else "stands still"
        raise InputError(
            f"{log.where(row)}: {stated.time.column}: time {what}, {time_s[row]:.9g} s after {time_s[row - 1]:.9g} s;"
            f" {'cut the log there' if time_s.any() else 'name another column under [time], in a bag log_time'}"
        )
    time_s = time_s - time_s[0] if stated.time.base == "first" else time_s
    rows = stated.rows
    begin_s = -np.inf if rows.from_s is None else rows.from_s
    end_s = np.inf if rows.to_s is None else rows.to_s
    kept = (time_s >= begin_s) & (time_s <= end_s)
    if rows.column is not None:
        kept[kept] = np.isin(log.take(kept).numbers(rows.column), rows.equals)
    if not kept.any():
        raise InputError(f"{path}: [rows] of the map keeps none of the log's {len(kept)} rows")
    log, time_s = log.take(kept), time_s[kept]
    found: dict[str, Floats] = {}
    for column in stated.column:
        for source, target, axis in stated.names(column):
            if column.optional and source not in log.columns:
                continue
            _refuse_unit(log, source, column.unit)
            factor, shift = UNITS[kind_of(column.table) or "number"][column.unit]
            need = NEEDS.get(column.unit)
            if need == "rated":
                factor *= _of(column.rated, axis)
            elif need is not None:
                factor /= _of(column.counts_per_revolution, axis)
            if column.gear_ratio is not None:
                factor /= _of(column.gear_ratio, axis)
            values = _of(column.sign, axis) * (log.numbers(source) * factor + shift) + _of(column.offset, axis)
            if kind_of(column.table) == "angle" and (far := np.abs(values) > LARGEST_ANGLE_RAD).any():
                row = int(np.argmax(far))
                raise InputError(
                    f"{log.where(row)}: {source} makes {target} = {values[row]:g}, beyond {LARGEST_ANGLE_RAD:.4g} rad:"
                    " its unit is not that of the map; correct unit in the map"
                )
            found[target] = values
    if stated.load.column is None:
        labels = np.full(len(log.line), stated.load.label or BARE_LABEL, dtype=object)
    else:
        labels = log.text(stated.load.column)
        for row, label in enumerate(labels.tolist()):
            if wrong := label_refused(str(label)):
                raise InputError(f"{log.where(row)}: {stated.load.column}: load '{label}' {wrong}")
    return log, time_s, labels, found


def _refuse_unit(log: Log, name: str, unit: str) -> None:
    """Raise an error if a unit of the map differs from the unit row below the header, or from the column name."""
    line, reported = log.units.get(name, (log.header_line, ""))
    if not reported and (found := re.search(r"[\[(]([^\[\]()]+)[\])]\s*$", name)):
        reported = found[1]
    said = unit_named(reported)
    if said is not None and said != unit:
        raise InputError(
            f"{log.file}:{line}: {name}: the log says '{reported[:20]}', the map says {unit}; write unit = \"{said}\""
            " if the log is right"
        )


def _of(value: float | tuple[float, ...] | None, axis: int) -> float:
    return float(value[axis]) if isinstance(value, tuple) else float(value if value is not None else np.nan)


def _joined(values: dict[str, Floats], axes: int, pattern: str = "q{}_rad") -> Floats:
    return np.column_stack([values[pattern.format(axis + 1)] for axis in range(axes)])


def _derived(log: Log, stated: LogMap, time_s: Floats, values: dict[str, Floats]) -> SmoothedMotion | None:
    """Return speeds and accelerations by [motion], on the clock of the log; None if the log contains them."""
    wanted = [kind.format(axis + 1) for kind in _RATES for axis in range(stated.axes)]
    if stated.motion is None or all(name in values for name in wanted):
        return None
    if len(time_s) < _FEWEST_ROWS:
        raise InputError(
            f"{log.file}: {len(time_s)} rows are too few for the speeds of [motion]: {_FEWEST_ROWS} at least"
        )
    clock, q_rad = clock_of(time_s), _joined(values, stated.axes)
    step_s, span_s = float(np.median(np.diff(time_s))), float(time_s[-1] - time_s[0])
    speed_rad_s = np.abs(np.diff(q_rad, axis=0)).max(axis=1) / np.maximum(np.diff(time_s), step_s)
    is_slow = step_s > _SLOWEST_STEP_S or span_s * stated.motion.cutoff_hz < 1.0
    if is_slow or speed_rad_s.max() > BOUNDS["speed of other joints"][0]:
        raise InputError(
            f"{log.where(int(np.argmax(speed_rad_s)) + 1)}: {stated.time.column} in {stated.time.unit}: {span_s:.3g} s"
            f" in steps of {step_s:.3g} s, joint speed up to {speed_rad_s.max():.3g} rad/s: no arm in motion is logged"
            " so; correct the unit under [time] of the map, or a jump of the position"
        )
    wide = np.diff(clock.index) * clock.step_s > max(_WIDE * clock.step_s, _WIDE_PERIODS / stated.motion.cutoff_hz)
    if wide.any():
        row = int(np.argmax(wide)) + 1
        raise InputError(
            f"{log.where(row)}: {time_s[row] - time_s[row - 1]:.4g} s after the row before, where steps"
            f" are {np.median(np.diff(time_s)):.4g} s; [motion] needs even steps: keep a part without gaps by [rows]"
            " of the map"
        )
    motion = motion_of(time_s, q_rad, stated.motion.cutoff_hz)
    far = np.abs(clock.jitter_s) > 0.5 * clock.step_s
    if far.mean() > _FAR_SHARE and not motion.is_at_stamps:
        row = int(np.argmax(far))
        raise InputError(
            f"{log.where(row)}: time stamps scatter by {clock.jitter_s.std():.2g} s around even steps of"
            f" {clock.step_s:.4g} s: it is unknown when the rows were sampled. Log at a fixed rate, or name another"
            " time column"
        )
    return motion


def _clock_remark(motion: SmoothedMotion) -> str:
    """Return a summary of the time stamps for the user."""
    clock = motion.clock
    jitter_ms = 1e3 * clock.jitter_s
    text = f"time: steps of {1e3 * clock.step_s:.6g} ms, stamps off by {jitter_ms.std():.2g} ms (standard deviation)"
    text += f", {np.abs(jitter_ms).max():.2g} ms at most; {clock.lost} samples lost"
    if motion.is_at_stamps and np.abs(jitter_ms).max() > _NOTED_SHARE * 1e3 * clock.step_s:
        return f"{text}; the positions agree with the stamps: speeds are taken at these times"
    return f"{text}; speeds are taken on the even steps"


def _averages(rows: list[slice], values: dict[str, Floats]) -> dict[str, list[object]]:
    """Return one row per rest interval: means, standard deviations, and number of averaged rows."""
    columns: dict[str, list[object]] = {}
    for name, cells in values.items():
        pattern = pattern_of(name)
        if pattern in ("qd{}_rad_s", "qdd{}_rad_s2", "dir{}", "n"):
            continue
        columns[name] = [float(cells[each].mean()) for each in rows]
        if pattern in _SPREADS:
            spread = _SPREADS[pattern].format(name[len(pattern.partition("{")[0])])
            columns[spread] = [float(cells[each].std(ddof=1)) for each in rows]
    return columns | {"n": [each.stop - each.start for each in rows]}


def _complete(name: str, values: Floats) -> list[object]:
    """Return counts as integers, without a decimal point."""
    complete = name in ("pose", "n") or name.startswith("dir")
    return [int(value) if complete and value == int(value) else value for value in values.tolist()]


def _imported(columns: dict[str, list[object]], remarks: tuple[str, ...] = ()) -> tuple[str, int, tuple[str, ...]]:
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    writer.writerow(columns)
    writer.writerows(zip(*map(text_cells, columns.values()), strict=True))
    return stream.getvalue(), len(next(iter(columns.values()))), remarks


#: Rows that are shown.
SHOWN: Final = 3
#: A speed that is so far from the change of its angle, as a ratio, is in another unit or has another sign.
_OFF: Final = 0.3
#: Largest torque of an axis that no arm has [Nm], and the smallest that is no noise of a sensor.
_LARGEST_NM: Final = 1e5


@dataclass(frozen=True, slots=True)
class PreviewColumn:
    """Column of the preview: source, first values, range, and suspected error."""

    name: str
    source: str
    first: tuple[float, ...]
    least: float
    most: float
    remark: str


def preview(time_s: Floats, values: Mapping[str, Floats], sources: Mapping[str, str]) -> Iterator[PreviewColumn]:
    """Describe columns (n,) of a table, in the row order of the log.

    Parameters
    ----------
    time_s : array of shape (n,)
    values : mapping of str to array of shape (n,)
    sources : mapping of str to str
        Column of the log, and its unit, by column of the table.
    """
    yield _column("time_s", sources.get("time_s", ""), time_s, "")
    for name, cells in values.items():
        yield _column(name, sources.get(name, ""), cells, "; ".join(_odd(name, cells, time_s, values)))


def _column(name: str, source: str, cells: Floats, remark: str) -> PreviewColumn:
    return PreviewColumn(name, source, tuple(cells[:SHOWN].tolist()), float(cells.min()), float(cells.max()), remark)


def _odd(name: str, cells: Floats, time_s: Floats, values: Mapping[str, Floats]) -> Iterator[str]:
    if len(cells) > 1 and not np.ptp(cells) and (cells[0] or name.startswith(("tau", "i"))):
        yield "never changes"
    if name.startswith("q") and name.endswith("_rad") and np.abs(cells).max() > 2 * math.pi:
        yield "range above one revolution: is it a motor angle (set gear_ratio), or in another unit?"
    if name.endswith("_nm") and np.abs(cells).max() > _LARGEST_NM:
        yield f"beyond {_LARGEST_NM:g} Nm: is the unit mNm?"
    if name.startswith("qd") and name.endswith("_rad_s"):
        yield from _against_angle(cells, values.get(f"q{name[2:-6]}_rad"), time_s)


def _against_angle(speed: Floats, angle: Floats | None, time_s: Floats) -> Iterator[str]:
    """Return how a speed disagrees with the change of its angle; empty if it agrees."""
    if angle is None or len(time_s) < SHOWN or np.ptp(time_s) <= 0:
        return
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))])
    travelled, moved = travelled - travelled.mean(), angle - angle.mean()
    if not moved @ moved > 1e-6 * len(moved):
        return
    ratio = float(travelled @ moved / (moved @ moved))
    if abs(ratio - 1.0) > _OFF:
        what = "the other sign" if ratio < 0 else "another unit"
        yield f"is {ratio:.3g} times the change of the angle: {what}?"


def at_rest(
    time_s: Floats, q_rad: Floats, labels: NDArray[np.object_], rest: LogRest
) -> tuple[list[slice], list[int], NDArray[np.int8]]:
    """Return the intervals (k) in which no joint moves, each with one load.

    They are given as rows, pose numbers, and signs (k, N) of each joint's last motion before; 0 = unknown.

    Parameters
    ----------
    time_s : array of shape (n,)
    q_rad : array of shape (n, N)
    labels : array of shape (n,)
        Label of the load.
    rest : LogRest
    """
    rows: list[slice] = []
    poses: list[int] = []
    directions: list[NDArray[np.int8]] = []
    known: list[Floats] = []
    for start, stop in _windows(time_s, q_rad, labels, rest):
        begin = int(np.searchsorted(time_s, time_s[start] + rest.settle_s))
        end = int(np.searchsorted(time_s, time_s[stop - 1] - rest.settle_s, side="right"))
        if end - begin < 2:
            continue
        mean = q_rad[begin:end].mean(axis=0)
        rows.append(slice(begin, end))
        poses.append(rest.first_pose + _pose(mean, known, rest.same_pose_rad))
        before_rad = q_rad[:start]
        signs = np.zeros(len(mean), dtype=np.int8)
        for joint, at_rad in enumerate(mean):
            elsewhere = np.flatnonzero(np.abs(before_rad[:, joint] - at_rad) > rest.within_rad)
            if len(elsewhere):
                signs[joint] = np.sign(at_rad - before_rad[elsewhere[-1], joint])
        directions.append(signs)
    return rows, poses, np.array(directions, dtype=np.int8)


def _windows(time_s: Floats, q_rad: Floats, labels: NDArray[np.object_], rest: LogRest) -> list[tuple[int, int]]:
    """Yield the first row and the row after the last of each rest interval."""
    if len(time_s) < 2:
        return []
    width = max(2, round(rest.seconds / float(np.median(np.diff(time_s)))) + 1)
    if width > len(time_s):
        return []
    _, load = np.unique(labels.astype(str), return_inverse=True)
    watched = np.column_stack([q_rad / rest.within_rad, 2.0 * load])
    origin = (width - 1) // 2 - (width - 1)  # the window begins at its row
    spread = maximum_filter1d(watched, width, axis=0, origin=origin) - minimum_filter1d(
        watched, width, axis=0, origin=origin
    )
    still = np.asarray((spread <= 1.0).all(axis=1))
    still[len(time_s) - width + 1 :] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return [(int(first), int(last) - 1 + width) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def _pose(mean_rad: Floats, known: list[Floats], same_rad: float) -> int:
    for number, other in enumerate(known):
        if np.abs(mean_rad - other).max() <= same_rad:
            return number
    known.append(mean_rad)
    return len(known) - 1
