"""What the model lacks at a place: effects that rest rows of one place share, with standard deviations from the rows.

A half-sum or a one-sided reading contains `d + d' + eps`. The effect `d` is the same in all visits of a place, whatever
the load; `d'` is the same in its visits under one load; `eps` is of one visit. Each is normal with a
standard deviation by noise group. Without `d` the fit is least squares of all rows; with `d` unbounded it is the
difference of loads at equal places. The rows decide between them (`docs/decisions/one-model-of-a-reading.md`).

The standard deviations maximise the restricted likelihood with weak priors. Rows are made independent by a map that
works on the means of cells (rows of one place and load), so time and memory are linear in the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.optimize import minimize

from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.identify.solve import ByGroup, Prior, solve

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Smallest and largest standard deviation over the start value of the noise.
_RANGE: Final = (1e-3, 1e3)
#: Steps of the search for the maximum, and the relative change of the likelihood at which it ends.
_STEPS: Final = 60
_SETTLED: Final = 1e-7


@dataclass(frozen=True, eq=False)
class Cells:
    """Rows of one noise group, by place and load.

    Attributes
    ----------
    rows, cell : (m,) rows of the group, ascending, and the cell of each
    place : (cells,) place of each cell
    root : (cells,) root of the number of rows of each cell
    """

    rows: Ints
    cell: Ints
    place: Ints
    root: Floats

    @cached_property
    def means(self) -> scipy.sparse.csr_array:
        """Sparse matrix (cells, m): mean of each cell times the root of its number of rows."""
        return scipy.sparse.csr_array((1.0 / self.root[self.cell], (self.cell, np.arange(len(self.rows)))))

    @cached_property
    def sums(self) -> scipy.sparse.csr_array:
        """Sparse matrix (places, cells): sum over the cells of each place."""
        return scipy.sparse.csr_array((np.ones(len(self.place)), (self.place, np.arange(len(self.place)))))


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Noise group (rows,) of each row, and the cells of each group in which rows share a place."""

    group: Ints
    cells: Mapping[int, Cells]

    @staticmethod
    def of(group: Ints, place: Ints, load: Ints, alone: Mask) -> Places:
        """Sort rows by group, place and load, each of shape (rows,); rows that are `alone` share no place."""
        out, loads = {}, int(load.max(initial=0)) + 1
        for number in np.unique(group[~alone]).tolist():
            rows = np.flatnonzero((group == number) & ~alone)
            cells, cell, count = np.unique(loads * place[rows] + load[rows], return_inverse=True, return_counts=True)
            places, at = np.unique(cells // loads, return_inverse=True)
            if len(places) < len(rows):
                out[number] = Cells(rows, cell, at, np.sqrt(count))
        return Places(group, out)


@dataclass(frozen=True, slots=True, eq=False)
class _Covariance:
    """Covariance of the rows of one noise group: `own` of a row, `load` of a cell, `place` of a place [Nm2].

    With the roots `v` of the counts, the scaled means of the cells of a place have the covariance
    `diag(size) + place v v'`, and the deviations from these means `own`.
    """

    cells: Cells
    own: float
    place: float
    load: float

    @property
    def size(self) -> Floats:
        """Variance (cells,) of the scaled means, without what a place shares."""
        return self.own + self.load * self.cells.root**2

    @property
    def scaled(self) -> tuple[Floats, Floats]:
        """Roots `v` over those of the sizes (cells,), and the sum of their squares (places,)."""
        scaled = self.cells.root / np.sqrt(self.size)
        return scaled, np.asarray(self.cells.sums @ scaled**2)

    @property
    def log_determinant(self) -> float:
        alone = len(self.cells.rows) - len(self.cells.root)
        return float(alone * np.log(self.own) + np.log(self.size).sum() + np.log1p(self.place * self.scaled[1]).sum())

    def whitened(self, values: Floats, *, transposed: bool = False) -> Floats:
        """Multiply rows (m, k) by the map `W`, whose `W' W` is the inverse of the covariance, or by `W'`."""
        cells, (scaled, total) = self.cells, self.scaled
        along = (1.0 - (1.0 + self.place * total) ** -0.5) / total
        root, mean = np.sqrt(self.size)[:, None], cells.means @ values
        part = mean if transposed else mean / root
        part = part - scaled[:, None] * (along[:, None] * (cells.sums @ (scaled[:, None] * part)))[cells.place]
        part = part / root if transposed else part
        own = np.sqrt(self.own)
        return values / own + ((part - mean / own) / cells.root[:, None])[cells.cell]

    def slopes(self, moved: Floats, basis: Floats) -> Floats:
        """Twice the derivative (3,) of the restricted log likelihood by own, place and load.

        Parameters
        ----------
        moved : array of shape (m,)
            Inverse covariance times residual.
        basis : array of shape (m, rank)
            Inverse covariance times columns, in the directions whose posterior covariance is the unit matrix.
        """
        cells, (scaled, total) = self.cells, self.scaled
        left = 1.0 + self.place * total
        inverse = (1.0 - scaled**2 * (self.place / left)[cells.place]) / self.size
        means = cells.means @ np.column_stack([moved, basis])
        by_place = cells.sums @ (self.cells.root[:, None] * means)
        own = (len(moved) - len(inverse)) / self.own + inverse.sum()
        load = cells.root**2 @ (inverse + np.sum(means[:, 1:] ** 2, axis=1) * -1.0)
        place = np.sum(total / left) - np.sum(by_place[:, 1:] ** 2)
        return np.array(
            [
                moved @ moved - (own - np.sum(basis**2)),
                by_place[:, 0] @ by_place[:, 0] - place,
                cells.root**2 @ means[:, 0] ** 2 - load,
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlaceEffects:
    """Variances [Nm2] (3, 3 N) of each noise group: of a row alone, of a place, of a place under one load."""

    variance: Floats

    @staticmethod
    def about(start: Floats, std: Floats) -> PlaceEffects:
        """Guess from the noise (3 N,) by approach directions and that of a fit without effects."""
        more = np.maximum(std**2 - start**2, 0.5 * start**2)
        return PlaceEffects(np.stack([start**2, more, more]))

    @property
    def std(self) -> Floats:
        """Standard deviation (3 N,) of a row."""
        return np.sqrt(self.variance.sum(axis=0))

    def of_groups(self, places: Places) -> Iterator[tuple[Ints, _Covariance | None, float]]:
        """Iterate over the groups: rows, covariance where they share places, variance of a row alone."""
        for group in np.unique(places.group).tolist():
            own, place, load = self.variance[:, group].tolist()
            cells = places.cells.get(group)
            rows = np.flatnonzero(places.group == group) if cells is None else cells.rows
            yield rows, None if cells is None else _Covariance(cells, own, place, load), own

    def whitened(self, places: Places, values: Floats, *, transposed: bool = False) -> Floats:
        """Multiply rows (rows, ...) by the map that makes them independent with unit variance, or its transpose."""
        flat = values.reshape(len(values), -1)
        out = np.empty_like(flat)
        for rows, shared, own in self.of_groups(places):
            out[rows] = (
                flat[rows] / np.sqrt(own) if shared is None else shared.whitened(flat[rows], transposed=transposed)
            )
        return out.reshape(values.shape)

    def whitened_columns(self, places: Places, columns: ByGroup) -> ByGroup:
        """Multiply columns by the map that makes the rows independent with unit variance."""
        groups = []
        for rows, shared, own in self.of_groups(places):
            parts = [part for part in columns.parts if places.group[part[0][0]] == places.group[rows[0]]]
            used = np.unique(np.concatenate([at for _, at, _ in parts]))
            values = np.zeros((len(rows), len(used)))
            for part, at, own_values in parts:
                values[np.ix_(np.searchsorted(rows, part), np.searchsorted(used, at))] = own_values
            groups.append((rows, used, values / np.sqrt(own) if shared is None else shared.whitened(values)))
        return ByGroup.of_groups(columns.count, columns.width, groups)


def likeliest_effects(
    places: Places,
    columns: ByGroup,
    target: Floats,
    prior: Prior,
    begin: PlaceEffects,
    *,
    start: Floats,
    least: Floats,
    tolerance: float,
) -> PlaceEffects:
    """Return the variances that maximise the restricted likelihood of linearised rows.

    The variance of a row alone has an inverse gamma prior of a few rows at the start value of the noise. The standard
    deviations of places have half-Cauchy priors with the scale of a half-sum, that of a row over the root of 2.

    Parameters
    ----------
    places : Places
    columns : of shape (rows, p)
    target : array of shape (rows,)
    prior : Prior
        Of the p parameters.
    begin : PlaceEffects
        Where the search begins; for a group without two loads at a place, or without repeats, these are not used.
    start, least : arrays of shape (3 N,)
        Standard deviation of a row alone by approach directions and repeats, and its smallest value.
    tolerance : float
        As of `solve`.
    """
    groups, square = np.unique(places.group), start**2
    free = np.zeros((3, len(square)), dtype=bool)
    free[0, groups] = True
    for group, cells in places.cells.items():
        free[1:, group] = np.any(cells.sums.sum(axis=1) > 1.0), np.any(cells.root > 1.0)
    half = REST_MODEL.noise_weight / 2.0

    def negative(logs: Floats) -> tuple[float, Floats]:
        over = np.zeros(free.shape)
        over[free] = np.exp(logs)
        effects = PlaceEffects(over * square)
        solution = solve(
            effects.whitened_columns(places, columns),
            effects.whitened(places, target),
            np.ones(len(target)),
            prior,
            tolerance,
        )
        moved = effects.whitened(places, solution.residual, transposed=True)
        basis = effects.whitened(places, solution.basis.dense, transposed=True)
        value, slopes = -0.5 * (solution.misfit + solution.log_determinant), np.zeros(free.shape)
        for rows, shared, own in effects.of_groups(places):
            group, here = places.group[rows[0]], basis[rows]
            if shared is None:
                value -= 0.5 * len(rows) * np.log(own)
                slopes[0, group] = moved[rows] @ moved[rows] - len(rows) / own + np.sum(here**2)
            else:
                value -= 0.5 * shared.log_determinant
                slopes[:, group] = shared.slopes(moved[rows], here)
        slopes *= 0.5 * effects.variance
        alone = over[0, groups]
        value -= half * float(np.sum(np.log(alone) + 1.0 / alone))
        slopes[0, groups] += half * (1.0 / alone - 1.0)
        for kind in (1, 2):
            at = np.flatnonzero(free[kind])
            ratio = 2.0 * over[kind, at] / over[0, at]
            value += float(np.sum(0.5 * np.log(ratio) - np.log1p(ratio)))
            slope = 0.5 * (1.0 - ratio) / (1.0 + ratio)
            slopes[kind, at] += slope
            slopes[0, at] -= slope
        return -value, -slopes[free]

    low, high = (np.full(free.shape, 2.0 * np.log(bound)) for bound in _RANGE)
    low[0] = np.maximum(low[0], 2.0 * np.log(least / start))
    found = minimize(
        negative,
        np.log(begin.variance[free] / np.broadcast_to(square, free.shape)[free]),
        jac=True,
        method="L-BFGS-B",
        bounds=np.column_stack([low[free], high[free]]),
        options={"maxiter": _STEPS, "ftol": _SETTLED},
    )
    over = np.zeros(free.shape)
    over[free] = np.exp(found.x)
    return PlaceEffects(over * square)
