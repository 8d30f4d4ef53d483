"""Weighted linear least squares with priors, used by every estimator.

The result is the solution with covariance, rank and null space. One call is a QR of the scaled, whitened columns by
blocks of rows, and an SVD of the small factor. Time and memory grow linearly with the rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

TOLERANCE = 1e-7
#: Length of a column over that of the longest, below which it counts as zero.
NOTHING = 1e-13
#: Rows that are reduced at once: with the columns of one group they stay in the cache of a core.
_CHUNK = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Gaussian prior of the parameters.

    `mean`, `std` (p,) of each, infinite = free; `rows` (k, p) and `right` (k,): further combinations that are known,
    `rows @ x = right` with unit standard deviation.
    """

    mean: Floats
    std: Floats
    rows: Floats
    right: Floats

    @staticmethod
    def free(count: int) -> Prior:
        """Return a prior without information."""
        return Prior(np.zeros(count), np.full(count, np.inf), np.zeros((0, count)), np.zeros(0))

    def with_std(self, index: NDArray[np.int_], std: Floats) -> Prior:
        """Return a copy with another standard deviation of some parameters."""
        changed = self.std.copy()
        changed[index] = std
        return Prior(self.mean, changed, self.rows, self.right)

    def freed(self, index: NDArray[np.int_]) -> Prior:
        """Return a copy without information on some parameters."""
        if not len(index):
            return self
        rows = self.rows.copy()
        rows[:, index] = 0.0
        return replace(self.with_std(index, np.full(len(index), np.inf)), rows=rows)

    def beside(self, other: Prior) -> Prior:
        """Return the joint prior of these parameters and of further ones behind them."""
        own = np.pad(self.rows, ((0, 0), (0, len(other.std))))
        more = np.pad(other.rows, ((0, 0), (len(self.std), 0)))
        parts = zip((self.mean, self.std, self.right), (other.mean, other.std, other.right), strict=True)
        mean, std, right = (np.concatenate(pair) for pair in parts)
        return Prior(mean, std, np.vstack([own, more]), right)

    @property
    def precision(self) -> Floats:
        """Precision matrix (p, p) of the prior."""
        return np.diag(self.std**-2.0) + self.rows.T @ self.rows

    @property
    def pull(self) -> Floats:
        """Right side (p,) of the normal equations that belongs to the precision."""
        return self.mean * self.std**-2.0 + self.rows.T @ self.right

    def penalty(self, value: Floats) -> float:
        """Squared distance of parameters (p,) from the prior mean, in its standard deviations."""
        apart, tied = (value - self.mean) / self.std, self.rows @ value - self.right
        return float(apart @ apart + tied @ tied)

    def stds(self, index: NDArray[np.int_]) -> Floats:
        """Standard deviations (k,) of parameters that are independent of all others in the prior."""
        own = self.rows[:, index]
        return np.sqrt(np.diag(np.linalg.inv(np.diag(self.std[index] ** -2.0) + own.T @ own)))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Least squares solution with covariance, rank and null space.

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
    basis : Basis
        Whitened data rows in an orthonormal basis.
    misfit : float
        The minimum.
    log_determinant : float
        Of the information matrix, its determined part.
    """

    value: Floats
    covariance: Floats
    null: Floats
    scale: Floats
    residual: Floats
    basis: Basis
    misfit: float
    log_determinant: float

    @property
    def rank(self) -> int:
        """Number of parameters that rows and priors determine."""
        return self.basis.inverse.shape[1]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the scaled, whitened columns with their priors."""
        return condition(self.basis.inverse, self.scale)


