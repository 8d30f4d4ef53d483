"""Noise of a moving run: its scale on every axis, and the share of rows that count.

Residuals of a moving run hang together over time, so n rows are worth far fewer: each axis's weight carries the share
of rows that count (integrated autocorrelation). The noise scale of an axis comes from a fit of that axis alone, free of
all the others: taken from the residual of the very model on trial, the weights would switch off the axis that shows
what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model.motion import PER_BODY, Mask, Modelled, MovingRows, structural_base
from gateway.model.term import Term

Floats = NDArray[np.float64]
#: Values [-] below which no correlation is told.
LEAST_SERIES = 8
#: Correlation [-] at which its sum ends.
FADED = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class MovingNoise:
    """Scale of the residual (N,) [Nm] and the share (N,) of rows that count."""

    sigma_nm: Floats
    share: Floats

    @property
    def weight(self) -> Floats:
        """Weight (N,) of a row [1/Nm]."""
        return np.sqrt(self.share) / self.sigma_nm


def noise_of(motion: MovingRows, terms: Sequence[Term], modelled: Modelled | None) -> MovingNoise:
    """Scale and share of each axis from a fit of that axis alone; unmeasured axes get 1 and 1."""
    chosen = structural_base(motion.robot, motion.gravity_m_s2)
    sigma, share = np.ones((2, motion.axes))
    labels = np.unique(motion.load[~motion.given])
    for axis in np.flatnonzero(motion.measured):
        rows = motion.judged[:, axis] & ~motion.given
        own = [motion.rigid[:, axis][:, chosen]]
        own.append(np.column_stack([motion.sign[:, axis], motion.qd_rad_s[:, axis], motion.qdd_rad_s2[:, axis]]))
        own.append(np.ones((len(motion), 1)))
        # each load beside the first has a body of its own: left out, the difference of two loads would pass for noise
        own += [motion.rigid[:, axis, -PER_BODY:] * (motion.load == label)[:, None] for label in labels[1:]]
        for term in terms:
            axes = term.enters(motion.axes)
            if axis in axes and (modelled is not None or not term.modelled):
                own.append(term.columns(motion, modelled)[:, axes.index(axis)])  # type: ignore[arg-type]
        matrix = np.concatenate(own, axis=1)[rows]
        scale = np.linalg.norm(matrix, axis=0)
        matrix = matrix[:, scale > 1e-12] / scale[scale > 1e-12]
        target = motion.tau_nm[rows, axis]
        solution = np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
        rest = target - matrix @ solution
        floor = 1e-6 * max(float(np.abs(target).max()), 1e-6)
        sigma[axis] = max(float(np.sqrt(np.mean(rest**2))), floor)
        share[axis] = counting_share(rest)
    return MovingNoise(sigma, share)


def counting_share(series: Floats) -> float:
    """Independent values per value of a correlated series (n,): 1 / (1 + 2 sum of autocorrelation to its end)."""
    centred = series - series.mean()
    power = float(centred @ centred)
    if power <= 0 or len(series) < LEAST_SERIES:
        return 1.0
    size = 1 << (2 * len(series) - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: len(series) // 2] / power
    below = np.flatnonzero(correlation < FADED)
    stop = int(below[0]) if len(below) else len(correlation)
    return float(1.0 / (1.0 + 2.0 * correlation[1:stop].sum()))


def scaled_to(problem_noise: MovingNoise, residual_nm: Floats, judged: Mask) -> MovingNoise:
    """The same noise, its common scale raised to what the model as a whole leaves (median over the axes)."""
    count = judged.sum(axis=0)
    there = count > 0
    square = (residual_nm**2 * judged).sum(axis=0)[there] / count[there]
    factor = float(np.sqrt(np.median(square / problem_noise.sigma_nm[there] ** 2)))
    return MovingNoise(problem_noise.sigma_nm * max(1.0, factor), problem_noise.share)
