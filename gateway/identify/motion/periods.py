"""Repeated periods: their mean, the noise from their scatter, and disturbed stretches.

Rows of one load and one excitation (`x_excitation`) at the same phase (`x_phase_s`) are averaged over the periods
(`x_period`) of each recording: gains and friction change from recording to recording. What repeats in every period is
due to the arm; the rest is noise, a touch, or a slipping load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from gateway.data.periods import EXCITATION, MOTION_HZ, PERIOD, PHASE_S, repeats, uninterrupted
from gateway.data.rows import Table, concatenate, numbered
from gateway.identify.motion.problem import Contrasts
from gateway.identify.motion.stretches import Stretches
from gateway.identify.motion.uncertainty import Scatter
from gateway.identify.rest.rest_nuisance import occasions_of
from gateway.identify.robust import median
from gateway.identify.spread import correlation_time
from gateway.result.result import Finding, SetAside

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Ratio of standard deviation to median absolute deviation of a Gaussian.
_MAD: Final = 1.4826
#: Averaging time of the search for a touch [s]; a person or a part pushes longer.
_TOUCH_S: Final = 0.15
#: Deviation of a touch, in standard deviations of the other periods.
_TOUCHED: Final = 8.0
#: Time rejected before and after it [s], because the arm oscillates.
_AROUND_S: Final = 0.3
#: Largest rejected share of a period; above it the whole period is rejected.
_MOST: Final = 0.3
#: Least number of periods to detect a deviating one.
_FEWEST: Final = 3
#: Share of the largest torque below which no deviation counts.
_NO_NOISE: Final = 1e-4
#: Change between consecutive periods, over its usual size, above which the load has changed.
_SLIPPED: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Periods:
    """Table with averaged periods, their noise and rejected stretches.

    Attributes
    ----------
    mean : Table
        One row per phase of each recording, load and excitation, in the time of its first period; rows of no period as
        they were.
    scatter : Scatter
        Noise of the rows of `mean`.
    excitation : array of shape (n,)
        What the rows of `mean` are of; NaN = of none.
    step_s : float
        Time between two phases.
    set_aside : tuple of SetAside
    findings : tuple of Finding
    slipped : load -> reason why its rows do not fit one body
    """

    mean: Table
    scatter: Scatter
    excitation: Floats
    step_s: float = np.nan
    set_aside: tuple[SetAside, ...] = ()
    findings: tuple[Finding, ...] = ()
    slipped: Mapping[str, str] = field(default_factory=dict)

    @property
    def low_pass(self) -> csr_array | None:
        """Matrix (n, n) that filters the rows whose motion was filtered; None without such rows."""
        limit_hz = self.mean.extra.get(MOTION_HZ, np.full(len(self.mean), np.nan))
        if not np.isfinite(limit_hz).any():
            return None
        time_s = np.where(np.isfinite(limit_hz), self.mean.time_s, np.nan)
        return Stretches.of(uninterrupted(self.mean), time_s).low_pass(len(self.mean), float(np.nanmin(limit_hz)))

    @property
    def contrasts(self) -> Contrasts:
        """Rows of several occasions at the same phases of one excitation."""
        out, occasion = [], occasions_of(self.mean)[1]
        periodic = np.isfinite(self.excitation)
        place = np.rint(np.where(periodic, self.mean.extra.get(PHASE_S, np.nan), np.nan) / self.step_s)
        for excitation in np.unique(self.excitation[periodic]):
            mine = np.flatnonzero(self.excitation == excitation)
            each = [mine[occasion[mine] == number] for number in np.unique(occasion[mine])]
            shared = reduce(np.intersect1d, [place[rows] for rows in each])
            if len(each) > 1 and len(shared):
                found = [np.intersect1d(place[rows], shared, return_indices=True)[1] for rows in each]
                out.append(np.array([rows[at] for rows, at in zip(each, found, strict=True)]))
        return Contrasts(tuple(out))


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Rows (P, n) of P periods at n phases, -1 = missing; `number` (P,) of each period."""

    rows: Ints
    number: Floats
    step_s: float