def solve(
    design: Floats | ByGroup,
    target: Floats,
    weight: Floats,
    prior: Prior | None = None,
    tolerance: float = TOLERANCE,
) -> Solution:
    """Minimise `|weight (target - design x)|^2 + |(x - mean) / std|^2 + |right - rows x|^2`.

    Parameters
    ----------
    design : array of shape (n, p), or its parts by group
    target : array of shape (n,)
    weight : array of shape (n,)
        One over the standard deviation of each row.
    prior : Prior, optional
        Free if left out.
    tolerance : float
        Relative size below which a singular value of the scaled columns counts as zero.
    """
    parts = design if isinstance(design, ByGroup) else ByGroup.of(design)
    p = parts.width
    prior = Prior.free(p) if prior is None else prior
    held = np.flatnonzero(np.isfinite(prior.std))
    own = np.column_stack([np.eye(p), prior.mean])[held] / prior.std[held, None]
    known = np.vstack([own, np.column_stack([prior.rows, prior.right])])
    count = sum(min(len(part), len(columns) + 1) for part, columns, _ in parts.parts)
    tall, end = np.vstack([known, np.zeros((count, p + 1))]), len(known)
    for part, columns, values in parts.parts:
        small = np.empty((len(part), len(columns) + 1))
        np.multiply(values, weight[part, None], out=small[:, :-1])
        np.multiply(target[part], weight[part], out=small[:, -1])
        if len(part) > len(columns) + 1:
            small = np.asarray(np.linalg.qr(small, mode="r"))
        first, end = end, end + len(small)
        tall[first:end, columns], tall[first:end, p] = small[:, :-1], small[:, -1]
    scale = np.sqrt(np.einsum("ij,ij->j", tall[:, :p], tall[:, :p]))
    scale[scale <= NOTHING * scale.max(initial=0.0)] = 1.0  # rounding of a column that is zero is not a column
    tall[:, :p] /= scale
    triangle = np.zeros((p + 1, p + 1))
    short = np.asarray(np.linalg.qr(tall, mode="r"))
    triangle[: len(short)] = short
    factor, right = triangle[:p, :p], triangle[:, p]
    size = np.abs(np.diagonal(factor))
    sound = p > 0 and bool(size.min() > tolerance * size.max())
    inverse = scipy.linalg.solve_triangular(factor, np.eye(p)) if sound else factor
    along, null = right[:p], np.zeros((p, 0))
    # the ratio of the singular values is p times the condition in the 1-norm at most: all of them count below
    if not (sound and p * np.linalg.norm(factor, 1) * np.linalg.norm(inverse, 1) * tolerance < 1.0):
        # Full SVD; divide and conquer fails on rare finite matrices, the slower iteration does not
        try:
            left, size, turned = np.linalg.svd(factor)
        except np.linalg.LinAlgError:
            left, size, turned = scipy.linalg.svd(factor, lapack_driver="gesvd")
        keep = size > tolerance * size.max(initial=0.0)
        size, inverse, null = size[keep], turned[keep].T / size[keep], turned[~keep].T / scale[:, None]
        along = left[:, keep].T @ right[:p]
    missed = right - triangle[:, :p] @ (inverse @ along)
    inverse = inverse / scale[:, None]
    value = inverse @ along
    return Solution(
        value=value,
        covariance=inverse @ inverse.T,
        null=null,
        scale=scale,
        residual=target - parts.times(value),
        basis=Basis(parts, weight, inverse),
        misfit=float(missed @ missed),
        log_determinant=float(2.0 * np.sum(np.log(size)) + 2.0 * np.sum(np.log(scale))),
    )


def condition(inverse: Floats, scale: Floats) -> float:
    """Return the condition of scaled columns, from parameters per unit of a basis (p, rank) and column lengths (p,)."""
    size = np.linalg.svd(inverse * scale[:, None], compute_uv=False)
    return float(size[0] / size[-1]) if len(size) else np.inf


@dataclass(frozen=True, slots=True, eq=False)
class ByGroup:
    """Columns (n, p) of a design, stored by group: rows of one axis, or one kind, use few of all columns.

    Attributes
    ----------
    count, width : int
        Rows n and columns p.
    parts : tuple of (rows, columns, values)
        Chunks of rows of one group, and the columns that are not zero in all rows of that group.
    """

    count: int
    width: int
    parts: tuple[tuple[Ints, Ints, Floats], ...]

    @staticmethod
    def of(design: Floats, group: Ints | None = None) -> ByGroup:
        """Build from an array (n, p) and the group (n,) of each row; without groups all rows use all columns."""
        every = np.arange(design.shape[1])
        rows_of = [np.arange(len(design))] if group is None else [np.flatnonzero(group == g) for g in np.unique(group)]
        parts = (part for rows in rows_of for part in _parts(rows, every, design[rows], keep=group is None))
        return ByGroup(len(design), design.shape[1], tuple(parts))

    @staticmethod
    def of_groups(count: int, width: int, groups: Iterable[tuple[Ints, Ints, Floats]]) -> ByGroup:
        """Build from `count` rows and `width` columns, with rows (m,), columns (c,) and values (m, c) of each group."""
        return ByGroup(count, width, tuple(part for group in groups for part in _parts(*group)))

    def beside(self, more: Floats) -> ByGroup:
        """Return a copy with further columns (n, k) behind."""
        parts = []
        for rows, columns, values in self.parts:
            own = more[rows]
            used = np.flatnonzero(own.any(axis=0))
            parts.append((rows, np.append(columns, self.width + used), np.hstack([values, own[:, used]])))
        return ByGroup(self.count, self.width + more.shape[1], tuple(parts))

    @property
    def bytes(self) -> int:
        """Memory of the values in bytes."""
        return sum(values.nbytes for _, _, values in self.parts)

    @property
    def dense(self) -> Floats:
        """The array (n, p)."""
        out = np.zeros((self.count, self.width))
        for rows, columns, values in self.parts:
            out[np.ix_(rows, columns)] = values
        return out

    def times(self, value: Floats) -> Floats:
        """Product (n, ...) with parameters (p, ...)."""
        out = np.zeros((self.count, *value.shape[1:]))
        for rows, columns, values in self.parts:
            out[rows] = values @ value[columns]
        return out

    def across(self, values: Floats, at: Ints | None = None) -> Floats:
        """Product (p, ...) of the transposed columns with rows (n, ...), or with those `at` (m,): whole groups."""
        out = np.zeros((self.width, *values.shape[1:]))
        place = np.full(self.count, -1)
        place[slice(None) if at is None else at] = np.arange(len(values))
        for rows, columns, own in self.parts:
            if place[rows[0]] >= 0:
                out[columns] += own.T @ values[place[rows]]
        return out

    def across_by(self, values: Floats, at: Ints, place: Ints, count: int) -> Floats:
        """Product of the transposed columns with rows `at` (m, k), which contain groups, summed by place: (count, p,
        k).

        Of each group there is one row at a place (m,) at most.
        """
        out = np.zeros((count, self.width, values.shape[1]))
        number = np.full(self.count, -1)
        number[at] = np.arange(len(at))
        for rows, columns, own in self.parts:
            here = number[rows]
            own, here = own[here >= 0], here[here >= 0]
            out[place[here][:, None], columns] += own[:, :, None] * values[here][:, None, :]
        return out

    def first(self, width: int) -> ByGroup:
        """Return the first columns only."""
        parts = [(rows, columns[columns < width], values[:, columns < width]) for rows, columns, values in self.parts]
        return ByGroup(self.count, width, tuple(parts))


