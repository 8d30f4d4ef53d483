"""Parametrisation of Fourier series that start at rest: a start posture and free coefficients of every joint."""

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
    """Family of series with fixed harmonics and period that start at rest: speed and acceleration are zero at t = 0.

    A member is its start (N,) and free numbers (F, N), F = 2 (harmonics - 1): coordinates in the null space of both
    conditions, so that every member satisfies them.

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
        """Return the family of a period, evaluated at `instants` times in it."""
        order = np.arange(1.0, harmonics + 1)
        cosine, sine = null_space(order[None] ** 2), null_space(order[None])
        nothing = np.zeros_like(cosine)
        basis = np.stack([np.hstack([cosine, nothing]), np.hstack([nothing, sine])])
        columns = Series("", np.zeros(basis.shape[2]), basis[0].T, basis[1].T, period_s, 1)
        return cls(period_s, basis, np.stack(columns.at(np.arange(instants) * period_s / instants)))

    @property
    def free(self) -> int:
        """Number of free coefficients per joint."""
        return self.basis.shape[2]

    def states(self, start_rad: Floats, free: Floats) -> States:
        """Return the states of the members at all instants, one member after the other.

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
        """Return one member as a series, from its start (N,) and free numbers (F, N)."""
        cosine, sine = self.basis @ free
        return Series(name, start_rad, cosine.T, sine.T, self.period_s, periods)