def averaged(moving: Table, judged: Mask) -> Periods:
    """Average the periods of a table's moving rows; return the table unchanged if it has none.

    Parameters
    ----------
    moving : Table
    judged : bool array of shape (n, N)
        Where an axis moves: at a standstill friction is not the same from period to period.
    """
    periodic = repeats(moving)
    if not periodic.any():
        return Periods(moving, Scatter.none(moving.axes), np.full(len(moving), np.nan))
    keys = [np.where(periodic, moving.extra[name], np.nan) for name in (EXCITATION, PERIOD, PHASE_S)]
    tables, groups, rejected, findings, residuals, slipped, alone, step_s = [], [], [], [], [], {}, {}, np.nan
    occasions, occasion = occasions_of(moving)
    for number, excitation in dict.fromkeys(zip(occasion[periodic].tolist(), keys[0][periodic].tolist(), strict=True)):
        mine, label = np.flatnonzero(periodic & (occasion == number) & (keys[0] == excitation)), occasions[number][1]
        # Rows of one recording, load and excitation by period, in time order
        phase_s = keys[2][mine]
        names, which = numbered([moving.file[k] for k in mine], keys[1][mine])
        numbers = np.array([name[1] for name in names])
        steps = np.concatenate([np.diff(np.sort(phase_s[which == k])) for k in range(len(numbers))])
        steps = steps[steps > 0]
        step = float(np.median(steps)) if len(steps) else 1.0
        place = np.rint(phase_s / step).astype(int)
        place -= place.min()
        rows = np.full((len(numbers), int(place.max()) + 1), -1)
        rows[which, place] = mine
        group = _Group(rows[:, (rows >= 0).any(axis=0)], numbers, step)
        step_s = group.step_s
        slip = _slip(moving, group, judged)
        if slip is not None:
            slipped.setdefault(label, slip)
        sound, entries = _without_touches(moving, group, judged)
        rejected += entries
        mean, left = _mean(moving, group, sound, judged, keys[2])
        tables.append(mean)
        groups.append(np.full(len(mean), excitation if len(group.rows) > 1 else np.nan))
        residuals.append(left)
        alone[label] = alone.get(label, True) and len(group.rows) < 2
    rest = moving.take(~periodic)
    findings += [_one_period(label) for label, only in alone.items() if only]
    findings += [_touched(entry) for entry in rejected]
    return Periods(
        concatenate([*tables, rest]) if len(rest) else concatenate(tables),
        _scatter(residuals, moving.axes),
        np.concatenate([*groups, np.full(len(rest), np.nan)]),
        step_s,
        tuple(rejected),
        tuple(findings),
        slipped,
    )


def _torques(moving: Table, group: _Group, judged: Mask) -> Floats:
    """Torques (P, n, N) of the periods where an axis moves in all of them, NaN elsewhere."""
    there = (group.rows >= 0)[:, :, None]
    moves = np.where(there, judged[group.rows], True).all(axis=0)
    return np.where(there & moves, moving.tau_nm[group.rows], np.nan)


def _slip(moving: Table, group: _Group, judged: Mask) -> str | None:
    """Return the reason if a load slipped: the torque changes after a period and does not drift; else None."""
    if len(group.rows) < _FEWEST + 1:
        return None
    tau = _torques(moving, group, judged)
    change = np.asarray(np.diff(tau, axis=0), dtype=float)
    step = _running_mean(np.nan_to_num(change), max(1, round(_TOUCH_S / group.step_s)))
    moved = np.asarray(np.isfinite(tau).all(axis=0), dtype=bool)
    jump = np.array([[median(np.abs(one[moved[:, k], k])) for k in range(moving.axes)] for one in step])
    jump = np.nan_to_num(jump)
    ratio = jump / np.maximum(np.median(jump, axis=0), _NO_NOISE * _largest(tau))
    before, axis = divmod(int(np.argmax(ratio)), moving.axes)
    if ratio[before, axis] < _SLIPPED:
        return None
    return (
        f"its torque changes from period {float(group.number[before + 1]):g} on: on axis {axis + 1} by"
        f" {jump[before, axis]:.3g} Nm, {ratio[before, axis]:.0f} times the largest other change between two"
        " periods: it slipped, or something was added"
    )


def _largest(tau_nm: Floats) -> Floats:
    """Largest torque (N,) [Nm] of (P, n, N)."""
    return np.maximum(np.nan_to_num(np.abs(tau_nm)).max(axis=(0, 1), initial=0.0), 1e-9)


