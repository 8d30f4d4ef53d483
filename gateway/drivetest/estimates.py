"""Figures with intervals from bracketed samples: each sample is known to be between a lower and an upper value."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.stats import beta, binom

from gateway.result.drive_test import TimingFigure

CONFIDENCE: Final = 0.95


def quantile_ranks(count: int, share: float) -> tuple[int, int]:
    """Return the ranks (from 0) of the order statistics that enclose a quantile with at least 95 %.

    Source: binomial interval of a quantile; at the edges the extreme sample is used.
    """
    tail = (1.0 - CONFIDENCE) / 2.0
    low = int(binom.ppf(tail, count, share)) - 1
    high = int(binom.ppf(1.0 - tail, count, share))
    return max(low, 0), min(high, count - 1)


def bracketed_quantile(
    name: str, brackets: Sequence[tuple[float, float]], share: float, resolution: float, method: str, unit: str = "s"
) -> TimingFigure:
    """Return a quantile of samples that are each known to be inside a bracket.

    Parameters
    ----------
    name : str
    brackets : sequence of (float, float)
        Lower and upper bound of each sample.
    share : float
        Quantile, 0.5 = median.
    resolution : float
        Half-width by which time stamps may be wrong.
    method, unit : str
    """
    if not brackets:
        return not_measured(name, f"{method}: no sample", unit)
    lower, upper = np.sort(np.array(brackets, dtype=float), axis=0).T
    first, last = quantile_ranks(len(lower), share)
    value = float(np.quantile((lower + upper) / 2.0, share))
    interval = (max(0.0, float(lower[first]) - resolution), float(upper[last]) + resolution)
    return TimingFigure(name, value, interval, unit, len(lower), method)


def share_figure(name: str, number: int, count: int, method: str) -> TimingFigure:
    """Return the share of events with its interval after Clopper and Pearson."""
    if not count:
        return not_measured(name, f"{method}: no SYNC could be counted", "1")
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(beta.ppf(tail, number, count - number + 1)) if number else 0.0
    high = float(beta.ppf(1.0 - tail, number + 1, count - number)) if number < count else 1.0
    return TimingFigure(name, number / count, (low, high), "1", count, method)


def not_measured(name: str, why: str, unit: str = "s") -> TimingFigure:
    """Return a figure without a value."""
    return TimingFigure(name, None, None, unit, 0, why)
