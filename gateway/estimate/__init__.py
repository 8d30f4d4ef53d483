"""Estimators of the mass and centre of gravity of a load, with uncertainty, from measured rows and a robot model.

To add a method: write a function `(table, robot, knowledge) -> Estimate` in a file of its own and list it in
`ESTIMATORS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.errors import ConfigError, DataUnusable
from gateway.estimate.coefficient import Coefficient, estimate_coefficient
from gateway.estimate.difference import estimate_difference
from gateway.estimate.estimate import Estimate, axis_sigma
from gateway.estimate.handover import to_result
from gateway.estimate.joint import estimate_joint, refused_loads
from gateway.estimate.moving_estimate import estimate_moving
from gateway.estimate.posture import estimate_posture
from gateway.estimate.recommendation import next_pose, shrinks_most
from gateway.identify.knowledge import Knowledge
from gateway.identify.outliers import without_outliers
from gateway.identify.prior_loads import BARE_LABEL, refuse_absent, refuse_parts
from gateway.identify.rest.hypothesis_fit import fit_without_effects, with_place_effects
from gateway.identify.rest.linear import Fit
from gateway.identify.rest.problem import build_problem
from gateway.model.robot import Robot
from gateway.model.visits import Visits, pair_visits
from gateway.result.result import Finding, Result

Floats = NDArray[np.float64]

__all__ = [
    "ESTIMATORS",
    "METHODS",
    "Coefficient",
    "Estimate",
    "estimate",
    "run",
    "to_result",
]

Estimator = Callable[[Table, Robot, Knowledge], Estimate]


def _of_visits(function: Callable[[Visits, Robot, Knowledge], Estimate]) -> Estimator:
    def with_table(table: Table, robot: Robot, knowledge: Knowledge) -> Estimate:
        sound, rejected = without_outliers(_visits(table, knowledge), robot, knowledge.gravity_m_s2)
        found = function(sound, robot, knowledge)
        return replace(found, set_aside=rejected.entries, findings=(*rejected.findings, *found.findings))

    return with_table


def _visits(table: Table, knowledge: Knowledge) -> Visits:
    visits = pair_visits(table, knowledge.efficiency, knowledge.coupling)
    if not len(visits):
        raise DataUnusable("the data contain no rows at rest; this method needs poses at rest (column 'pose')")
    return visits


def _joint(table: Table, robot: Robot, knowledge: Knowledge) -> Estimate:
    """Estimate with the joint method from the rest rows, or from the moving rows if there are no rest rows."""
    if table.moving.all():
        return estimate_moving(table, robot, knowledge)
    if not table.moving.any():
        return _of_visits(estimate_joint)(table, robot, knowledge)
    what, advice = "moving rows were left out: --bare is of rest rows alone", ""
    if knowledge.bare is None:
        try:
            return _together(table, robot, knowledge)
        except DataUnusable as error:  # too little motion to be fitted: the rest rows stand alone
            what, advice = "moving rows were left out beside the rest rows", str(error)
    note = Finding("info", "moving rows", f"{int(table.moving.sum())} {what}", advice)
    at_rest = _of_visits(estimate_joint)(table.take(~table.moving), robot, knowledge)
    return replace(at_rest, findings=(*at_rest.findings, note))


def _together(table: Table, robot: Robot, knowledge: Knowledge) -> Estimate:
    """Fit rest and moving rows in one solution, without the loads whose rest rows contradict each other."""
    sound, rejected = without_outliers(_visits(table, knowledge), robot, knowledge.gravity_m_s2)
    at_rest = knowledge.of_loads(sound.load)
    plain: Fit | None = fit_without_effects(build_problem(robot, sound, at_rest))
    gone = refused_loads(plain.problem, plain, robot, at_rest)
    kept = ~np.isin(np.asarray(table.load), list(gone))
    if gone and not (table.moving & kept).any():
        return _of_visits(estimate_joint)(table.take(~table.moving), robot, at_rest)
    if gone:
        sound = sound.take(~np.isin(sound.load, list(gone)))
        plain = None
        if len(sound):
            plain = fit_without_effects(build_problem(robot, sound, knowledge.of_loads(sound.load)))
    rest = None if plain is None else with_place_effects(plain)
    found = estimate_moving(
        table.take(kept), robot, knowledge.of_loads(set(knowledge.stated_loads) - set(gone)), rest=rest
    )
    return replace(
        found,
        method="joint",
        loads=(*found.loads, *(load for label, load in gone.items() if label not in (BARE_LABEL, *knowledge.known))),
        sigma_nm=found.sigma_nm if rest is None else axis_sigma(rest.problem, rest),
        band_nm=found.band_nm if rest is None else rest.friction_band_nm,
        set_aside=(*rejected.entries, *found.set_aside),
        findings=(*rejected.findings, *found.findings),
    )


ESTIMATORS: Mapping[str, Estimator] = {
    "joint": _joint,
    "difference": _of_visits(estimate_difference),
    "posture": _of_visits(estimate_posture),
}
METHODS = (*ESTIMATORS, "coefficient")


def estimate(
    table: Table,
    robot: Robot | None,
    knowledge: Knowledge,
    method: str = "joint",
    *,
    coefficient: Coefficient | None = None,
    pose_choice: Floats | None = None,
) -> Estimate:
    """Estimate the loads of a table.

    Parameters
    ----------
    table : Table
    robot : Robot or None
        Only the coefficient method does without.
    knowledge : Knowledge
    method : str
        One of `METHODS`.
    coefficient : Coefficient, optional
        Inputs that the coefficient method needs.
    pose_choice : array of shape (k, N), optional
        Poses that may be recommended [rad]; without it any within the robot's joint limits.

    Raises
    ------
    ConfigError
        Unknown method, or no robot model for a method that needs one.
    InputError, DataUnusable
        As documented at the method.
    """
    if method not in METHODS:
        raise ConfigError(f"--method {method}: choose one of {', '.join(METHODS)}")
    if knowledge.parts and method != "joint":
        raise ConfigError(
            f"--part needs --method joint: method {method} fits each load alone, without their covariance"
        )
    if method == "coefficient":
        return estimate_coefficient(table, knowledge, coefficient)
    if robot is None:
        raise ConfigError(f"--method {method} needs the robot model: give --robot R.urdf or --cell CELL")
    refuse_absent(table.load, knowledge.stated_loads, table.file)
    refuse_parts(table.load, knowledge.parts, knowledge.known, table.file)
    knowledge = knowledge.of_robot(robot)
    found = ESTIMATORS[method](table, robot, knowledge)
    measured = [load for load in found.loads if load.label not in knowledge.parts]
    advice = [next_pose(load, robot, found.sigma_nm, knowledge, pose_choice) for load in measured]
    advice += [shrinks_most(load) for load in measured if load.label not in knowledge.stated_loads]
    return replace(found, next=tuple(entry for entry in advice if entry is not None))


def run(
    table: Table,
    robot: Robot | None,
    knowledge: Knowledge,
    method: str = "joint",
    provenance: Mapping[str, Any] | None = None,
    *,
    coefficient: Coefficient | None = None,
    pose_choice: Floats | None = None,
) -> Result:
    """Estimate the loads and build the result file; arguments and errors as of `estimate`."""
    found = estimate(table, robot, knowledge, method, coefficient=coefficient, pose_choice=pose_choice)
    return to_result(found, robot, knowledge, provenance)
