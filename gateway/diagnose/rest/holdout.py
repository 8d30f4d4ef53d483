"""Residuals on poses that a fit has not seen: left out pose by pose, or measured afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.linear import Fit, RestProblem, common_columns, modelled, term_columns, with_terms
from gateway.diagnose.rest.screen import Screen
from gateway.result.result import SetAside

Floats = NDArray[np.float64]
#: Share of a row's own noise below which the fit has taken it up altogether.
LEAST_FREE: Final = 1e-9


def pose_of_rows(problem: RestProblem) -> NDArray[np.int_]:
    """Pose number (rows,) of every row: the same pose under all loads is held out together."""
    return problem.rows.pose[problem.visit]


def left_out(problem: RestProblem, fit: Fit) -> Floats:
    """Residual (rows,) [Nm] of each row when its pose, under all loads, is not in the fit (linearised)."""
    return foretold_poses(problem, fit)[0]


def gained_by_pose(problem: RestProblem, after: Fit, before: Fit) -> Floats:
    """Squares (poses,) of unseen rows that `after` leaves less than `before`, over the noise of `after`."""
    std = after.noise.std[problem.group]
    less = (left_out(problem, before) / std) ** 2 - (left_out(problem, after) / std) ** 2
    _, pose = np.unique(pose_of_rows(problem), return_inverse=True)
    return np.asarray(np.bincount(pose, weights=less), dtype=float)


def foretold_poses(problem: RestProblem, fit: Fit) -> tuple[Floats, Floats]:
    """Residual (rows,) [Nm] of every row when its pose is not in the fit, and log density (poses,) of each pose then.

    What a fit of all poses scores, less the density of one, is what the fit of the others scores: so the others choose,
    and the one that is left out judges, at no cost (linearised).
    """
    std = fit.noise.std[problem.group]
    pose = pose_of_rows(problem)
    scaled = fit.residual / std
    out, density = np.empty_like(scaled), []
    for number in np.unique(pose):
        rows = np.flatnonzero(pose == number)
        out[rows], free = _not_in_fit(scaled[rows], fit.orthogonal[rows])
        told = float(np.sum(np.log(free))) - float(scaled[rows] @ out[rows])
        density.append(0.5 * told - float(np.sum(np.log(std[rows]))))
    return std * out, np.array(density)


def chosen_by_others(problem: RestProblem, fits: Sequence[Fit], score: Sequence[float]) -> Floats:
    """Residual (rows,) [Nm] of every row by the one of these fits that the other poses choose, fitted to them.

    Parameters
    ----------
    problem : RestProblem
    fits : hypotheses to choose from
    score : their log odds on all poses
    """
    residual, density = zip(*(foretold_poses(problem, fit) for fit in fits), strict=True)
    choice = np.argmax(np.array(score)[:, None] - np.array(density), axis=0)
    _, pose = np.unique(pose_of_rows(problem), return_inverse=True)
    return np.asarray(np.array(residual)[choice[pose], np.arange(len(pose))], dtype=float)


def left_out_with(problem: RestProblem, fit: Fit, view: Screen, index: int) -> Floats:
    """The same for the fit with one screened candidate added (linearised)."""
    std = fit.noise.std[problem.group]
    columns = view.projected[:, view.pick(index)]
    part = view.pick(index)
    tall = view.tall[:, part]
    matrix = tall.T @ tall + np.eye(columns.shape[1])
    factor = np.linalg.cholesky(matrix)
    added: Floats = np.asarray(np.linalg.solve(factor, columns.T).T, dtype=float)
    residual: Floats = fit.residual / std - added @ np.linalg.solve(factor, view.score[part])
    basis, pose = np.hstack([fit.orthogonal, added]), pose_of_rows(problem)
    out = np.empty_like(residual)
    for number in np.unique(pose):
        rows = np.flatnonzero(pose == number)
        out[rows], _ = _not_in_fit(residual[rows], basis[rows])
    return std * out


def _not_in_fit(scaled: Floats, basis: Floats) -> tuple[Floats, Floats]:
    """Weighted residual (k,) of rows once they are not in the fit, from that with them and their basis (k, p).

    The other is how much of their own noise the fit has not taken up, in each direction where that is anything.
    """
    size, turned = np.linalg.eigh(np.eye(len(scaled)) - basis @ basis.T)
    free = size > LEAST_FREE
    return turned[:, free] @ ((turned.T @ scaled)[free] / size[free]), size[free]


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Rows that no fit has seen, with the visits of the fit before them (so that times and first visits agree).

    Attributes
    ----------
    problem : RestProblem
        Fitted visits and held-out visits together.
    mask : (rows,) the held-out ones
    aside : gross torques among the held-out visits, which judge nothing
    """

    problem: RestProblem
    mask: NDArray[np.bool_]
    aside: tuple[SetAside, ...] = ()


def predicted(held: Unseen, fit: Fit) -> Floats:
    """Residual (held-out rows,) [Nm] of a fit on rows it has not seen."""
    return _at(held.problem, fit)[held.mask]


def foretold_covariance(held: Unseen, fit: Fit) -> Floats:
    """Covariance (held-out rows, held-out rows) [Nm2] of the residuals of a fit on rows it has not seen.

    The noise of the rows, and what the covariance of the fit's parameters leaves open about them.
    """
    problem = held.problem
    setting = with_terms(fit.terms, fit.theta, problem.rows, fit.nuisance)
    columns = [common_columns(problem, setting, fit.links, fit.loads, fit.band)]
    columns += [
        term_columns(problem, fit, term, fit.theta[position], position) for position, term in enumerate(fit.terms)
    ]
    design = np.hstack(columns)[held.mask]
    noise = fit.noise.std[problem.group[held.mask]] ** 2
    return np.asarray(design @ fit.covariance @ design.T + np.diag(noise), dtype=float)


def _at(problem: RestProblem, fit: Fit) -> Floats:
    setting = with_terms(fit.terms, fit.theta, problem.rows, fit.nuisance)
    return problem.target - modelled(problem, setting, fit.links, fit.loads, fit.band)