def _parts(rows: Ints, columns: Ints, values: Floats, *, keep: bool = False) -> Iterator[tuple[Ints, Ints, Floats]]:
    """Chunks of one group, without columns that are zero in all of its rows unless they are to be kept."""
    used = slice(None) if keep else np.flatnonzero(values.any(axis=0))
    for first in range(0, len(rows), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        yield rows[chunk], columns[used], np.ascontiguousarray(values[chunk, used])


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Measured rows of an orthonormal basis of weighted columns with their prior rows: `weight columns inverse`.

    Attributes
    ----------
    rows : ByGroup
    weight : array of shape (n,)
    inverse : array of shape (p, rank)
    """

    rows: ByGroup
    weight: Floats
    inverse: Floats

    @property
    def dense(self) -> Floats:
        """Return the basis as a dense array (n, rank)."""
        out = np.zeros((self.rows.count, self.inverse.shape[1]))
        for rows, columns, values in self.rows.parts:
            out[rows] = (values * self.weight[rows, None]) @ self.inverse[columns]
        return out

    def of(self, at: Ints) -> Floats:
        """Rows `at` (m,) of the basis (m, rank), in ascending order."""
        out = np.zeros((len(at), self.inverse.shape[1]))
        for rows, columns, values in self.rows.parts:
            here = np.isin(rows, at, assume_unique=True)
            weighted = values[here] * self.weight[rows[here], None]
            out[np.searchsorted(at, rows[here])] = weighted @ self.inverse[columns]
        return out

    def across(self, values: Floats, at: Ints | None = None) -> Floats:
        """Product (rank, ...) of the transposed basis with rows (n, ...) or those `at` (m,), as of `ByGroup`."""
        weight = self.weight if at is None else self.weight[at]
        return np.asarray(self.inverse.T @ self.rows.across((values.T * weight).T, at), dtype=float)

    def times(self, value: Floats) -> Floats:
        """Product (n, ...) with coordinates (rank, ...)."""
        return np.asarray((self.rows.times(self.inverse @ value).T * self.weight).T, dtype=float)

    def left(self, values: Floats) -> Floats:
        """Component of rows (n, ...) outside the basis."""
        return values - self.times(self.across(values))

    @property
    def leverage(self) -> Floats:
        """Leverage (n,) of each row, 0 to 1."""
        out, covariance = np.zeros(self.rows.count), self.inverse @ self.inverse.T
        for rows, columns, values in self.rows.parts:
            spread = values @ covariance[columns[:, None], columns]
            out[rows] = self.weight[rows] ** 2 * np.einsum("ij,ij->i", spread, values)
        return out


class WithNull(Protocol):
    """Solution with null space and scale (`Solution`)."""

    @property
    def null(self) -> Floats:
        """Directions (p, k) that neither rows nor priors determine."""
        ...

    @property
    def scale(self) -> Floats:
        """Length (p,) of each whitened column."""
        ...


def identifiable_stds(solution: Solution, directions: Floats) -> Floats:
    """Return the standard deviations (k,) of linear functions (k, p) of the parameters; NaN where not determined."""
    std = np.sqrt(np.einsum("kp,pq,kq->k", directions, solution.covariance, directions))
    return np.where(determined(solution, directions), std, np.nan)


def determined(solution: WithNull, directions: Floats, tolerance: float = 1e-5) -> NDArray[np.bool_]:
    """Mask (k,) of linear functions (k, p) of the parameters that rows and priors determine."""
    moved = np.abs(directions @ solution.null).max(axis=1, initial=0.0)
    return np.asarray(moved <= tolerance * np.linalg.norm(directions / solution.scale, axis=1))
