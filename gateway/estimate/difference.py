"""Load difference: the same poses under a known and an unknown load (JP3698770B2, first embodiment, eq. (2) to (4)).

`tau_2 - tau_1 = L (phi_2 - phi_1)`: links and constant friction drop out. One posture never gives all four unknowns
(rank 3: the part of the centre of mass along gravity turns no axis), so the claim's "four axes, one posture" is
refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.advice import wrist_in_words
from gateway.estimate.consistency import CONTRADICTS, describe_masses, disagree
from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.friction import band_scatter, friction_bands, noise_groups
from gateway.estimate.noise import Groups, NoiseFit, fit_noise
from gateway.estimate.options import EstimateOptions
from gateway.identify.load_estimate import (
    LoadEstimate,
    load_directions,
    load_from_moment,
    refused_load,
    without_guesses,
)
from gateway.identify.loads import BARE_LABEL, load_vector, unknown_labels
from gateway.identify.solve import Prior, determined
from gateway.model.kinematics import gravity_in_last_link, largest_angle_rad
from gateway.model.regressor import load_regressor
from gateway.model.robot import Robot, reach_m
from gateway.model.visits import Visits
from gateway.result.result import Finding

Floats = NDArray[np.float64]

LEAST_ANGLE_RAD = np.deg2rad(30.0)
SAME_POSE_RAD = 0.01
_INFORMATIVE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Differences of one load, poses by axes: torque, stated variance, share of one visit's extra variance."""

    pose: NDArray[np.int_]
    q_rad: Floats
    torque_nm: Floats
    stated: Floats
    share: Floats
    one_sided: NDArray[np.bool_]


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
            "the difference method needs a load that is known: record the bare arm (load 'none') at the same poses, or"
            " give the first load with --known LABEL=MASS,X,Y,Z"
        )
    if not labels:
        raise DataUnusable("every load in the data is known: there is nothing to estimate")
    reference = _less_known(visits.take(np.isin(visits.load, known)), robot, options)
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


def _less_known(visits: Visits, robot: Robot, options: EstimateOptions) -> Visits:
    """The reference visits with the torque of their known load taken off."""
    torque = visits.tau_nm.copy()
    rows = load_regressor(robot, visits.q_rad, options.gravity_m_s2)
    for label, values in options.known.items():
        here = visits.load == label
        torque[here] -= rows[here] @ load_vector(values)
    return replace(visits, tau_nm=torque)


def _one(visits: Visits, reference: Visits, robot: Robot, options: EstimateOptions, label: str) -> Estimate:
    own = visits.take(visits.load == label)
    rows = _differences(own, reference, label)
    _require_postures(rows, robot, options, label)
    axes_rows = load_regressor(robot, rows.q_rad, options.gravity_m_s2)
    pose, axis = np.nonzero(np.isfinite(rows.torque_nm))
    if not len(pose):
        raise DataUnusable(f"load '{label}': no axis was measured both under it and under the known load")
    design, target = axes_rows[pose, axis], rows.torque_nm[pose, axis]
    scale = 1.0 / np.sqrt(rows.share[pose, axis])
    groups = _groups(visits, rows, pose, axis)
    fit = fit_noise(design * scale[:, None], target * scale, Prior.free(4), groups)
    load = _load(fit, design * scale[:, None], target * scale, rows.pose[pose], label)
    load = without_guesses(load, reach_m(robot))
    sigma = np.full(robot.axes, np.nan)
    for k in np.unique(axis):
        sigma[k] = float(np.sqrt(np.median(fit.weight[axis == k] ** -2.0)))
    reason = _contradiction(visits, fit, load, axis)
    if reason is not None:
        load = refused_load(label, reason, load.per_pose_mass_kg)
    model = np.full(rows.torque_nm.shape, np.nan)
    model[pose, axis] = design @ fit.solution.value
    return Estimate(
        method="difference",
        loads=(load,),
        sigma_nm=sigma,
        band_nm=friction_bands(visits),
        names=("mass", "hx", "hy", "hz"),
        units=("kg", "kg m", "kg m", "kg m"),
        value=fit.solution.value,
        std=fit.std(np.eye(4)),
        covariance=fit.covariance,
        rows=_fitted(rows, label, model, sigma),
        rank=fit.solution.rank,
        condition=fit.solution.condition,
        findings=_left_out(own, rows, label),
        quality={"rank": fit.solution.rank, "condition": fit.solution.condition, "poses": len(rows.pose)},
    )


def _differences(own: Visits, reference: Visits, label: str) -> _Rows:
    """Mean torque of each pose under the load less that under the known load."""
    found, q, torque, stated, share, one_sided = [], [], [], [], [], []
    for pose in np.unique(own.pose):
        mine, theirs = own.take(own.pose == pose), reference.take(reference.pose == pose)
        if not len(theirs):
            continue
        theirs = theirs.take(np.abs(theirs.q_rad - mine.q_rad.mean(axis=0)).max(axis=1) < SAME_POSE_RAD)
        if not len(theirs):
            continue
        found.append(int(pose))
        q.append((mine.q_rad.mean(axis=0) + theirs.q_rad.mean(axis=0)) / 2.0)
        torque.append(mine.tau_nm.mean(axis=0) - theirs.tau_nm.mean(axis=0))
        stated.append(_mean_variance(mine) + _mean_variance(theirs))
        share.append(np.full(own.axes, 1.0 / len(mine) + 1.0 / len(theirs)))
        one_sided.append(np.isnan(mine.band_nm).any(axis=0) | np.isnan(theirs.band_nm).any(axis=0))
    if not found:
        raise DataUnusable(
            f"load '{label}' shares no pose with a known load (same number, same angles within {SAME_POSE_RAD} rad);"
            " record both at the same poses, or use --method joint, which does not need that"
        )
    shape = (len(found), own.axes)
    return _Rows(
        pose=np.array(found),
        q_rad=np.array(q).reshape(shape),
        torque_nm=np.array(torque).reshape(shape),
        stated=np.array(stated).reshape(shape),
        share=np.array(share).reshape(shape),
        one_sided=np.array(one_sided).reshape(shape),
    )