def _without_touches(moving: Table, group: _Group, judged: Mask) -> tuple[Mask, list[SetAside]]:
    """Mask (P, n) of rows used in the mean, and the rejected stretches."""
    there = group.rows >= 0
    if len(group.rows) < _FEWEST:
        return there, []
    tau = _torques(moving, group, judged)
    known = np.isfinite(tau)
    off = np.nan_to_num(tau - np.nanmedian(np.where(known.any(axis=0), tau, 0.0), axis=0))
    smooth = _running_mean(off, max(1, round(_TOUCH_S / group.step_s)))
    size = _MAD * np.array([median(np.abs(smooth[:, :, k][known[:, :, k]])) for k in range(moving.axes)])
    far = np.abs(smooth) / np.maximum(np.nan_to_num(size, nan=np.inf), _NO_NOISE * _largest(tau))
    sound, entries = there.copy(), []
    around = max(1, round(_AROUND_S / group.step_s))
    for period in range(len(group.number)):
        hit = (far[period] > _TOUCHED).any(axis=1) & there[period]
        if not hit.any():
            continue
        wide = _running_mean(hit[None, :, None].astype(float), 2 * around + 1)[0, :, 0] > 0
        if wide.mean() > _MOST:
            wide[:] = True
        sound[period] &= ~wide
        entries.append(_entry(moving, group, period, hit, far[period]))
    # a phase that is rejected in all periods is kept: it would have no rows, and it is common to all
    lost = there.any(axis=0) & ~sound.any(axis=0)
    sound[:, lost] = there[:, lost]
    return sound, entries


def _running_mean(values: Floats, width: int) -> Floats:
    """Mean over `width` rows along the second axis of (P, n, N)."""
    total = np.cumsum(np.pad(values, ((0, 0), (width // 2 + 1, width - width // 2 - 1), (0, 0))), axis=1)
    return (total[:, width:] - total[:, :-width]) / width if values.shape[1] >= width else values


def _entry(moving: Table, group: _Group, period: int, hit: Mask, far: Floats) -> SetAside:
    rows = group.rows[period][hit]
    axis = int(np.argmax(np.where(hit[:, None], far, 0.0).max(axis=0)))
    return SetAside(
        run=str(moving.run[rows[0]]),
        load=str(moving.load[rows[0]]),
        joint=axis + 1,
        bands=float(far[hit, axis].max()),
        from_s=float(moving.time_s[rows].min()),
        to_s=float(moving.time_s[rows].max()),
        reason=f"period {group.number[period]:g} differs from the others: a touch, or a part that came loose",
    )


def _mean(
    moving: Table, group: _Group, sound: Mask, judged: Mask, phase_s: Floats
) -> tuple[Table, list[tuple[Floats, ...]]]:
    """Mean of the `sound` periods (P, n), and the deviation of the periods of each axis as noise of the mean (k, n)."""
    first = group.rows[np.argmax(sound, axis=0), np.arange(sound.shape[1])]
    one, count = moving.take(first), sound.sum(axis=0)
    if len(group.rows) < 2:
        return one, [() for _ in range(moving.axes)]
    kept = {
        key: np.einsum("pn,pna->na", sound / count, np.where(sound[:, :, None], getattr(moving, key)[group.rows], 0.0))
        for key in ("q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm")
    }
    begins_s = float(np.nan_to_num(np.min(one.time_s - phase_s[first])))
    extra = {**one.extra, PERIOD: np.full(len(one), group.number[0])}
    mean, moves = replace(one, **kept, time_s=begins_s + phase_s[first], extra=extra), _torques(moving, group, judged)
    # the deviation of P periods from their mean is smaller than their noise; the mean's noise is smaller again
    away = (moves - kept["tau_nm"]) / np.sqrt(np.maximum(count - 1, 1))[:, None]
    away[~sound | (count < 2)] = np.nan
    return mean, [tuple(row[np.isfinite(row)] for row in away[:, :, k]) for k in range(moving.axes)]


def _scatter(left: list[list[tuple[Floats, ...]]], axes: int) -> Scatter:
    """Noise of the mean rows, all groups together."""
    std, times = np.full(axes, np.nan), np.full(axes, np.nan)
    for axis in range(axes):
        parts = [period for group in left for period in group[axis] if len(period) > 1]
        if parts:
            noise = np.concatenate(parts)
            std[axis] = float(np.sqrt(np.mean(noise**2)))
            times[axis] = correlation_time(noise, np.repeat(np.arange(len(parts)), [len(part) for part in parts]))
    return Scatter(std, times)


def _one_period(label: str) -> Finding:
    return Finding(
        "warn", f"load {label}", "fewer than two whole periods: noise and model errors cannot be separated",
        "record at least two periods, better five",
    )  # fmt: skip


def _touched(entry: SetAside) -> Finding:
    return Finding(
        "warn", f"J{entry.joint}",
        f"run {entry.run}, {entry.from_s:.1f} to {entry.to_s:.1f} s: its torque deviates from the other periods by"
        f" {entry.bands:.0f} times the noise; rejected",
        "check what touched the arm, and repeat the run if much was rejected",
    )  # fmt: skip
