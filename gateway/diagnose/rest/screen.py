"""Screening of all candidates, linearised about a fit, with the fitted parameters projected out.

A candidate is weighed by the small Gram matrix of its projected columns, so no array of rows by candidates is needed.
Change points (`Term.switched`) share the columns of one permanent term: the columns of a change are zero before its
time and equal to the permanent ones after it. The Gram matrices of all times are therefore cumulative sums over the
visits, from the last one backwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.linear import Fit, RestProblem, plausible_spread, term_columns
from gateway.identify.solve import Basis, ByGroup, Prior, solve
from gateway.model.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Times [s] that are equal.
_SAME_S = 1e-9
#: Relative size below which a combination of columns counts as zero.
_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class CandidateColumns:
    """Derivative of the modelled rows by the parameters of one candidate.

    Attributes
    ----------
    rows : (m,) rows that the candidate changes
    values : (m, k)
    squares : (3 N, k) sum of squares by noise group
    changed : noise groups that the candidate changes; candidates with equal groups have equal rows
    """

    rows: Ints
    values: Floats
    squares: Floats
    changed: bytes

    @staticmethod
    def of(problem: RestProblem, dense: Floats) -> CandidateColumns:
        """Build from all rows (rows, k); noise groups that are zero are left out."""
        squares = np.stack([problem.by_group(column) for column in dense.T**2], axis=1)
        changed = (squares != 0.0).any(axis=1)
        rows = np.flatnonzero(changed[problem.group])
        return CandidateColumns(rows, dense[rows], squares, changed.tobytes())

    def size(self, precision: Floats) -> Floats:
        """Length (..., k) of the columns weighted by the precision (..., 3 N) of each noise group."""
        return np.sqrt(precision @ self.squares)


@dataclass(slots=True, eq=False)
class Derivatives:
    """Cache of the derivatives of one search's candidates about one fit.

    Attributes
    ----------
    problem : RestProblem
    about : Fit
    others : derivatives of candidates that do not depend on the modelled torque, about any fit; None = about this one
    """

    problem: RestProblem
    about: Fit
    others: Derivatives | None = None
    known: dict[Term, CandidateColumns] = field(default_factory=dict)

    def __getitem__(self, term: Term) -> CandidateColumns:
        if self.others is not None and not term.modelled:
            return self.others[term]
        if term not in self.known:
            self.known[term] = CandidateColumns.of(self.problem, columns_of(self.problem, self.about, term))
        return self.known[term]


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """Linearised candidates.

    Attributes
    ----------
    terms : candidates with an effect on the rows
    log_bayes : (candidates,) log Bayes factor of adding the candidate alone
    weighted : weighted columns (rows, k) of a candidate, in units of the prior spread
    spread : prior spread (k,) of the linear parameters of each candidate
    basis : orthonormal basis of the fit that they are projected from
    residual : (rows,) weighted, projected residual
    """

    terms: tuple[Term, ...]
    log_bayes: Floats
    weighted: Callable[[int], Floats]
    spread: tuple[Floats, ...]
    basis: Basis
    residual: Floats

    def projected(self, index: int) -> tuple[Floats, Floats, Floats]:
        """Projected columns (rows, k) of a candidate, their Gram matrix with prior rows (k, k), and score (k,)."""
        columns = self.weighted(index)
        left = self.basis.left(columns)
        return left, columns.T @ left, columns.T @ self.residual

    def estimate(self, index: int) -> Floats:
        """Linear parameters (k,) of a candidate, estimated with their prior."""
        _, gram, score = self.projected(index)
        return self.spread[index] * np.linalg.solve(gram + np.eye(len(gram)), score)


def screen(problem: RestProblem, fit: Fit, terms: Sequence[Term], std: Floats, derivatives: Derivatives) -> Screen:
    """Linearise candidates about a fit.

    Parameters
    ----------
    problem : RestProblem
    fit : Fit
        The hypothesis that candidates are added to.
    terms : candidates
    std : array of shape (3 N,)
        Noise per group that weighs the rows.
    derivatives : Derivatives
    """
    weight = 1.0 / replace(fit.noise, std=std).of_rows(problem)
    precision = np.stack([fit.noise.std, std]) ** -2.0
    basis, residual = projection(fit, fit.columns, fit.prior_std, weight)
    families: dict[Term, list[int]] = {}
    by_groups: dict[bytes, list[int]] = {}
    spread: dict[int, Floats] = {}
    for position, term in enumerate(terms):
        switched = term.switched()
        if switched is not None and switched[0] in families:
            spread[position] = spread[families[switched[0]][0]]
            families[switched[0]].append(position)
            continue
        columns = derivatives[term if switched is None else switched[0]]
        spread[position], size = _spread(problem, term, columns, precision)
        if switched is not None:
            families[switched[0]] = [position]
        elif np.isfinite(size).all() and float(np.linalg.norm(size)) >= REST.inert:
            by_groups.setdefault(columns.changed, []).append(position)
    # position, Gram matrix (k, k) and score (k,) of each candidate, by its number of columns, in units of their prior
    weighed: dict[int, list[tuple[int, Floats, Floats]]] = {}
    for members in by_groups.values():
        rows = derivatives[terms[members[0]]].rows
        blocks = [derivatives[terms[k]].values[:, : len(spread[k])] * (weight[rows, None] * spread[k]) for k in members]
        together = np.hstack(blocks)
        taken, score = basis.across(together, rows), residual[rows] @ together
        ends = np.cumsum([block.shape[1] for block in blocks])
        for position, block, end in zip(members, blocks, ends, strict=True):
            own = slice(end - block.shape[1], end)
            gram = block.T @ block - taken[:, own].T @ taken[:, own]
            weighed.setdefault(len(gram), []).append((position, gram, score[own]))
    for family, members in families.items():
        columns = derivatives[family]
        scaled = columns.values * (weight[columns.rows, None] * spread[members[0]])
        times = np.array([switch_s(terms[position]) for position in members])
        for change, gram, score in _changes(problem, times, scaled, columns.rows, basis, residual):
            weighed.setdefault(len(gram), []).append((members[change], gram, score))
    tried = [tuple(zip(*candidates, strict=True)) for candidates in weighed.values()]
    place = np.array([position for positions, _, _ in tried for position in positions], dtype=int)
    factors = [log_bayes_factor(np.array(grams), np.array(scores)) for _, grams, scores in tried]
    order = np.argsort(place)
    kept, log_bayes = place[order], np.concatenate([np.zeros(0), *factors])[order]
    chosen = tuple(terms[position] for position in kept)

    def weighted(index: int) -> Floats:
        term = chosen[index]
        switched = term.switched()
        columns = derivatives[term if switched is None else switched[0]]
        own = spread[int(kept[index])]
        out = np.zeros((len(weight), len(own)))
        out[columns.rows] = columns.values[:, : len(own)] * (weight[columns.rows, None] * own)
        if switched is not None:
            out[problem.rows.time_s[problem.visit] < switched[1] - _SAME_S] = 0.0
        return out

    return Screen(chosen, log_bayes, weighted, tuple(spread[int(k)] for k in kept), basis, residual)


def switch_s(term: Term) -> float:
    """Time [s] at which a change point takes effect."""
    switched = term.switched()
    return -np.inf if switched is None else switched[1]


def _spread(problem: RestProblem, term: Term, columns: CandidateColumns, precision: Floats) -> tuple[Floats, Floats]:
    """Prior standard deviation (k,) of the linear parameters of a candidate, and length (k,) of the scaled columns.

    The first `precision` (2, 3 N) of the noise groups is that of the fit, the second weighs the rows.
    """
    seen, weighted = columns.size(precision)
    spread = plausible_spread(term, seen / np.sqrt(max(len(problem.rows), 1)))[: term.count]
    return spread, weighted[: term.count] * spread


def _changes(
    problem: RestProblem, times_s: Floats, scaled: Floats, rows: Ints, basis: Basis, residual: Floats
) -> Iterator[tuple[int, Floats, Floats]]:
    """Index, Gram matrix and score of the columns of each change point; those without an effect are left out.

    Parameters
    ----------
    problem : RestProblem
    times_s : (changes,)
    scaled : (m, k) weighted columns of these `rows`, in prior standard deviations, for a permanent term
    basis, residual : of the projection
    """
    when = problem.rows.time_s
    latest = np.argsort(-when, kind="stable")
    place = np.argsort(latest)[problem.visit[rows]]
    count, width = len(when), scaled.shape[1]
    products = np.column_stack([scaled * scaled[:, [k]] for k in range(width)] + [scaled * residual[rows, None]])
    sums = np.stack([np.bincount(place, weights=column, minlength=count) for column in products.T], axis=1)
    by_visit = basis.rows.across_by(scaled * basis.weight[rows, None], rows, place, count)
    last = np.searchsorted(-when[latest], -(times_s - _SAME_S), side="right") - 1
    acting = np.flatnonzero(last >= 0)
    sums = np.asarray(np.cumsum(sums, axis=0)[last[acting]], dtype=float)
    taken = basis.inverse.T @ np.cumsum(by_visit, axis=0)[last[acting]]
    gram = sums[:, : width * width].reshape(-1, width, width)
    acts = np.sqrt(np.trace(gram, axis1=1, axis2=2)) >= REST.inert
    gram = gram - np.matmul(taken.transpose(0, 2, 1), taken)
    for change in np.flatnonzero(acts):
        yield int(acting[change]), gram[change], sums[change, width * width :]


def columns_of(problem: RestProblem, fit: Fit, term: Term) -> Floats:
    """Derivative (rows, k) by the parameters of an effect that is not in the fit, at their start values."""
    return term_columns(problem, fit, fit.noise, term, np.array(term.start, dtype=float))


def projection(fit: Fit, columns: ByGroup, prior_std: Floats, weight: Floats) -> tuple[Basis, Floats]:
    """Orthonormal basis of the weighted columns of a fit, all or the first ones, with their prior rows.

    Also returns the weighted residual (rows,) after one further step of the fit.
    """
    problem, width = fit.problem, columns.width
    centre = np.concatenate([np.array(term.start) for term in fit.terms]) if fit.terms else np.zeros(0)
    pull = np.concatenate([problem.common_mean - fit.common, centre - fit.flat_theta])[:width]
    pull[problem.taken_over(fit.terms)] = 0.0
    rows = np.pad(problem.prior_rows, ((0, 0), (0, width - problem.n_common)))
    prior = Prior(pull, prior_std, rows, problem.prior_target - problem.prior_rows @ fit.common)
    solution = solve(columns, fit.residual, weight, prior, _TOLERANCE)
    return solution.basis, solution.residual * weight


def log_bayes_factor(gram: Floats, score: Floats) -> Floats:
    """Log Bayes factors (..) of adding columns with unit prior: `b' (G + 1)^-1 b / 2 - log det(G + 1) / 2`.

    Parameters
    ----------
    gram : array of shape (.., k, k)
    score : array of shape (.., k)
    """
    factor = np.linalg.cholesky(gram + np.eye(gram.shape[-1]))
    half = np.linalg.solve(factor, score[..., None])[..., 0]
    pivots = np.diagonal(factor, axis1=-2, axis2=-1)
    return np.asarray(0.5 * np.sum(half**2, axis=-1) - np.sum(np.log(pivots), axis=-1))


def pair_log_bayes(view: Screen, first: Ints, second: Ints) -> Floats:
    """Log Bayes factors of adding candidates in pairs (index arrays of equal length)."""
    chosen = np.unique(np.concatenate([first, second]))
    columns = [view.weighted(int(index)) for index in chosen]
    sizes = np.array([block.shape[1] for block in columns])
    tall = np.hstack(columns)
    taken = view.basis.across(tall)
    total, width = tall.shape[1], int(sizes.max())
    gram = np.zeros((total + 1, total + 1))
    gram[:total, :total] = tall.T @ tall - taken.T @ taken
    score = np.append(tall.T @ view.residual, 0.0)
    start = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    offsets = np.arange(width)
    table = np.where(offsets < sizes[:, None], start[:, None] + offsets, total)
    index = np.concatenate([table[np.searchsorted(chosen, first)], table[np.searchsorted(chosen, second)]], axis=1)
    blocks = gram[index[:, :, None], index[:, None, :]]
    same = np.eye(2 * width, dtype=bool)
    blocks[:, same] += 1.0
    right = score[index]
    solved = np.linalg.solve(blocks, right[:, :, None])[:, :, 0]
    _, log_det = np.linalg.slogdet(blocks)
    return 0.5 * np.einsum("pk,pk->p", right, solved) - 0.5 * log_det