def _mean_variance(visits: Visits) -> Floats:
    """Variance (N,) of the mean torque of some visits by samples and gear alone."""
    own = np.nan_to_num(visits.tau_std_nm) ** 2 + visits.gear_nm**2 / 3.0
    return own.sum(axis=0) / len(visits) ** 2


def _require_postures(rows: _Rows, robot: Robot, options: EstimateOptions, label: str) -> None:
    """Refuse poses that give rank 3."""
    if len(rows.pose) < 2:
        raise DataUnusable(
            f"load '{label}': one posture gives rank 3, never four unknowns: the part of the centre of mass along"
            " gravity turns no axis, whatever the arm; measure two postures or more in which gravity comes from sides"
            " of the flange more than 30 degrees apart"
        )
    angle = largest_angle_rad(gravity_in_last_link(robot, rows.q_rad, options.gravity_m_s2))
    if angle < LEAST_ANGLE_RAD:
        raise DataUnusable(
            f"load '{label}': in all {len(rows.pose)} common postures gravity comes from nearly one side of the flange"
            f" ({np.rad2deg(angle):.0f} degrees apart at most, 30 needed), which gives rank 3; turn"
            f" {wrist_in_words(robot)}"
        )


def _groups(visits: Visits, rows: _Rows, pose: NDArray[np.int_], axis: NDArray[np.int_]) -> Groups:
    """Noise groups of the scaled differences: the extra variance is that of a single visit."""
    axes = visits.axes
    visit, all_axis = np.nonzero(np.isfinite(visits.tau_nm))
    single = noise_groups(visits, visit, all_axis)
    return Groups(
        index=axis + axes * rows.one_sided[pose, axis],
        stated=rows.stated[pose, axis] / rows.share[pose, axis],
        scale_nm=single.scale_nm,
        seen=np.concatenate([single.seen[:axes], np.full(axes, np.nan)]),
        seen_stated=single.seen_stated,
        seen_weight=np.concatenate([single.seen_weight[:axes], np.zeros(axes)]),
    )


def _load(fit: NoiseFit, design: Floats, target: Floats, pose: NDArray[np.int_], label: str) -> LoadEstimate:
    moment = fit.solution.value
    found = determined(fit.solution, np.eye(4))
    found[1:] &= found[0]
    turn = load_directions(moment)
    masses: dict[str, float] = {}
    if found.all() and abs(moment[0]) > 1e-9:
        lever = design @ (moment / moment[0])
        weight = fit.weight**2
        strength = {int(k): float(np.sum((weight * lever**2)[pose == k])) for k in np.unique(pose)}
        least = _INFORMATIVE * max(strength.values())
        masses = {
            str(k): float(np.sum((weight * lever * target)[pose == k]) / value)
            for k, value in strength.items()
            if value > least
        }
    return load_from_moment(label, moment, fit.covariance, fit.widening(turn), found, masses)


def _contradiction(visits: Visits, fit: NoiseFit, load: LoadEstimate, axis: NDArray[np.int_]) -> str | None:
    """Why the differences cannot belong to one rigid body, judged by the scatter of the half differences."""
    if not disagree(list(load.per_pose_mass_kg.values())):
        return None
    square, freedom = band_scatter(visits)
    known = np.isfinite(square) & (freedom > 2)
    here = known[axis]
    if not here.any():
        return None
    sigma = np.sqrt(np.maximum(square[axis[here]], 1e-300))
    excess = float(np.sqrt(np.mean((fit.solution.residual[here] / sigma) ** 2)))
    if excess < CONTRADICTS:
        return None
    return (
        f"its rows contradict each other: the poses alone would give {describe_masses(load.per_pose_mass_kg)}, and the"
        f" residual is {excess:.0f} times what the friction leaves"
    )


def _fitted(rows: _Rows, label: str, model: Floats, sigma: Floats) -> FittedRows:
    n, axes = rows.q_rad.shape
    blank = np.full((n, axes), np.nan)
    return FittedRows(
        run=np.full(n, "difference"),
        load=np.full(n, label),
        pose=rows.pose,
        time_s=np.full(n, np.nan),
        q_rad=rows.q_rad,
        direction=np.zeros((n, axes), dtype=int),
        tau_nm=rows.torque_nm,
        model_nm=model,
        band_nm=blank,
        std_nm=np.sqrt(rows.share) * sigma,
        leverage=blank,
    )


def _stacked(parts: list[FittedRows]) -> FittedRows | None:
    if not parts:
        return None
    names = FittedRows.__dataclass_fields__
    return FittedRows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _left_out(own: Visits, rows: _Rows, label: str) -> tuple[Finding, ...]:
    lost = sorted(set(own.pose.tolist()) - set(rows.pose.tolist()))
    if not lost:
        return ()
    names = ", ".join(str(pose) for pose in lost)
    return (
        Finding(
            "info", f"load {label}", f"poses {names} were not measured under a known load and were left out",
            "--method joint uses them too",
        ),
    )  # fmt: skip
