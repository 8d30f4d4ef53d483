"""Load difference: the same poses under a known and an unknown load (JP3698770B2, first embodiment, eq. (2) to (4)).

`tau_2 - tau_1 = L (phi_2 - phi_1)`: links and constant friction drop out. One posture never gives all four unknowns
(rank 3: the part of the centre of mass along gravity turns no axis), so the claim's "four axes, one posture" is
refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable
from gateway.estimate.advice import wrist_in_words
from gateway.estimate.consistency import CONTRADICTS, describe_masses, disagree
from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.friction import band_scatter, friction_bands, noise_groups
from gateway.estimate.gains import GainRows, settled
from gateway.estimate.noise import Groups, NoiseFit, fit_noise, noise_levels
from gateway.estimate.options import EstimateOptions
from gateway.identify.budget import CONSTANTS, FRICTION, NOISE, Sources, budget_of
from gateway.identify.load_estimate import (
    LoadEstimate,
    load_directions,
    load_from_moment,
    refused_load,
    without_guesses,
)
from gateway.identify.loads import BARE_LABEL, load_vector, unknown_labels
from gateway.identify.nuisance import gain_stds, held_by_friction, losses, nuisance_prior
from gateway.identify.solve import Prior, determined
from gateway.model.kinematics import gravity_in_last_link, largest_angle_rad
from gateway.model.regressor import load_regressor
from gateway.model.robot import Robot, reach_m
from gateway.model.visits import SAME_POSE_RAD, Visits
from gateway.result.result import Finding, NuisanceResult

Floats = NDArray[np.float64]

LEAST_ANGLE_RAD = np.deg2rad(30.0)
_INFORMATIVE = 0.05
#: Times that the noise is chosen anew about the last solution.
_ROUNDS = 2


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Differences of one load, poses by axes: torque, stated variance, share of one visit's extra variance.

    `known_nm` is the torque of what hung there at the reference, by the model: the gains multiply it too.
    """

    pose: NDArray[np.int_]
    q_rad: Floats
    torque_nm: Floats
    known_nm: Floats
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
    reference = visits.take(np.isin(visits.load, known))
    reference_nm = _known_torque(reference, robot, options)
    parts = [_one(visits, reference, reference_nm, robot, options, label) for label in labels]
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


def _known_torque(visits: Visits, robot: Robot, options: EstimateOptions) -> Floats:
    """Torque (n, N) of the known load of each visit."""
    torque = np.zeros(visits.tau_nm.shape)
    rows = load_regressor(robot, visits.q_rad, options.gravity_m_s2)
    for label, values in options.known.items():
        here = visits.load == label
        torque[here] = rows[here] @ load_vector(values)
    return torque


