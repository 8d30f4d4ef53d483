"""Estimates from what was recorded of a drive: quantiles, shares, answers to SYNC, and when a stopping axis is at rest.

Pure functions of times, counts and numbers. A sample is known to be between a lower and an upper bound. The age of the
torque word has a file of its own, `torque_age`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import beta, binom

from gateway.report.drive_test_page import SHOWN, figure_text
from gateway.result.drive_test import DriveTestReport, TimingFigure
from gateway.result.numerals import significant

CONFIDENCE: Final = 0.95
#: A SYNC counts if the next one follows within this share of the period: another one was delayed by this computer.
_REGULAR_SHARE: Final = 0.2
#: SYNCs that most drives do not answer in time are left out up to this share.
_DISTURBED_SHARE: Final = 0.1
#: Share of the period after which an answer counts as delayed.
DELAYED_SHARE: Final = 0.9
#: Permitted share of TPDOs that are missed, or delayed, and the number of drives from which on they are compared.
LOST_SHARE: Final = 0.005
COMPARED: Final = 3
#: An axis is at rest once its speed is below this share of the speed with which it began to stop.
REST_SHARE: Final = 0.02
#: Change of the position [counts] between two SYNCs that an axis at rest may show.
_QUANTUM_COUNTS: Final = 1.5
#: Largest true speed at which the counts of a motor can look at rest, over `_QUANTUM_COUNTS` per SYNC: rounding.
_UNSEEN: Final = 5.0 / 3.0
#: Two times that differ by less are of the same SYNC [s].
_SAME_SYNC_S: Final = 1e-4


def add_figure(report: DriveTestReport, figure: TimingFigure, limit: float | None = None, advice: str = "") -> None:
    """Add a figure to a report, and a finding if its whole interval is above a limit (in the unit of the figure)."""
    report.figures.append(figure)
    if limit is not None and figure.interval is not None and figure.interval[0] > limit:
        what, factor, unit = SHOWN[figure.name]
        most = significant(factor * limit, 2)
        report.findings.append(f"{what}: {figure_text(figure)} {unit}; at most {most} {unit} is allowed; {advice}")


def quantile_figure(
    name: str, bounds: np.ndarray | Sequence[tuple[float, float]], share: float, resolution: float, method: str
) -> TimingFigure:
    """Return a quantile of samples that are each known to be between two bounds.

    Its interval is that of the order statistics which enclose the quantile with at least 95 % (binomial distribution);
    at the edges the extreme sample is used.

    Parameters
    ----------
    name : str
    bounds : array of shape (K, 2)
        Lower and upper bound of each sample [s].
    share : float
        Quantile, 0.5 = median.
    resolution : float
        By how much time stamps may be wrong, to either side [s].
    method : str
    """
    if not len(bounds):
        return TimingFigure(name, f"{method}: no sample")
    lower, upper = np.sort(np.asarray(bounds, dtype=float), axis=0).T
    tail = (1.0 - CONFIDENCE) / 2.0
    first = max(int(binom.ppf(tail, len(lower), share)) - 1, 0)
    last = min(int(binom.ppf(1.0 - tail, len(lower), share)), len(lower) - 1)
    interval = (max(0.0, float(lower[first]) - resolution), float(upper[last]) + resolution)
    return TimingFigure(name, method, float(np.quantile((lower + upper) / 2.0, share)), interval, len(lower))


def share_figure(name: str, number: int, count: int, method: str) -> TimingFigure:
    """Return the share of `number` of `count` events, with its interval after Clopper and Pearson."""
    if not count:
        return TimingFigure(name, f"{method}: no SYNC could be counted")
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(beta.ppf(tail, number, count - number + 1)) if number else 0.0
    high = float(beta.ppf(1.0 - tail, number + 1, count - number)) if number < count else 1.0
    return TimingFigure(name, method, number / count, (low, high), count)


def permitted_share(shares: Sequence[float], drive: int) -> float:
    """Return the share of missed, or delayed, TPDOs that one of the drives of an arm may have.

    It is `LOST_SHARE`, or the median of the other drives: what they share is a property of the bus or of this computer.

    Parameters
    ----------
    shares : sequence of float
        Of each drive at one SYNC period.
    drive : int
        Place of the drive in `shares`.
    """
    others = [*shares[:drive], *shares[drive + 1 :]]
    return max(LOST_SHARE, median(others)) if len(shares) >= COMPARED else LOST_SHARE


@dataclass(frozen=True, slots=True, eq=False)
class SyncAnswers:
    """Answers of one drive to a series of SYNCs.

    Attributes
    ----------
    delays_s : array of shape (M, 2)
        Bounds of the time from each answered SYNC to its answer.
    missed, delayed, counted : int
        SYNCs without an answer; with one after `DELAYED_SHARE` of the period; all that count.
    """

    delays_s: np.ndarray
    missed: int
    delayed: int
    counted: int


def count_answers(sent_s: np.ndarray, answers_s: Sequence[Sequence[float]], period_s: float) -> list[SyncAnswers]:
    """Assign the answers of several drives to SYNCs and count them; one result per drive.

    A SYNC counts if this computer sent the next one after one period. SYNCs that more than half of several drives
    answer with a delay or not at all are not counted either, as a disturbance of the bus or of this computer. Where
    they are more than a tenth, that is a property of the drives, and they count.

    Parameters
    ----------
    sent_s : array of shape (K, 2)
        Times before and after each SYNC was given to the bus.
    answers_s : sequence of sequences of float
        Of each drive, the times of its answers in their order.
    period_s : float
    """
    before_s, after_s = sent_s.T
    first_s = np.full((len(answers_s), len(sent_s)), np.nan)
    for row, times_s in zip(first_s, answers_s, strict=True):
        times = np.asarray(times_s, dtype=float)
        times = times[times >= before_s[0]]
        windows = [list(window) for window in np.split(times, np.searchsorted(times, before_s[1:]))]
        for window, following in zip(windows, windows[1:], strict=False):
            if not window and len(following) > 1:  # two answers to the next SYNC: the first belongs to this one
                window.append(following.pop(0))
        row[:] = [window[0] if window else np.nan for window in windows]
    missed, delayed = np.isnan(first_s), first_s - after_s > DELAYED_SHARE * period_s
    gap_s = np.diff(before_s, append=before_s[-1] + period_s)
    counted = np.abs(gap_s - period_s) <= _REGULAR_SHARE * period_s
    disturbed = np.mean(missed | delayed, axis=0) > 0.5
    if len(answers_s) > 1 and disturbed.sum() <= _DISTURBED_SHARE * len(sent_s):
        counted &= ~disturbed
    return [
        SyncAnswers(
            np.column_stack([times - after_s, times - before_s])[~absent],
            int(np.sum(absent & counted)),
            int(np.sum(late & counted)),
            int(np.sum(counted)),
        )
        for times, absent, late in zip(first_s, missed, delayed, strict=True)
    ]


class TimeToRest(NamedTuple):
    """Bounds of the time until rest [s], and the travel until then [counts].

    Attributes
    ----------
    low_s, high_s : float
    travel : float
        Largest travel at a SYNC.
    most : float
        Largest travel that an axis which is nowhere faster than at the SYNCs around can reach between two of them.
    speed_per_s : float
        Speed at the begin [counts/s].
    """

    low_s: float
    high_s: float
    travel: float
    most: float
    speed_per_s: float


def until_rest(time_s: np.ndarray, count: np.ndarray, begin_s: float) -> TimeToRest | None:
    """Return when and where a motor that begins to stop at a time is at rest first; None = it is not.

    That is the first instant at which the speed in the direction of the motion is below `REST_SHARE` of the speed at
    `begin_s`; later oscillation does not count. The first interval between two SYNCs with a lower mean speed ends after
    it; the interval before begins before it. A speed below one count per SYNC is not seen: the upper bound allows for
    it.

    Parameters
    ----------
    time_s, count : arrays of shape (K,)
        Time of each SYNC and position at it [counts].
    begin_s : float
    """
    first = int(np.searchsorted(time_s, begin_s - _SAME_SYNC_S))
    if first > len(time_s) - 3:
        return None
    speed = np.diff(count) / np.diff(time_s)
    begin = float(np.median(speed[max(0, first - 3) : max(1, first)]))
    quantum = _QUANTUM_COUNTS / float(np.median(np.diff(time_s)))
    floor = max(REST_SHARE * abs(begin), quantum)
    slow = np.flatnonzero(speed[first:] * np.sign(begin) <= floor)
    if abs(begin) <= floor or not len(slow):
        return None
    last, unseen = first + int(slow[0]), _UNSEEN * quantum / abs(begin)
    low_s = max(0.0, float(time_s[max(first, last - 1)] - begin_s))
    high_s = float(time_s[last + 1] - begin_s) * (1.0 + unseen)
    travel = (count[first : last + 2] - float(np.interp(begin_s, time_s, count))) * np.sign(begin)
    fastest = float(np.abs(speed[max(0, first - 1) : last + 2]).max())
    peaks = (travel[:-1] + travel[1:] + fastest * np.diff(time_s[first : last + 2])) / 2.0
    farthest = float(travel.max())
    most = max(farthest, float(peaks[-2:].max())) + farthest * unseen**2
    return TimeToRest(low_s, high_s, farthest, most, abs(begin))
