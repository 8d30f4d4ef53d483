"""Posture variation: one load throughout, many postures (JP3698770B2, second embodiment, eq. (5) and (6)).

First the base gravity parameters (the A_ij, B_ij) and the friction offsets of the loaded arm are estimated. The load is
their difference from those of the unloaded arm: `beta_loaded - beta_bare = E phi`. Loaded rows alone cannot determine
the load, because its columns are in the span of the last link's. The method therefore needs a stored identification of
the unloaded arm, rows of the unloaded arm (their postures need not be the same), or trusted inertials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from gateway.errors import DataUnusable, InputError
from gateway.estimate.estimate import LOAD_NAMES, Estimate, describe
from gateway.identify.knowledge import Knowledge
from gateway.identify.links import PER_LINK_AT_REST, link_prior
from gateway.identify.prior_loads import BARE_LABEL, require_postures, unknown_labels
from gateway.identify.rest.hypothesis_fit import fit_to_report, fit_without_effects
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import well_determined
from gateway.identify.solve import solve
from gateway.model.base import BaseSet, rest_base
from gateway.model.regressor import LOAD_COLUMNS
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.result.result import Bare, Finding
from gateway.result.values import matrix, numbers

Floats = NDArray[np.float64]

_SUSPICIOUS = 0.0027
_BLURRED = 1e-6


def estimate_posture(visits: Visits, robot: Robot, knowledge: Knowledge) -> Estimate:
    """Estimate each load from its own postures and the parameters of the unloaded arm.

    Parameters
    ----------
    visits : Visits
    robot : Robot
    knowledge : Knowledge
        `bare`, or trusted inertials, unless the data contain rows of the unloaded arm.

    Raises
    ------
    InputError
        A bare identification of another arm or mounting.
    DataUnusable
        The parameters of the unloaded arm are unknown, no load in the data, or one posture only.
    """
    labels = unknown_labels(visits.load, knowledge.known)
    if not labels:
        raise DataUnusable("every load in the data is known: there is nothing to estimate")
    for label in labels:
        require_postures(visits.q_rad[visits.load == label], label)
    base = rest_base(robot, knowledge.gravity_m_s2)
    bare = _bare(visits, robot, knowledge, base, labels)
    alone = replace(knowledge, link_std=np.inf, bare=None)
    parts = []
    for label in labels:
        own = visits.take(visits.load == label)
        reported = replace(alone.of_loads(own.load), bare=bare)
        part = _described(own, robot, reported)
        parts.append(replace(part, findings=(*part.findings, *_check(own, robot, alone, bare, label))))
    first = parts[0]
    return replace(
        first,
        method="posture",
        loads=tuple(load for part in parts for load in part.loads),
        findings=(_limits(base, robot.axes), *(finding for part in parts for finding in part.findings)),
        bare=bare,
        quality=dict(zip(labels, (part.quality for part in parts), strict=True)),
    )


def _described(visits: Visits, robot: Robot, knowledge: Knowledge) -> Estimate:
    """Return the joint estimate of these visits."""
    problem = build_problem(robot, visits, knowledge)
    return describe(problem, fit_to_report(problem), robot, knowledge)


def _bare(visits: Visits, robot: Robot, knowledge: Knowledge, base: BaseSet, labels: tuple[str, ...]) -> Bare:
    """Return the parameters of the unloaded arm: stored, from its rows in the data, or from trusted inertials."""
    if knowledge.bare is not None:
        refuse_other_bare(knowledge.bare, robot, knowledge.gravity_m_s2)
        return knowledge.bare
    if (visits.load == BARE_LABEL).any():
        reported = replace(knowledge, known={}, weighed={})
        found = _described(visits.take(visits.load == BARE_LABEL), robot, reported).bare
        if found is not None:
            return found
        raise DataUnusable(
            "the rows of the unloaded arm do not determine all of its base parameters; measure more postures without"
            f" load that move axes 2 to {robot.axes}, or use --method joint, which needs no complete set"
        )
    mean, std = link_prior(robot, knowledge.trust, PER_LINK_AT_REST)
    if np.isinf(std).any():
        lumped = [name for name in base.names if f"_{robot.axes}" in name]
        raise DataUnusable(
            f"loads {', '.join(labels)} were mounted throughout and the unloaded arm is unknown: only link {robot.axes}"
            f" and load together can be identified, in the combinations {'; '.join(lumped)}; give a stored bare"
            " identification (--bare RESULT.json), record the unloaded arm too, or state how far the URDF's inertials"
            " are trusted (--inertials)"
        )
    std = np.maximum(std, _BLURRED)
    covariance = (base.combination * std**2) @ base.combination.T
    return Bare(
        robot=robot.name,
        gravity_m_s2=numbers(knowledge.gravity_m_s2),
        columns=tuple(base.indices.tolist()),
        names=base.names,
        value=numbers(base.combination @ mean),
        covariance=matrix(covariance),
        combination=matrix(base.combination),
        offset_nm=(np.nan,) * robot.axes,
    )


def refuse_other_bare(bare: Bare, robot: Robot, gravity_m_s2: Sequence[float]) -> None:
    """Refuse a stored identification of an unloaded arm with other kinematics or another gravity.

    Raises
    ------
    InputError
    """
    if bare.robot != robot.name:
        raise InputError(
            f"--bare: it identified robot '{bare.robot}', and this is robot '{robot.name}'; use the bare run of the"
            " same arm"
        )
    base = rest_base(robot, tuple(gravity_m_s2))
    combination = np.asarray(bare.combination, dtype=float)
    if not _same_span(combination, base.combination) or not np.allclose(bare.gravity_m_s2, gravity_m_s2, atol=1e-3):
        raise InputError(
            f"--bare: it identified robot '{bare.robot}' with gravity {list(bare.gravity_m_s2)}, and its base"
            f" parameters are not those of '{robot.name}' with {list(gravity_m_s2)}: another arm or mounting"
        )


def _same_span(first: Floats, second: Floats) -> bool:
    """Return True if two sets of base parameters (r, 4 N) span the same space, for any choice of columns."""
    if first.shape != second.shape:
        return False
    rows = second / np.linalg.norm(second, axis=1, keepdims=True)
    basis = np.linalg.svd(first, full_matrices=False)[2]
    return np.allclose(rows, rows @ basis.T @ basis, atol=1e-4)


def _check(own: Visits, robot: Robot, alone: Knowledge, bare: Bare, label: str) -> tuple[Finding, ...]:
    """Report a difference from the unloaded arm that is not a rigid body on the flange."""
    loaded = build_problem(
        robot, replace(own, load=np.full(len(own), BARE_LABEL)), replace(alone, known={}, weighed={})
    )
    fit = fit_without_effects(loaded)
    combination = np.asarray(bare.combination)
    directions = np.zeros((len(combination), len(fit.scale)))
    directions[:, loaded.link_part] = combination
    if not well_determined(loaded, fit, directions).all():
        return ()
    change = directions @ fit.common - np.asarray(bare.value)
    covariance = directions @ fit.covariance @ directions.T + np.asarray(bare.covariance)
    span = combination[:, LOAD_COLUMNS]
    size, vectors = np.linalg.eigh(covariance)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-12 * size[-1]))
    whiten = (vectors / np.sqrt(np.maximum(size, 1e-12 * size[-1]))).T
    body = solve(whiten @ span, whiten @ change, np.ones(len(change)))
    freedom = len(combination) - len(LOAD_NAMES)
    if freedom < 1 or chdtrc(freedom, body.misfit) > _SUSPICIOUS:
        return ()
    worst = bare.names[int(np.argmax(np.abs(change - span @ body.value) / spread))]
    return (
        Finding(
            "warn", f"load {label}",
            f"more than a load has changed since the bare identification, most of all in {worst}",
            "was a dress pack, cable or tool added? Record the unloaded arm again on the same day",
        ),
    )  # fmt: skip


def _limits(base: BaseSet, last: int) -> Finding:
    lumped = "; ".join(name for name in base.names if f"_{last}" in name)
    return Finding(
        "info", "posture variation",
        f"link {last} and load can only be identified together ({lumped}); the load is the "
        "difference from the unloaded arm, so it includes any error of that identification",
        "the difference method at the same poses does not need the parameters of the unloaded arm",
    )  # fmt: skip