def _one(
    visits: Visits, reference: Visits, reference_nm: Floats, robot: Robot, options: EstimateOptions, label: str
) -> Estimate:
    own = visits.take(visits.load == label)
    rows = _differences(own, reference, reference_nm, label)
    _require_postures(rows, robot, options, label)
    pose, axis = np.nonzero(np.isfinite(rows.torque_nm))
    if not len(pose):
        raise DataUnusable(f"load '{label}': no axis was measured both under it and under the known load")
    fitted = _fit(visits, rows, robot, options, pose, axis)
    fit, problem, scale = fitted.fit, fitted.problem, fitted.scale
    value, covariance = fit.solution.value, fit.covariance
    load = _load(fitted, rows.pose[pose], label)
    load = without_guesses(load, reach_m(robot))
    sigma = np.full(robot.axes, np.nan)
    for k in np.unique(axis):
        sigma[k] = float(np.sqrt(np.median(fit.weight[axis == k] ** -2.0)))
    reason = _contradiction(visits, fit, load, axis)
    if reason is not None:
        load = refused_load(label, reason, load.per_pose_mass_kg)
    model = np.full(rows.torque_nm.shape, np.nan)
    model[pose, axis] = problem.tau_nm - fit.solution.residual / scale
    axes = np.unique(axis)
    gain = np.full((2, robot.axes), np.nan)
    std = fit.std(np.eye(len(value)))
    gain[:, axes] = value[4:], std[4:]
    return Estimate(
        method="difference",
        loads=(load,),
        sigma_nm=sigma,
        band_nm=friction_bands(visits),
        names=("mass", "hx", "hy", "hz", *(f"gain[J{k + 1}]" for k in axes)),
        units=("kg", "kg m", "kg m", "kg m", *("1" for _ in axes)),
        value=value,
        std=std,
        covariance=covariance,
        rows=_fitted(rows, label, model, sigma),
        rank=fit.solution.rank,
        condition=fit.solution.condition,
        findings=_left_out(own, rows, label),
        nuisance={"gain": NuisanceResult(*(tuple(row) for row in gain.tolist())), "load_friction": fitted.loss},
        quality={"rank": fit.solution.rank, "condition": fit.solution.condition, "poses": len(rows.pose)},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """Differences about their solution: rows scaled so that each has the noise of one visit."""

    problem: GainRows
    design: Floats
    target: Floats
    scale: Floats
    one_sided: NDArray[np.bool_]
    prior: Prior
    constants: Floats
    loss: NuisanceResult
    fit: NoiseFit


def _fit(
    visits: Visits, rows: _Rows, robot: Robot, options: EstimateOptions, pose: NDArray[np.int_], axis: NDArray[np.int_]
) -> _Fitted:
    """Load and gains from the differences; the constants of friction have dropped out."""
    axes = np.unique(axis)
    body = load_regressor(robot, rows.q_rad, options.gravity_m_s2)[pose, axis]
    problem = GainRows(
        design=np.hstack([body, np.zeros((len(pose), len(axes)))]),
        tau_nm=rows.torque_nm[pose, axis],
        known_nm=-rows.known_nm[pose, axis],
        bodies=4,
        gain=4 + np.searchsorted(axes, axis),
    )
    scale = 1.0 / np.sqrt(rows.share[pose, axis])
    groups = _groups(visits, rows, pose, axis)
    # no model of the links stands here: the measured torque says how large the torque is, of the prior alone
    stds, lost = gain_stds(options.gain_std, robot.axes), losses(visits.band_nm, visits.tau_nm)
    bands = friction_bands(visits)
    nuisance = nuisance_prior(stds, bands, lost[0], held_by_friction(visits.tau_nm, bands))
    mean, std = np.zeros(4 + len(axes)), np.full(4 + len(axes), np.inf)
    mean[4:], std[4:] = nuisance.gain[axes], nuisance.gain_std[axes]
    prior = replace(Prior.free(len(mean)), mean=mean, std=std)
    first = np.linalg.lstsq(body, problem.tau_nm + rows.known_nm[pose, axis], rcond=None)[0]
    value: Floats = np.concatenate([np.asarray(first, dtype=float), mean[4:]])
    for _ in range(_ROUNDS):
        design, target = problem.about(value)
        weight = noise_levels(design * scale[:, None], target * scale, prior, groups).weight
        value = settled(problem, weight * scale, prior, value)
    design, target = problem.about(value)
    fit = fit_noise(design * scale[:, None], target * scale, prior, groups)
    constants = np.concatenate([np.zeros(4), np.minimum(stds[axes] / std[4:], 1.0) ** 2])
    loss = NuisanceResult(*(tuple(each.tolist()) for each in lost))
    return _Fitted(
        problem, design * scale[:, None], target * scale, scale, rows.one_sided[pose, axis], prior, constants, loss, fit
    )


def _differences(own: Visits, reference: Visits, reference_nm: Floats, label: str) -> _Rows:
    """Mean torque of each pose under the load less that under the known load."""
    found, q, torque, known, stated, share, one_sided = [], [], [], [], [], [], []
    for pose in np.unique(own.pose):
        mine = own.take(own.pose == pose)
        near = np.abs(reference.q_rad - mine.q_rad.mean(axis=0)).max(axis=1) < SAME_POSE_RAD
        here = (reference.pose == pose) & near
        if not here.any():
            continue
        theirs = reference.take(here)
        found.append(int(pose))
        q.append((mine.q_rad.mean(axis=0) + theirs.q_rad.mean(axis=0)) / 2.0)
        torque.append(_mean(mine.tau_nm) - _mean(theirs.tau_nm))
        known.append(_mean(np.where(np.isfinite(theirs.tau_nm), reference_nm[here], np.nan)))
        stated.append(_mean_variance(mine) + _mean_variance(theirs))
        share.append(1.0 / _visits_of(mine) + 1.0 / _visits_of(theirs))
        one_sided.append(_seen_from_one_side(mine) | _seen_from_one_side(theirs))
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
        known_nm=np.array(known).reshape(shape),
        stated=np.array(stated).reshape(shape),
        share=np.array(share).reshape(shape),
        one_sided=np.array(one_sided).reshape(shape),
    )


