"""Time series of the checks of one robot: one value per check, with temperature and load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gateway.fleet.columns import ESTIMATE, RECORDING, RESULT, TEMPERATURE, library
from gateway.fleet.store import by_axis
from gateway.result.fleet import MASS, QUANTITIES, Tracked

Floats = NDArray[np.float64]

_YEAR_S: Final = 365.25 * 86400.0
#: A check further off its neighbours than so many of their median deviations is gross, and in no line.
_OUTLIER_BANDS: Final = 8.0
_NEIGHBOURS: Final = 5
#: A temperature that so few checks have is left out, rather than the other checks.
_LEAST_SHARE: Final = 0.5
#: Median absolute deviation of a normal distribution over its standard deviation.
_MAD: Final = 0.6745


@dataclass(frozen=True, slots=True, eq=False)
class CheckSeries:
    """Values of M quantities in n checks of one robot.

    Attributes
    ----------
    quantities, joints, programs : quantity, joint and load label of every series
    time_a : (n,) years since the first check
    value, std : (n, M); NaN = not measured
    temperature_c, load_kg : (n, M) minus the mean; all 0 where unknown
    set_aside : (M,) number of rejected outliers
    """

    quantities: tuple[Tracked, ...]
    joints: tuple[int, ...]
    programs: tuple[str, ...]
    time_a: Floats
    value: Floats
    std: Floats
    temperature_c: Floats
    load_kg: Floats
    set_aside: Floats


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Rows of a robot that are used, and remarks on the excluded ones."""

    rows: Any
    series: CheckSeries
    axes: int
    remarks: tuple[str, ...]


def history(rows: Any) -> History:
    """Return the rows of one robot sorted by time.

    A repeated estimate replaces the recording and its result. Of a resumed recording the longest version is used.
    Rows with an implausible time are excluded.
    """
    pa = library("pyarrow")
    remarks: list[str] = []
    keep, odd = _kept(rows)
    faults = sum(said is not None for said, use in zip(rows["clock"].to_pylist(), keep, strict=True) if use)
    if faults:
        remarks.append(
            f"{faults} checks have an implausible time and are excluded from trends: set the clock of the robot"
        )
    remarks += odd
    good = [use and said is None for use, said in zip(keep, rows["clock"].to_pylist(), strict=True)]
    used = rows.filter(pa.array(good, pa.bool_()))
    per_axis = {
        name: by_axis(used[name])
        for name in [*(name for each in QUANTITIES for name in (each.key, each.std_key)), TEMPERATURE]
    }
    axes = max((table.shape[1] for table in per_axis.values()), default=0)
    return History(used, _series(used, per_axis, axes), axes, tuple(remarks))


def _kept(rows: Any) -> tuple[list[bool], list[str]]:
    """Return which rows are used (n,), and remarks on the excluded ones."""
    kind, recordings = rows["kind"].to_pylist(), rows["recordings"].to_pylist()
    time, duration = rows["time_utc"].to_pylist(), rows["duration_s"].to_pylist()
    software = rows["software"].to_pylist()
    estimated = {(sha, arm) for row, arm in enumerate(rows["arm"].to_pylist()) if kind[row] == ESTIMATE
                 for sha in recordings[row] or ()}  # fmt: skip
    arms = rows["arm"].to_pylist()
    keep = [
        kind[row] not in (RECORDING, RESULT) or not any((sha, arms[row]) in estimated for sha in recordings[row] or ())
        for row in range(rows.num_rows)
    ]
    best: dict[Any, int] = {}
    for row in range(rows.num_rows):
        if keep[row] and kind[row] in (RECORDING, ESTIMATE):
            other = best.setdefault(time[row], row)
            if (duration[row] or 0.0, software[row]) > (duration[other] or 0.0, software[other]):
                best[time[row]] = row
    chosen = set(best.values())
    keep = [use and (kind[row] not in (RECORDING, ESTIMATE) or row in chosen) for row, use in enumerate(keep)]
    spans = [(time[row].timestamp(), duration[row] or 0.0) for row in sorted(chosen, key=lambda row: time[row])]
    across = sum(start + length > after for (start, length), (after, _) in zip(spans, spans[1:], strict=False))
    odd = [f"{across} recordings overlap the next one: the clock was set back; check their times"] if across else []
    return keep, odd


