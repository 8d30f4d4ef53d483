"""Noise of a moving run: scale of each axis, and share of independent rows.

Residuals of a moving run are autocorrelated, so n rows count as far fewer. The weight of each axis contains the share
of independent rows (integrated autocorrelation). The noise scale of an axis comes from a fit of that axis alone. A
scale from the residual of the tested model would reduce the weight of the very axis that lacks an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.identify.correlation import counting_share
from gateway.identify.motion.columns import Columns
from gateway.identify.prior_loads import BARE_LABEL
from gateway.model.motion import PER_BODY, Mask, Modelled, MovingRows
from gateway.model.term import Term

Floats = NDArray[np.float64]
#: Length of a column below which there is none.
NOTHING_NM = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class MovingNoise:
    """Noise scale (N,) [Nm] of the residual, and share (N,) of independent rows."""

    sigma_nm: Floats
    share: Floats

    @property
    def weight(self) -> Floats:
        """Weight (N,) of a row [1/Nm]."""
        return np.sqrt(self.share) / self.sigma_nm


def noise_of(motion: MovingRows, columns: Columns, terms: Sequence[Term], modelled: Modelled | None) -> MovingNoise:
    """Scale and share of each axis from a fit of that axis alone; 1 and 1 for unmeasured axes."""
    sigma, share = np.ones((2, motion.axes))
    for axis in np.flatnonzero(motion.measured):
        more = []
        for term in terms:
            axes = term.enters(motion.axes)
            if axis in axes and (modelled is not None or not term.modelled):
                more.append(term.columns(motion, modelled)[:, axes.index(axis)])  # type: ignore[arg-type]
        _, rest = axis_alone(motion, columns, int(axis), more)
        rows = motion.judged[:, axis] & ~motion.held_out
        floor = 1e-6 * max(float(np.abs(motion.tau_nm[rows, axis]).max()), 1e-6)
        sigma[axis] = max(float(np.sqrt(np.mean(rest**2))), floor)
        share[axis] = counting_share(rest)
    return MovingNoise(sigma, share)


def axis_alone(motion: MovingRows, columns: Columns, axis: int, more: Sequence[Floats] = ()) -> tuple[float, Floats]:
    """Coulomb friction [Nm] and residual (k,) of the fitted rows of one axis, from a fit of that axis alone.

    Its links, its loads and further columns (n, m) are free parameters.
    """
    rows = motion.judged[:, axis] & ~motion.held_out
    bodies = motion.rigid[:, axis]
    # a load left out would pass for noise where two of them differ
    labels = np.setdiff1d(motion.load[~motion.held_out], [BARE_LABEL])
    loaded = [bodies[:, -PER_BODY:] * (motion.load == label)[:, None] for label in labels]
    own = columns.design[:, axis, columns.lasting[axis]]
    matrix = np.column_stack([own, bodies, *loaded, *more])[rows]
    scale = np.linalg.norm(matrix, axis=0)
    there = scale > NOTHING_NM
    target, value = motion.tau_nm[rows, axis], np.zeros(len(scale))
    value[there] = np.linalg.lstsq(matrix[:, there] / scale[there], target, rcond=1e-6)[0] / scale[there]
    return float(value[0]), target - matrix @ value


def scaled_to(problem_noise: MovingNoise, residual_nm: Floats, judged: Mask) -> MovingNoise:
    """Return the noise with its common scale raised to the residual of the whole model (median over the axes)."""
    count = judged.sum(axis=0)
    there = count > 0
    square = (residual_nm**2 * judged).sum(axis=0)[there] / count[there]
    factor = float(np.sqrt(np.median(square / problem_noise.sigma_nm[there] ** 2)))
    return MovingNoise(problem_noise.sigma_nm * max(1.0, factor), problem_noise.share)
