"""Candidate effects of a moving run, and limits of their physically possible parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.penalised_fit import MovingFit, MovingProblem
from gateway.model.effect import MotionSetup
from gateway.model.effects import terms_by_residual, terms_in_motion
from gateway.model.term import Seen, Term

Floats = NDArray[np.float64]


def candidates(problem: MovingProblem, full: MovingFit, allowed: frozenset[str]) -> list[Term]:
    """Return every effect among `allowed` that these rows could show."""
    return terms_in_motion(problem.motion, _setup(problem, full), allowed)


def suggested(problem: MovingProblem, full: MovingFit, allowed: frozenset[str]) -> list[Term]:
    """Return effects whose shape the residual of a fit suggests."""
    return terms_by_residual(problem.motion, _setup(problem, full), allowed)


def _setup(problem: MovingProblem, full: MovingFit) -> MotionSetup:
    return MotionSetup(problem.null.trust is not None, tuple(problem.null.columns.loads), full.residual_nm)


def possible(problem: MovingProblem, full: MovingFit, term: Term, value: Floats, covariance: Floats) -> bool:
    """Return True if coefficients (k,) are physically possible: sign and size."""
    null, motion = problem.null, problem.motion

    def friction_nm(axis: int, columns: Floats, own: Floats) -> Floats:
        first = null.friction[axis, :2]
        weight = full.weight[:, axis] ** 2
        change = full.inverse @ (full.cross([axis], (columns * weight[:, None])[:, None]) @ own)
        parameters = (full.value[: len(change)] - change)[first]
        return null.columns.design[:, axis, first] @ parameters + columns @ own

    links = null.columns.links
    drawn = null.columns.design[:, :, links] @ null.columns.prior.mean[links]
    return term.possible(value, np.sqrt(np.diag(covariance)), Seen(motion, full.modelled, drawn, friction_nm))
