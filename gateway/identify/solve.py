"""The weighted linear problem that every estimator solves: columns, weights, priors in; solution and covariance out.

One call is a QR of the scaled, whitened columns and an SVD of its small factor: no copy of the data is kept, and it may
be called thousands of times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TOLERANCE = 1e-7
#: Length of a column, over that of the longest, below which it is the rounding of none.
NOTHING = 1e-13
_RIDGE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Gaussian knowledge of the parameters.

    `mean`, `std` (p,) of each, infinite = free; `rows` (k, p) and `right` (k,): further combinations that are known,
    `rows @ x = right` with unit standard deviation.
    """

    mean: Floats
    std: Floats
    rows: Floats
    right: Floats

    @staticmethod
    def free(count: int) -> Prior:
        """Nothing is known."""
        return Prior(np.zeros(count), np.full(count, np.inf), np.zeros((0, count)), np.zeros(0))

    def with_std(self, index: NDArray[np.int_], std: Floats) -> Prior:
        """The same, some parameters held to another standard deviation."""
        changed = self.std.copy()
        changed[index] = std
        return Prior(self.mean, changed, self.rows, self.right)

    @property
    def precision(self) -> Floats:
        """What is known as a matrix (p, p), the inverse of a covariance where it has one."""
        return np.diag(self.std**-2.0) + self.rows.T @ self.rows

    def stds(self, index: NDArray[np.int_]) -> Floats:
        """Standard deviations (k,) of parameters that no combination ties to others than each other."""
        own = self.rows[:, index]
        return np.sqrt(np.diag(np.linalg.inv(np.diag(self.std[index] ** -2.0) + own.T @ own)))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Least squares solution.

    Attributes
    ----------
    value : array of shape (p,)
        Of all solutions the shortest in scaled columns, where the rows leave a choice.
    covariance : array of shape (p, p)
        Of the part that the rows determine; see `null` for the rest.
    null : array of shape (p, p - rank)
        Directions that neither rows nor priors determine.
    scale : array of shape (p,)
        Length of each whitened column.
    residual : array of shape (n,)
        Target less model, in the target's unit.
    leverage : array of shape (n,)
        Share of each row's own noise that the fit takes up, 0 to 1.
    orthogonal : array of shape (n, rank)
        Whitened data rows in an orthonormal basis: the hat matrix is `orthogonal @ orthogonal.T`.
    rank : int
    misfit : float
        The minimum.
    condition : float
        Largest over smallest singular value of the scaled, whitened columns with their priors.
    log_determinant : float
        Of the information matrix, its determined part.
    """

    value: Floats
    covariance: Floats
    null: Floats
    scale: Floats
    residual: Floats
    leverage: Floats
    orthogonal: Floats
    rank: int
    misfit: float
    condition: float
    log_determinant: float


def solve(
    design: Floats, target: Floats, weight: Floats, prior: Prior | None = None, tolerance: float = TOLERANCE
) -> Solution:
    """Minimise `|weight (target - design x)|^2 + |(x - mean) / std|^2 + |right - rows x|^2`.

    Parameters
    ----------
    design : array of shape (n, p)
    target : array of shape (n,)
    weight : array of shape (n,)
        One over the standard deviation of each row.
    prior : Prior, optional
        Free if left out.
    tolerance : float
        Relative size below which a singular value of the scaled columns counts as zero.
    """
    n, p = design.shape
    prior = Prior.free(p) if prior is None else prior
    held = np.flatnonzero(np.isfinite(prior.std))
    big = np.zeros((n + len(held) + len(prior.rows), p))
    np.multiply(design, weight[:, None], out=big[:n])
    big[n + np.arange(len(held)), held] = 1.0 / prior.std[held]
    big[n + len(held) :] = prior.rows
    right = np.concatenate([target * weight, prior.mean[held] / prior.std[held], prior.right])
    scale = np.sqrt(np.einsum("ij,ij->j", big, big))
    scale[scale <= NOTHING * scale.max(initial=0.0)] = 1.0  # rounding of a column that is zero is not a column
    big /= scale
    q, r = np.linalg.qr(big)
    left, size, turned = _singular_values(r)
    keep = size > tolerance * size.max(initial=0.0)
    basis = left[:, : len(size)][:, keep]
    inverse = turned[: len(size)][keep].T / size[keep] / scale[:, None]
    orthogonal = q[:n] @ basis
    value = inverse @ (basis.T @ (q.T @ right))
    lost = np.concatenate([turned[: len(size)][~keep], turned[len(size) :]]).T / scale[:, None]
    kept = size[keep]
    left_over = right - big @ (value * scale)
    return Solution(
        value=value,
        covariance=inverse @ inverse.T,
        null=lost,
        scale=scale,
        residual=target - design @ value,
        leverage=np.einsum("ij,ij->i", orthogonal, orthogonal),
        orthogonal=orthogonal,
        rank=int(keep.sum()),
        misfit=float(left_over @ left_over),
        condition=float(kept[0] / kept[-1]) if len(kept) else np.inf,
        log_determinant=float(2.0 * np.sum(np.log(kept)) + 2.0 * np.sum(np.log(scale))),
    )


def solve_normal(information: Floats, right: Floats, mean: Floats, precision: Floats) -> tuple[Floats, Floats]:
    """The same minimum by the information matrix: many rows, all columns held by a prior, nothing left undetermined.

    Parameters
    ----------
    information : array of shape (p, p)
        Weighted columns by weighted columns.
    right : array of shape (p,)
        Weighted columns by the weighted target.
    mean, precision : arrays of shape (p,)
        Of the prior; precision 0 = free.

    Returns
    -------
    covariance (p, p), parameters (p,)
    """
    normal = information.copy()
    normal[np.diag_indices_from(normal)] += precision
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0] = 1.0
    normal /= scale
    normal /= scale[:, None]
    normal[np.diag_indices_from(normal)] += _RIDGE
    inverse: Floats = np.linalg.inv(normal) / scale / scale[:, None]
    return inverse, inverse @ (right + precision * mean)


def _singular_values(factor: Floats) -> tuple[Floats, Floats, Floats]:
    """Full SVD; divide and conquer fails on rare finite matrices, the slower iteration does not."""
    try:
        left, size, turned = np.linalg.svd(factor)
    except np.linalg.LinAlgError:
        left, size, turned = scipy.linalg.svd(factor, lapack_driver="gesvd")
    return left, size, turned


def determined(solution: Solution, directions: Floats, tolerance: float = 1e-5) -> NDArray[np.bool_]:
    """Which linear functions (k, p) of the parameters the rows and priors determine: shape (k,)."""
    moved = np.abs(directions @ solution.null).max(axis=1, initial=0.0)
    return np.asarray(moved <= tolerance * np.linalg.norm(directions / solution.scale, axis=1))