def _visits_of(visits: Visits) -> Floats:
    """How many visits (N,) measured each axis, at least 1."""
    return np.maximum(np.isfinite(visits.tau_nm).sum(axis=0), 1).astype(float)


def _mean(values: Floats) -> Floats:
    """Mean (N,) of the visits that have one, NaN where none has."""
    count = np.isfinite(values).sum(axis=0)
    return np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)


def _seen_from_one_side(visits: Visits) -> NDArray[np.bool_]:
    """Axes (N,) of which a visit was measured from one side only."""
    return np.asarray((np.isnan(visits.band_nm) & np.isfinite(visits.tau_nm)).any(axis=0))


def _mean_variance(visits: Visits) -> Floats:
    """Variance (N,) of the mean torque of some visits by samples and gear alone."""
    own = np.nan_to_num(visits.tau_std_nm) ** 2 + visits.gear_nm**2 / 3.0
    return np.where(np.isfinite(visits.tau_nm), own, 0.0).sum(axis=0) / _visits_of(visits) ** 2


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


def _load(fitted: _Fitted, pose: NDArray[np.int_], label: str) -> LoadEstimate:
    fit, design, target = fitted.fit, fitted.design, fitted.target
    moment = fit.solution.value[:4]
    body = np.eye(len(fit.solution.value))[:4]
    found = determined(fit.solution, body)
    found[1:] &= found[0]
    turn = load_directions(moment)
    masses: dict[str, float] = {}
    if found.all() and abs(moment[0]) > 1e-9:
        lever = design[:, :4] @ (moment / moment[0])
        left = target - design[:, 4:] @ fit.solution.value[4:]
        weight = fit.weight**2
        strength = {int(k): float(np.sum((weight * lever**2)[pose == k])) for k in np.unique(pose)}
        least = _INFORMATIVE * max(strength.values())
        masses = {
            str(k): float(np.sum((weight * lever * left)[pose == k]) / value)
            for k, value in strength.items()
            if value > least
        }
    load = load_from_moment(label, moment, fit.covariance[:4, :4], fit.widening(turn @ body), found, masses)
    return replace(load, budget=_budget(fitted) if found[0] else {})


def _budget(fitted: _Fitted) -> Mapping[str, float]:
    """Share of the variance of the mass by source; what losses leave of a gain is friction."""
    fit, loss = fitted.fit, np.concatenate([np.zeros(4), 1.0 - fitted.constants[4:]])
    return budget_of(
        fitted.design,
        fit.weight,
        fitted.prior,
        fit.solution.covariance,
        np.eye(len(loss))[0],
        Sources(np.where(fitted.one_sided, FRICTION, NOISE), {CONSTANTS: fitted.constants, FRICTION: loss}),
    )


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
