"""Load difference: the same poses under a known and an unknown load (JP3698770B2, first embodiment, eq. (2) to (4)).

`tau_2 - tau_1 = L (phi_2 - phi_1)`: links and constant friction drop out. One posture never gives all four unknowns
(rank 3: the part of the centre of mass along gravity turns no axis), so the claim's "four axes, one posture" is
refused. Each difference is a visit of an arm whose links weigh nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.consistency import CONTRADICTS, describe_masses, disagree
from gateway.estimate.describe import describe
from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.options import EstimateOptions
from gateway.estimate.recommendation import wrist_in_words
from gateway.identify.load_estimate import refused_load
from gateway.identify.nuisance import gain_stds, losses
from gateway.identify.prior_loads import BARE_LABEL, load_vector, unknown_labels
from gateway.identify.repeats import half_difference_scatter
from gateway.identify.rest.gain_changes import GainChanges
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.linear import Fit, Noise, RestProblem
from gateway.identify.rest.problem import build_problem, nuisance_of
from gateway.identify.rest.start_noise import first_noise
from gateway.model.kinematics import gravity_in_last_link, largest_angle_rad
from gateway.model.robot import Robot
from gateway.model.visits import SAME_POSE_RAD, Visits, joined
from gateway.result.result import Finding, NuisanceResult

Floats = NDArray[np.float64]

LEAST_ANGLE_RAD = np.deg2rad(30.0)
#: Standard deviation [kg, kg m] of links that have dropped out.
_GONE = 1e-10
#: Visits of one load that differ from those of the other by one's own noise and the other's.
_OF_TWO = np.sqrt(2.0)


def estimate_difference(visits: Visits, robot: Robot, options: EstimateOptions) -> Estimate:
    """Estimate every unknown load against the known ones at the same poses.

    Parameters
    ----------
    visits : Visits
    robot : Robot
        Only its geometry is used.
    options : EstimateOptions

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        No known load, no common pose, one posture (rank 3), gravity from nearly one side of the flange.
    """
    labels = unknown_labels(visits.load, options.known)
    known = [BARE_LABEL, *options.known]
    if not np.isin(visits.load, known).any():
        raise DataUnusable(
            "the difference method needs a known load: record the unloaded arm (load 'none') at the same poses, or"
            " give the first load with --known LABEL=MASS,X,Y,Z"
        )
    if not labels:
        raise DataUnusable("every load in the data is known: there is nothing to estimate")
    reference = visits.take(np.isin(visits.load, known))
    parts = [_one(visits, reference, robot, options, label) for label in labels]
    first = parts[0]
    return replace(
        first,
        loads=tuple(load for part in parts for load in part.loads),
        findings=tuple(finding for part in parts for finding in part.findings),
        rows=_stacked([part.rows for part in parts if part.rows is not None]),
        quality={label: part.quality for label, part in zip(labels, parts, strict=True)},
        condition=max(part.condition for part in parts),
        rank=min(part.rank for part in parts),
    )


def _one(visits: Visits, reference: Visits, robot: Robot, options: EstimateOptions, label: str) -> Estimate:
    own = visits.take(visits.load == label)
    differences, fixed = _differences(own, reference, options, label)
    _require_postures(differences, robot, options, label)
    if not np.isfinite(differences.sum_nm).any():
        raise DataUnusable(f"load '{label}': no axis was measured with both this load and the known load")
    lost = losses(visits.difference_nm, visits.sum_nm)
    problem = _problem(differences, fixed, robot, options)
    nuisance = (
        nuisance_of(visits, replace(options, bare=None), problem.nuisance.changes).without_bias().with_losses(*lost)
    )
    problem = replace(problem, nuisance=nuisance, group=_groups(visits, problem))
    fitted = fit(problem, (), _noise(problem, visits))
    found = describe(problem, fitted, robot, options)
    (load,) = found.loads
    reason = _contradiction(visits, problem, fitted, load.per_pose_mass_kg)
    if reason is not None:
        load = refused_load(label, reason, load.per_pose_mass_kg)
    loss = NuisanceResult(*(tuple(each.tolist()) for each in lost))
    return replace(
        found,
        method="difference",
        loads=(load,),
        band_nm=np.abs(visits.band_nm),
        bare=None,
        findings=_left_out(own, differences, label),
        nuisance={"gain": found.nuisance["gain"], "load_friction": loss},
        quality={"rank": found.rank, "condition": found.condition, "poses": len(differences)},
    )


def _problem(differences: Visits, fixed: Floats, robot: Robot, options: EstimateOptions) -> RestProblem:
    """Build the problem of the differences: visits of an arm with massless links and known loads (n, 4)."""
    own = replace(options.of_loads(differences.load), bare=None, known={})
    problem = build_problem(robot, differences, own, GainChanges.none(gain_stds(options.gain_std, robot.axes)))
    none = np.zeros_like(problem.links)
    return replace(problem, links=none, link_std=none + _GONE, fixed_load=fixed)


def _groups(visits: Visits, problem: RestProblem) -> NDArray[np.int_]:
    """Noise groups (rows,) of the differences: half-sums on axes whose visits have both approach directions."""
    seen = np.asarray(np.isfinite(visits.difference_nm).any(axis=0))[problem.axis]
    return np.where(seen, problem.axis, problem.group)


def _noise(problem: RestProblem, visits: Visits) -> Noise:
    """Noise of the differences: twice the variance of a visit, as estimated from the half-differences."""
    first = first_noise(problem)
    seen = _OF_TWO * np.sqrt(half_difference_scatter(visits.difference_nm, visits.sum_nm)[0])
    start = first.start.copy()
    start[: problem.axes] = np.maximum(
        np.where(np.isfinite(seen), seen, first.start[2 * problem.axes :]), first.least[: problem.axes]
    )
    return Noise(start, start.copy(), first.least)


def _differences(own: Visits, reference: Visits, options: EstimateOptions, label: str) -> tuple[Visits, Floats]:
    """Mean torque of each pose under the load minus that under known loads, and the negated known loads."""
    ours, theirs, fixed = [], [], []
    torque = np.array([load_vector(options.known.get(name, (0.0,) * 4)) for name in reference.load.tolist()])
    for pose in np.unique(own.pose):
        mine = np.flatnonzero(own.pose == pose)
        near = np.abs(reference.q_rad - own.q_rad[mine].mean(axis=0)).max(axis=1) < SAME_POSE_RAD
        here = np.flatnonzero((reference.pose == pose) & near)
        if len(here):
            ours.append(_mean_visit(own, mine))
            theirs.append(_mean_visit(reference, here))
            fixed.append(-torque[here].mean(axis=0))
    if not ours:
        raise DataUnusable(
            f"load '{label}' shares no pose with a known load (same number, same angles within {SAME_POSE_RAD} rad);"
            " record both at the same poses, or use --method joint, which does not need that"
        )
    mine, other = joined(ours), joined(theirs)
    unknown = np.full(mine.sum_nm.shape, np.nan)
    return (
        replace(
            mine,
            run=np.full(len(mine), "difference"),
            q_rad=(mine.q_rad + other.q_rad) / 2.0,
            sum_nm=mine.sum_nm - other.sum_nm,
            difference_nm=unknown,
            side=np.zeros_like(unknown),
            sample_std_nm=np.hypot(mine.sample_std_nm, other.sample_std_nm),
            gear_nm=np.hypot(mine.gear_nm, other.gear_nm),
        ),
        np.array(fixed),
    )


def _mean_visit(visits: Visits, rows: NDArray[np.int_]) -> Visits:
    """Average several visits into one; NaN for an axis that none of them measured."""
    part = visits.take(rows)
    count = np.isfinite(part.sum_nm).sum(axis=0)
    mean = np.where(count > 0, np.nansum(part.sum_nm, axis=0) / np.maximum(count, 1), np.nan)
    spread = np.sqrt(np.nansum(part.sample_std_nm**2, axis=0)) / np.maximum(count, 1)
    one = part.take(np.array([0]))
    return replace(
        one, q_rad=part.q_rad.mean(axis=0)[None], sum_nm=mean[None], sample_std_nm=spread[None],
        gear_nm=part.gear_nm.max(axis=0)[None],
    )  # fmt: skip


def _require_postures(differences: Visits, robot: Robot, options: EstimateOptions, label: str) -> None:
    """Refuse poses whose gravity directions give rank 3."""
    if len(differences) < 2:
        raise DataUnusable(
            f"load '{label}': one posture gives rank 3, never four unknowns: the part of the centre of mass along"
            " gravity turns no axis, whatever the arm; measure two postures or more in which gravity comes from sides"
            " of the flange more than 30 degrees apart"
        )
    angle = largest_angle_rad(gravity_in_last_link(robot, differences.q_rad, options.gravity_m_s2))
    if angle < LEAST_ANGLE_RAD:
        raise DataUnusable(
            f"load '{label}': in all {len(differences)} common postures gravity comes from nearly one side of the"
            f" flange ({np.rad2deg(angle):.0f} degrees apart at most, 30 needed), which gives rank 3; turn"
            f" {wrist_in_words(robot)}"
        )


def _contradiction(visits: Visits, problem: RestProblem, fitted: Fit, masses: Mapping[str, float]) -> str | None:
    """Return why the differences do not fit one rigid body, judged by the half-differences' scatter; else None."""
    if not disagree(list(masses.values())):
        return None
    square, freedom = half_difference_scatter(visits.difference_nm, visits.sum_nm)
    here = (np.isfinite(square) & (freedom > 2))[problem.axis]
    if not here.any():
        return None
    sigma = _OF_TWO * np.sqrt(np.maximum(square[problem.axis[here]], 1e-300))
    excess = float(np.sqrt(np.mean((fitted.residual[here] / sigma) ** 2)))
    if excess < CONTRADICTS:
        return None
    return (
        f"its rows contradict each other: the poses alone would give {describe_masses(masses)}, and the"
        f" residual is {excess:.0f} times what the friction leaves"
    )


def _stacked(parts: list[FittedRows]) -> FittedRows | None:
    if not parts:
        return None
    names = FittedRows.__dataclass_fields__
    return FittedRows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _left_out(own: Visits, differences: Visits, label: str) -> tuple[Finding, ...]:
    lost = sorted(set(own.pose.tolist()) - set(differences.pose.tolist()))
    if not lost:
        return ()
    names = ", ".join(str(pose) for pose in lost)
    return (
        Finding(
            "info", f"load {label}", f"poses {names} were not measured under a known load and were left out",
            "--method joint uses them too",
        ),
    )  # fmt: skip
