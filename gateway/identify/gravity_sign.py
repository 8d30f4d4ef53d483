"""Detect a stated gravity vector of the wrong sign: masses are negative although friction has the right sign."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import negative_mass
from gateway.identify.mass_change import MISFIT, misfit
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.linear import Fit, RestProblem, certain_bands
from gateway.identify.rest.problem import build_problem
from gateway.model.robot import Robot
from gateway.result.finding import Finding

#: Log marginal likelihood that the opposite gravity must gain.
_LOG_ODDS: Final = 10.0


def reversed_gravity(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge) -> tuple[Finding, ...]:
    """Report a stated direction of gravity that is reversed; None if loads and friction do not show it."""
    parts = [problem.load_part(index).start for index in range(len(problem.labels))]
    std = np.sqrt(np.maximum(np.diag(fit.covariance)[parts], 0.0))
    if not any(negative_mass(float(mass), float(s)) for mass, s in zip(fit.loads[:, 0], std, strict=True)):
        return ()
    bands = certain_bands(problem, fit)[problem.use_sum.any(axis=0)]
    if np.median(bands) < 0.0:
        return ()
    x, y, z = knowledge.gravity_m_s2
    other = build_problem(robot, problem.rows, replace(knowledge, gravity_m_s2=(-x, -y, -z)))
    opposite = fit_without_effects(other)
    if opposite.evidence - fit.evidence < _LOG_ODDS or misfit(other, opposite) > MISFIT:
        return ()
    return (
        Finding(
            "fail",
            "gravity",
            f"gravity is reversed: the opposite of ({x:.3g}, {y:.3g}, {z:.3g}) m/s2 explains the torque, and friction"
            " has the right sign",
            "check `gravity_m_s2` and how the base is mounted (ceiling or floor), torque signs and directions of all"
            " axes together, and whether the zero of the first horizontal joint is off by 180 degrees",
            "gravity_reversed",
        ),
    )
