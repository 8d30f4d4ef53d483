"""Series that start at rest, as numbers to choose: a posture and free coefficients of every joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from gateway.excite.excitation import Series
from gateway.excite.limits import States

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """All series of so many harmonics and one period that start at rest: speed and acceleration are zero at t = 0.

    A member is its start (N,) and free numbers (F, N), F = 2 (harmonics - 1): coefficients in the null space of both
    conditions, so that none of them can break these.

    Attributes
    ----------
    period_s : float
    basis : array of shape (2, harmonics, F)
        Cosine and sine coefficients of each free number.
    shapes : array of shape (4, n, F)
        Position, speed, acceleration and jerk of each free number at instants spread evenly over a period.
    """

    period_s: float
    basis: Floats
    shapes: Floats

    @classmethod
    def of(cls, period_s: float, harmonics: int, instants: int) -> Family:
        """All series of a period, looked at `instants` times in it."""
        order = np.arange(1.0, harmonics + 1)
        cosine, sine = null_space(order[None] ** 2), null_space(order[None])
        nothing = np.zeros_like(cosine)
        basis = np.stack([np.hstack([cosine, nothing]), np.hstack([nothing, sine])])
        columns = Series("", np.zeros(basis.shape[2]), basis[0].T, basis[1].T, period_s, 1)
        return cls(period_s, basis, np.stack(columns.at(np.arange(instants) * period_s / instants)))

    @property
    def free(self) -> int:
        """How many numbers of a joint are free."""
        return self.basis.shape[2]

    def states(self, start_rad: Floats, free: Floats) -> States:
        """Members at all instants, one after the other.

        Parameters
        ----------
        start_rad : array of shape (m, N)
        free : array of shape (m, F, N)

        Returns
        -------
        States
            Arrays of shape (m n, N).
        """
        moved = np.einsum("dnf,mfj->dmnj", self.shapes, free)
        moved[0] += start_rad[:, None]
        return States(*moved.reshape(4, -1, start_rad.shape[1]))

    def series(self, name: str, start_rad: Floats, free: Floats, periods: int) -> Series:
        """One member: its start (N,) and free numbers (F, N)."""
        cosine, sine = self.basis @ free
        return Series(name, start_rad, cosine.T, sine.T, self.period_s, periods)
