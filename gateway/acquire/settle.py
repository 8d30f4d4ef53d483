"""Decide from the samples whether an arm has settled."""

from __future__ import annotations

from collections import deque

import numpy as np

WINDOW_S = 0.12
LEAST_WINDOW = 10
#: Three windows: at the crest of an oscillation, two neighbouring means agree by chance.
WINDOWS = 3
#: Largest difference of two window means that noise explains, in standard deviations.
SIGMAS = 3.0
#: Largest movement within a window that counts as rest [rad].
POSITION_FLOOR_RAD = 1e-4
#: Ignored torque difference, as a share of the torque limit.
TORQUE_FLOOR_SHARE = 5e-4


class SettleTest:
    """Test for settling by comparing three successive windows of samples.

    A joint has settled if its positions in the last window are within noise and the window means of its torque differ
    by no more than noise explains. Noise is estimated from differences of successive samples, which a slow drift barely
    affects.

    Parameters
    ----------
    period_s : float
        SYNC period.
    torque_limit_nm : array of shape (N,)
        Torque limit; a small share of it is the torque difference that is ignored.
    """

    def __init__(self, period_s: float, torque_limit_nm: np.ndarray) -> None:
        self.window = max(LEAST_WINDOW, round(WINDOW_S / period_s))
        self._floor_nm = TORQUE_FLOOR_SHARE * torque_limit_nm
        #: Joint, from 0, that is least settled: it moves farthest, or else its torque drifts farthest for its limit.
        self.worst = 0
        self._rows: deque[np.ndarray] = deque(maxlen=WINDOWS * self.window)

    def add(self, q_rad: np.ndarray, torque_nm: np.ndarray) -> None:
        """Add one complete sample, (N,) each."""
        self._rows.append(np.concatenate([q_rad, torque_nm]))

    def restless(self) -> np.ndarray | None:
        """Return a mask (N,) of the joints that have not settled; None = too few samples."""
        if len(self._rows) < WINDOWS * self.window:
            return None
        axes, rows = len(self._floor_nm), np.array(self._rows)
        noise = np.sqrt((np.diff(rows, axis=0) ** 2).mean(axis=0) / 2.0)
        travel = np.ptp(rows[-self.window :, :axes], axis=0)
        moved = travel > POSITION_FLOOR_RAD + 2.0 * SIGMAS * noise[:axes]
        drift = np.ptp(rows[:, axes:].reshape(WINDOWS, self.window, axes).mean(axis=1), axis=0)
        allowed = self._floor_nm + SIGMAS * np.sqrt(2.0 / self.window) * noise[axes:]
        self.worst = int(np.argmax(travel * moved if moved.any() else drift / allowed))
        return moved | (drift > allowed)
