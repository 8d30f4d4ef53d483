"""Covariance of fitted parameters from parts of the data, which includes errors of the noise model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Least number of differences of a spread.
FEWEST_PARTS = 3
#: Least number of blocks of a run.
FEWEST_BLOCKS = 8


def jackknife(estimates: Floats) -> Floats:
    """Covariance of estimates (splits, k) that leave out one block of time each; zero for fewer than three."""
    if len(estimates) < FEWEST_PARTS:
        return np.zeros((estimates.shape[1],) * 2)
    centred = estimates - estimates.mean(axis=0)
    return (len(estimates) - 1) / len(estimates) * centred.T @ centred


def wider(first: Floats, second: Floats) -> Floats:
    """Return the first covariance (k, k), each parameter widened to the second one's variance where that is larger.

    Both measure the same spread. The second is of few parts: it determines sizes, but no correlations.
    """
    own = np.maximum(np.diag(first), 1e-300)
    scale = np.sqrt(np.maximum(np.diag(second) / own, 1.0))
    return first * scale * scale[:, None]


def by_blocks(pull: Floats, row: Ints, run: NDArray[np.str_], length: float) -> Floats:
    """Squared contributions (p, p) of rows (k, p) to the estimate, summed by block of time.

    Parameters
    ----------
    pull : array of shape (k, p)
    row : int array of shape (k,)
        Instant of each, which runs through `run`.
    run : array of shape (n,)
    length : float
        Rows of a block; a run has at least `FEWEST_BLOCKS` blocks.
    """
    block = np.zeros(len(run), dtype=int)
    start = 0
    for name in np.unique(run):
        mine = np.flatnonzero(run == name)
        count = max(int(len(mine) / max(length, 1.0)), min(FEWEST_BLOCKS, len(mine)))
        block[mine] = start + np.arange(len(mine)) * count // len(mine)
        start += count
    sums = np.zeros((start, pull.shape[1]))
    np.add.at(sums, block[row], pull)
    return sums.T @ sums * (start / max(start - 1, 1))
