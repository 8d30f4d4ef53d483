"""Every candidate at once: linearised about a fit, with what its parameters take up projected out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.linear import Fit, RestProblem, spread_of, term_columns
from gateway.diagnose.rest.thresholds import REST
from gateway.identify.solve import NOTHING
from gateway.model.term import Term

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """Linearised candidates.

    Attributes
    ----------
    terms : candidates that do anything at all to the rows
    tall : (rows and prior rows, K) weighted columns in units of the prior spread, projected
    score : (K,) inner products with the weighted, projected residual
    start : first column of each candidate
    width : number of columns of each candidate
    log_bayes : (candidates,) log Bayes factor of adding the candidate alone
    projected : (rows, K) the part of `tall` that belongs to measured rows
    """

    terms: tuple[Term, ...]
    tall: Floats
    score: Floats
    start: NDArray[np.int_]
    width: NDArray[np.int_]
    log_bayes: Floats
    projected: Floats

    def pick(self, index: int) -> slice:
        """Columns of one candidate."""
        return slice(int(self.start[index]), int(self.start[index] + self.width[index]))


def screen(
    problem: RestProblem, fit: Fit, terms: Sequence[Term], std: Floats, raw: Mapping[Term, Floats] | None = None
) -> Screen:
    """Linearise candidates about a fit.

    Parameters
    ----------
    problem : RestProblem
    fit : Fit
        The hypothesis that candidates are added to.
    terms : candidates
    std : array of shape (3 N,)
        Noise per group that weighs the rows.
    raw : derivatives by term, linearised elsewhere; computed about the fit if not given
    """
    weight = 1.0 / std[problem.group]
    project, residual = projector(problem, fit, weight)
    kept, weighted = [], []
    for term in terms:
        columns = raw[term] if raw is not None else columns_of(problem, fit, term)
        spread = spread_of(problem, fit.noise, term, columns)[np.array(term.linear)]
        columns = columns[:, np.array(term.linear)] * (weight[:, None] * spread)
        if not np.isfinite(columns).all() or float(np.linalg.norm(columns)) < REST.inert:
            continue
        kept.append(term)
        weighted.append(columns)
    if not kept:
        empty = np.zeros(0, dtype=int)
        return Screen((), np.zeros((0, 0)), np.zeros(0), empty, empty, np.zeros(0), np.zeros((len(weight), 0)))
    stacked = project(np.hstack(weighted))
    width = np.array([block.shape[1] for block in weighted])
    start = np.concatenate([[0], np.cumsum(width)[:-1]])
    score = stacked.T @ residual
    log_bayes = np.empty(len(kept))
    for index, (s, w) in enumerate(zip(start, width, strict=True)):
        block = stacked[:, s : s + w]
        log_bayes[index] = log_bayes_factor(block.T @ block, score[s : s + w])
    return Screen(tuple(kept), stacked, score, start, width, log_bayes, stacked[: len(weight)])


def columns_of(problem: RestProblem, fit: Fit, term: Term) -> Floats:
    """Derivative (rows, k) by the parameters of an effect that is not in the fit, where they begin."""
    return term_columns(problem, fit, term, np.array(term.start, dtype=float))


def projector(problem: RestProblem, fit: Fit, weight: Floats) -> tuple[Callable[[Floats], Floats], Floats]:
    """What the design of a fit, with its prior rows, leaves of weighted columns; and of the weighted residual.

    Returns
    -------
    function (rows, k) -> (rows and prior rows, k), and the residual (rows and prior rows,)
    """
    held = np.isfinite(fit.prior_std)
    prior = np.diag(np.where(held, 1.0 / np.where(held, fit.prior_std, 1.0), 0.0))[held]
    more = np.zeros((len(problem.prior_target), fit.design.shape[1]))
    more[:, problem.link_part] = problem.prior_rows
    big = np.vstack([fit.design * weight[:, None], prior, more])
    scale = np.sqrt((big**2).sum(axis=0))
    scale[scale <= NOTHING * scale.max(initial=0.0)] = 1.0  # rounding of a column that is zero is not a column
    basis, r = np.linalg.qr(big / scale)
    basis = basis[:, np.abs(np.diag(r)) > 1e-10]
    rows = len(weight)

    def project(columns: Floats) -> Floats:
        left = np.zeros((len(big), columns.shape[1]))
        left[:rows] = columns
        return left - basis @ (basis[:rows].T @ columns)

    centre = np.concatenate([np.array(term.start) for term in fit.terms]) if fit.terms else np.zeros(0)
    pull = np.concatenate([problem.common_mean - fit.common, centre - fit.flat_theta])
    pull[problem.taken_over(fit.terms)] = 0.0
    target = np.concatenate(
        [
            fit.residual * weight,
            (pull / np.where(held, fit.prior_std, 1.0))[held],
            problem.prior_target - problem.prior_rows @ fit.links,
        ]
    )
    return project, target - basis @ (basis.T @ target)


def log_bayes_factor(gram: Floats, score: Floats) -> float:
    """Log Bayes factor of adding columns with unit prior: `b' (G + 1)^-1 b / 2 - log det(G + 1) / 2`."""
    matrix = gram + np.eye(len(gram))
    factor = np.linalg.cholesky(matrix)
    half = np.linalg.solve(factor, score)
    return 0.5 * float(half @ half) - float(np.sum(np.log(np.diag(factor))))


def pair_log_bayes(view: Screen, first: NDArray[np.int_], second: NDArray[np.int_]) -> Floats:
    """Log Bayes factors of adding candidates in pairs (index arrays of equal length)."""
    width = int(view.width.max())
    total = len(view.score)
    gram = np.zeros((total + 1, total + 1))
    gram[:total, :total] = view.tall.T @ view.tall
    score = np.append(view.score, 0.0)
    offsets = np.arange(width)
    table = np.where(offsets < view.width[:, None], view.start[:, None] + offsets, total)
    index = np.concatenate([table[first], table[second]], axis=1)
    blocks = gram[index[:, :, None], index[:, None, :]]
    same = np.eye(2 * width, dtype=bool)
    blocks[:, same] += 1.0
    right = score[index]
    solved = np.linalg.solve(blocks, right[:, :, None])[:, :, 0]
    _, log_det = np.linalg.slogdet(blocks)
    return 0.5 * np.einsum("pk,pk->p", right, solved) - 0.5 * log_det