def _series(rows: Any, per_axis: dict[str, Floats], axes: int) -> CheckSeries:
    count = rows.num_rows
    at = rows["time_utc"].to_numpy().astype("datetime64[us]").astype(np.int64) / 1e6
    temperature = _as_wide(per_axis[TEMPERATURE], axes)
    out = np.zeros(rows.num_rows)
    for row, loads in enumerate(rows["loads"].to_pylist()):
        masses = [np.nan if each["mass_kg"] is None else each["mass_kg"] for each in loads or ()]
        out[row] = float(np.mean(masses)) if masses else 0.0
    load = out
    parts: list[tuple[Tracked, int, str, Floats, Floats, Floats, Floats]] = []
    for each in QUANTITIES:
        value, std = _as_wide(per_axis[each.key], axes), _as_wide(per_axis[each.std_key], axes)
        for axis in range(axes):
            parts.append((each, axis + 1, "", value[:, axis], std[:, axis], temperature[:, axis], load))
    known = np.isfinite(temperature)
    mean = np.where(known, temperature, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean = np.where(known.any(axis=1), mean, np.nan)
    for program, (value, std) in sorted(program_masses(rows).items()):
        parts.append((MASS, 0, program, value, std, mean, np.zeros(count)))
    parts = [part for part in parts if np.isfinite(part[3]).any()]
    values = np.stack([part[3] for part in parts], axis=1) if parts else np.zeros((count, 0))
    kept, rejected = _without_outliers(values)
    return CheckSeries(
        quantities=tuple(part[0] for part in parts),
        joints=tuple(part[1] for part in parts),
        programs=tuple(part[2] for part in parts),
        time_a=(at - at[0]) / _YEAR_S if count else at,
        value=kept,
        std=_stacked([part[4] for part in parts], count),
        temperature_c=_stacked([_centred(part[5], part[3]) for part in parts], count),
        load_kg=_stacked([_centred(part[6], part[3]) for part in parts], count),
        set_aside=rejected,
    )


def _stacked(columns: Sequence[Floats], count: int) -> Floats:
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def _as_wide(table: Floats, axes: int) -> Floats:
    if table.shape[1] == axes:
        return table
    return np.hstack([table, np.full((len(table), axes - table.shape[1]), np.nan)])


def _centred(values: Floats, of: Floats) -> Floats:
    """Subtract the mean where the quantity was measured; return 0 where most checks lack it."""
    there, known = np.isfinite(of), np.isfinite(values)
    both = there & known
    if both.sum() < _LEAST_SHARE * max(there.sum(), 1) or not both.any():
        return np.zeros(len(values))
    return values - values[both].mean()


def program_masses(rows: Any) -> dict[str, tuple[Floats, Floats]]:
    """Return mass and standard deviation (n,) [kg] by program; NaN in checks without it."""
    found: dict[str, tuple[Floats, Floats]] = {}
    for row, loads in enumerate(rows["loads"].to_pylist()):
        for each in loads or ():
            blank = (np.full(rows.num_rows, np.nan), np.full(rows.num_rows, np.nan))
            mass, std = found.setdefault(each["program"], blank)
            mass[row] = np.nan if each["mass_kg"] is None else each["mass_kg"]
            std[row] = np.nan if each["mass_std_kg"] is None else each["mass_std_kg"]
    return found


def _without_outliers(values: Floats) -> tuple[Floats, Floats]:
    """Return values (n, M) without outliers, and the number of outliers (M,)."""
    count, series = values.shape
    if count < 2 * _NEIGHBOURS + 1 or not series:
        return values, np.zeros(series)
    middle = np.nanmedian(values, axis=0)
    filled = np.where(np.isfinite(values), values, middle)
    padded = np.pad(filled, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0)
    away = np.abs(filled - np.median(around, axis=2))
    spread = np.nanmedian(np.where(np.isfinite(values), away, np.nan), axis=0) / _MAD
    gross = np.isfinite(values) & (away > _OUTLIER_BANDS * spread) & (spread > 0.0)
    return np.where(gross, np.nan, values), gross.sum(axis=0).astype(float)
