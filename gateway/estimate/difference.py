"""Load difference: the same poses under a known and an unknown load (JP3698770B2, first embodiment, eq. (2) to (4)).

`tau_2 - tau_1 = L (phi_2 - phi_1)`: links and constant friction drop out. One posture never gives all four unknowns
(rank 3: the part of the centre of mass along gravity turns no axis), so the claim's "four axes, one posture" is
refused. Each difference is a visit of an arm whose links weigh nothing.

Friction drops out only between readings of one approach direction, so each axis is subtracted by direction. A visit
from both directions holds a reading of each (half-sum plus and minus half-difference). Opposite directions are left
out; where a direction is unknown, the friction band is part of the uncertainty. A gain that changes by `u` from one
occasion to the other does not drop out: it changes the difference by `u tau` with the torque `tau` of links and load.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.estimate import CONTRADICTS, Estimate, FittedRows, describe, describe_masses, disagree
from gateway.estimate.recommendation import wrist_in_words
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import DRIFT, refused_load
from gateway.identify.nuisance import change_covariance, gain_stds, losses
from gateway.identify.prior_loads import BARE_LABEL, load_vector, unknown_labels
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.linear import Fit, Noise, RestProblem
from gateway.identify.rest.problem import build_problem, nuisance_of
from gateway.identify.rest.rest_nuisance import GainChanges
from gateway.identify.rest.start_noise import first_noise, half_difference_scatter
from gateway.model.kinematics import gravity_in_last_link, largest_angle_rad
from gateway.model.robot import Robot
from gateway.model.visits import SAME_POSE_RAD, Visits, joined
from gateway.result.result import Finding, NuisanceResult

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_ANGLE_RAD = np.deg2rad(30.0)
#: Standard deviation [kg, kg m] of links that have dropped out.
_GONE = 1e-10
#: Visits of one load that differ from those of the other by one's own noise and the other's.
_OF_TWO = np.sqrt(2.0)
_SAME_DIRECTION = "approach each pose from both directions, or under both loads from the same direction"


def estimate_difference(visits: Visits, robot: Robot, knowledge: Knowledge) -> Estimate:
    """Estimate every unknown load against the known ones at the same poses.

    Parameters
    ----------
    visits : Visits
    robot : Robot
        Only its geometry is used.
    knowledge : Knowledge

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        No known load, no common pose, one posture (rank 3), gravity from nearly one side of the flange.
    """
    labels = unknown_labels(visits.load, knowledge.known)
    known = [BARE_LABEL, *knowledge.known]
    if not np.isin(visits.load, known).any():
        raise DataUnusable(
            "the difference method needs a known load: record the unloaded arm (load 'none') at the same poses, or"
            " give the first load with --known LABEL=MASS,X,Y,Z"
        )
    if not labels:
        raise DataUnusable("every load in the data is known: there is nothing to estimate")
    reference = visits.take(np.isin(visits.load, known))
    parts = [_one(visits, reference, robot, knowledge, label) for label in labels]
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


@dataclass(frozen=True, slots=True, eq=False)
class _Differences:
    """Differences of n poses between one load and the known loads.

    Attributes
    ----------
    visits : Visits
        NaN for an axis that was not measured with both loads from one direction.
    fixed : (n, 4) negated known loads
    unknown : (n, N) True where the direction of a reading is not known
    opposite : (n, N) True where the directions are opposite
    torque_nm : (n, N, 2) mean reading under the load and under the known load, which are two occasions
    """

    visits: Visits
    fixed: Floats
    unknown: Mask
    opposite: Mask
    torque_nm: Floats


def _one(visits: Visits, reference: Visits, robot: Robot, knowledge: Knowledge, label: str) -> Estimate:
    own = visits.take(visits.load == label)
    pairs = _differences(own, reference, knowledge, label)
    differences = pairs.visits
    # Refuse poses whose gravity directions give rank 3
    if len(differences) < 2:
        raise DataUnusable(
            f"load '{label}': one posture gives rank 3, never four unknowns: the part of the centre of mass along"
            " gravity turns no axis, whatever the arm; measure two postures or more in which gravity comes from sides"
            " of the flange more than 30 degrees apart"
        )
    angle = largest_angle_rad(gravity_in_last_link(robot, differences.q_rad, knowledge.gravity_m_s2))
    if angle < LEAST_ANGLE_RAD:
        raise DataUnusable(
            f"load '{label}': in all {len(differences)} common postures gravity comes from nearly one side of the"
            f" flange ({np.rad2deg(angle):.0f} degrees apart at most, 30 needed), which gives rank 3; turn"
            f" {wrist_in_words(robot)}"
        )
    # the differences are visits of an arm with massless links and known loads
    stated = replace(knowledge.of_loads(differences.load), bare=None, known={})
    changes = GainChanges.none(gain_stds(knowledge.gain_std, robot.axes))
    problem = build_problem(robot, differences, stated, changes)
    none = np.zeros_like(problem.links)
    problem = replace(problem, links=none, link_std=none + _GONE, fixed_load=pairs.fixed)
    lost = losses(visits.difference_nm, visits.sum_nm)
    nuisance = nuisance_of(visits, replace(knowledge, bare=None), problem.nuisance.changes)
    nuisance = nuisance.with_bias(_friction_left(pairs, visits)).with_losses(*lost)
    # half-sums are those on axes whose visits have both approach directions
    both = np.asarray(np.isfinite(visits.difference_nm).any(axis=0))[problem.axis]
    problem = replace(problem, nuisance=nuisance, group=np.where(both, problem.axis, problem.group))
    fitted = fit(problem, (), _noise(problem, visits))
    found = describe(
        problem, fitted, robot, knowledge, {DRIFT: _by_change(fitted, pairs.torque_nm, knowledge.change)[None]}
    )
    (load,) = found.loads
    # the change from one occasion to the other is not common to two measurements
    load = replace(load, common_errors={k: v for k, v in load.common_errors.items() if k != "statements"})
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
        findings=tuple(_findings(own, pairs, label)),
        nuisance={"gain": found.nuisance["gain"], "load_friction": loss},
        quality={"rank": found.rank, "condition": found.condition, "poses": len(differences)},
    )


def _friction_left(pairs: _Differences, visits: Visits) -> Floats:
    """Standard deviation (N,) [Nm] of the friction that all differences of an axis share; 0 for known directions.

    A friction band that no visit determines may be as large as the torque.
    """
    count = np.maximum(np.isfinite(visits.sum_nm).sum(axis=0), 1)
    size = np.sqrt(np.nansum(visits.sum_nm**2, axis=0) / count)
    band = np.where(np.isfinite(visits.band_nm), np.abs(visits.band_nm), size)
    return _OF_TWO * np.where(pairs.unknown.any(axis=0), band, 0.0)


def _by_change(fitted: Fit, torque_nm: Floats, factor: float) -> Floats:
    """Covariance (4, 4) of [m, h] due to gains that differ between the two occasions.

    The measured torque `torque_nm` (n, N, 2) determines only the size of this uncertainty, not the estimate.
    """
    problem = fitted.problem
    reach = fitted.covariance[:, problem.load_part(0)]
    by_row = fitted.columns.times(reach) / fitted.noise.std[problem.group][:, None] ** 2
    by_axis = np.zeros((problem.axes, 2, 4))
    np.add.at(by_axis, problem.axis, torque_nm[problem.visit, problem.axis][:, :, None] * by_row[:, None, :])
    return np.einsum("aok,ab,bol->kl", by_axis, change_covariance(problem.axes, factor), by_axis)


def _noise(problem: RestProblem, visits: Visits) -> Noise:
    """Noise of the differences: twice the variance of a visit, as estimated from the half-differences."""
    first = first_noise(problem)
    seen = _OF_TWO * np.sqrt(half_difference_scatter(visits.difference_nm, visits.sum_nm)[0])
    start = first.start.copy()
    start[: problem.axes] = np.maximum(
        np.where(np.isfinite(seen), seen, first.start[2 * problem.axes :]), first.least[: problem.axes]
    )
    return Noise(start, start.copy(), first.least)


def _differences(own: Visits, reference: Visits, knowledge: Knowledge, label: str) -> _Differences:
    """Subtract the readings under the known load from those under the load, pose by pose.

    Raises
    ------
    DataUnusable
        No common pose, no axis measured with both loads, or all approached from opposite directions.
    """
    poses: list[_Differences] = []
    for pose in np.unique(own.pose):
        mine = own.take(own.pose == pose)
        here = (reference.pose == pose) & (
            np.abs(reference.q_rad - mine.q_rad.mean(axis=0)).max(axis=1) < SAME_POSE_RAD
        )
        known = {name: load_vector(load) for name, load in knowledge.known.items()}
        by_load = [
            _subtracted(
                mine,
                reference.take(here & (reference.load == name)),
                known.get(name, np.zeros(4)),
            )
            for name in np.unique(reference.load[here]).tolist()
        ]
        if by_load:
            poses.append(max(by_load, key=lambda pair: np.isfinite(pair.visits.sum_nm).sum()))
    if not poses:
        raise DataUnusable(
            f"load '{label}' shares no pose with a known load (same number, same angles within {SAME_POSE_RAD} rad);"
            " record both at the same poses, or use --method joint, which does not need that"
        )
    names = ("fixed", "unknown", "opposite", "torque_nm")
    stacked = {name: np.concatenate([getattr(pair, name) for pair in poses]) for name in names}
    pairs = _Differences(joined([pair.visits for pair in poses]), **stacked)
    # where the directions of some poses are known, the others would only add the friction band
    vague = pairs.unknown & (np.isfinite(pairs.visits.sum_nm) & ~pairs.unknown).any(axis=0)
    pairs = replace(pairs, visits=pairs.visits.unmeasured(vague), unknown=pairs.unknown & ~vague)
    if np.isfinite(pairs.visits.sum_nm).any():
        return pairs
    if pairs.opposite.any():
        raise DataUnusable(
            f"load '{label}': in all common poses it was approached from the direction opposite to that of the known"
            f" load, so the difference holds twice the friction; {_SAME_DIRECTION}, or use --method joint"
        )
    raise DataUnusable(f"load '{label}': no axis was measured with both this load and the known load")


def _subtracted(own: Visits, reference: Visits, known: Floats) -> _Differences:
    """Subtract the visits of a known load (4,) from those of the load, all at one pose."""
    mine, theirs = _mean_visit(own), _mean_visit(reference)
    up, down = (_mean(_readings(own, direction)) - _mean(_readings(reference, direction)) for direction in (1.0, -1.0))
    one = np.where(np.isfinite(up) & np.isfinite(down), (up + down) / 2.0, np.where(np.isfinite(up), up, down))
    all_nm = mine.sum_nm - theirs.sum_nm
    unknown = np.isnan(one) & np.isfinite(all_nm) & (_is_unknown(own) | _is_unknown(reference))
    nothing = np.full(all_nm.shape, np.nan)
    return _Differences(
        replace(
            mine,
            run=np.array(["difference"]),
            q_rad=(mine.q_rad + theirs.q_rad) / 2.0,
            sum_nm=np.where(unknown, all_nm, one),
            difference_nm=nothing,
            side=np.zeros_like(nothing),
            sample_std_nm=np.hypot(mine.sample_std_nm, theirs.sample_std_nm),
            gear_nm=np.hypot(mine.gear_nm, theirs.gear_nm),
        ),
        -known[None],
        unknown,
        np.isnan(one) & np.isfinite(all_nm) & ~unknown,
        np.stack([mine.sum_nm, theirs.sum_nm], axis=2),
    )


def _readings(visits: Visits, direction: float) -> Floats:
    """Readings (n, N) [Nm] of one approach direction, 1 or -1; NaN = none."""
    both = visits.sum_nm + direction * visits.difference_nm
    return np.where(np.isfinite(both), both, np.where(visits.side == direction, visits.sum_nm, np.nan))


def _is_unknown(visits: Visits) -> Mask:
    """Axes (N,) of which a reading has no known direction."""
    return np.asarray((np.isnan(visits.difference_nm) & (visits.side == 0) & np.isfinite(visits.sum_nm)).any(axis=0))


def _mean(values: Floats) -> Floats:
    """Mean (N,) of the known values (n, N) of each column; NaN for a column without any."""
    count = np.isfinite(values).sum(axis=0)
    return np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)


def _mean_visit(visits: Visits) -> Visits:
    """Average several visits into one; NaN for an axis that none of them measured."""
    count = np.isfinite(visits.sum_nm).sum(axis=0)
    spread = np.sqrt(np.nansum(visits.sample_std_nm**2, axis=0)) / np.maximum(count, 1)
    return replace(
        visits.take(np.array([0])), q_rad=visits.q_rad.mean(axis=0)[None], sum_nm=_mean(visits.sum_nm)[None],
        sample_std_nm=spread[None], gear_nm=visits.gear_nm.max(axis=0)[None],
    )  # fmt: skip


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


def _findings(own: Visits, pairs: _Differences, label: str) -> Iterator[Finding]:
    """Findings on poses without a known load, and on axes that were approached from opposite or unknown directions."""
    where = f"load {label}"
    lost = sorted(set(own.pose.tolist()) - set(pairs.visits.pose.tolist()))
    if lost:
        what = f"poses {', '.join(map(str, lost))} were not measured under a known load and were left out"
        yield Finding("info", where, what, "--method joint uses them too")
    for axis, opposite in enumerate(pairs.opposite.T):
        if opposite.any():
            what = (
                f"poses {', '.join(map(str, pairs.visits.pose[opposite].tolist()))} were approached from the direction"
                " opposite to that of the known load and were left out"
            )
            yield Finding("warn", f"{where}, J{axis + 1}", what, _SAME_DIRECTION)
    unknown = ", ".join(f"J{axis + 1}" for axis in np.flatnonzero(pairs.unknown.any(axis=0)))
    if unknown:
        what = (
            f"the approach directions of {unknown} are not known: friction is not separated from the load, and the"
            " uncertainty contains the friction band"
        )
        yield Finding("warn", where, what, f"{_SAME_DIRECTION}, and record it (columns dir1, dir2, ..)")
