"""Convert an estimate into a result file: values, uncertainty, findings and recommendations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from gateway.estimate.estimate import Estimate, FittedRows, hull_radius_m, physical_findings
from gateway.estimate.recommendation import cost_of_missing_axes, wrist_in_words
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import LoadEstimate, load_result, refused_findings
from gateway.identify.nuisance import LOAD_FRICTION, LOAD_FRICTION_STD, NUISANCE_STD, efficiency_of
from gateway.identify.rest.start_noise import half_difference_scatter, negative_bands, repeated_std
from gateway.model.robot import Robot
from gateway.model.visits import places_of
from gateway.result.acceptance import no_body
from gateway.result.result import Finding, FitSummary, Parameter, Result, Rows
from gateway.result.values import numbers

Floats = NDArray[np.float64]

#: Check of the finding that a model does not fit.
MISFIT: Final = "model_misfit"
_MOST_ROWS = 2000
_AT_REST = ("joint", "posture")
#: Residual over noise floor from which a misfit is reported: above the largest of 150 axes of healthy simulated arms,
#: 1.8, since friction that remains in a half-sum is part of the residual.
_MISFIT_RATIO = 3.0
#: Probability of such a residual by chance, per axis.
_MISFIT_P = 1e-3
#: Two-sided visits below which an axis is not judged.
_FEWEST_ROWS = 6
#: Share of an axis's torque below which no noise is resolved: a torque word of 1000 steps, averaged.
_TORQUE_RESOLUTION = 2e-4


def to_result(
    estimate: Estimate, robot: Robot | None, knowledge: Knowledge, provenance: Mapping[str, Any] | None = None
) -> Result:
    """Build the result file of an estimate.

    Parameters
    ----------
    estimate : Estimate
    robot : Robot or None
        Source of the flange pose, the name, and the region in which the centre of mass is expected.
    knowledge : Knowledge
    provenance : mapping, optional
        Where data and constants come from.
    """
    loads = tuple(load_result(load, robot) for load in estimate.loads)
    unknown = np.full(len(estimate.sigma_nm), np.nan)
    rows = None
    if estimate.rows is not None:
        step = max(1, int(np.ceil(len(estimate.rows.pose) / _MOST_ROWS)))
        columns = FittedRows.__dataclass_fields__.keys() - {"leverage"}
        rows = Rows.of(**{name: getattr(estimate.rows, name)[::step] for name in columns})
    rms = unknown if estimate.rows is None else estimate.rows.rms_nm
    summary = FitSummary(rms_nm=numbers(rms), holdout_rms_nm=numbers(unknown), loads=loads)
    quality = {
        "method": estimate.method,
        "rank": estimate.rank,
        "condition": estimate.condition,
        "lumped": estimate.lumped,
    }
    return Result(
        robot="" if robot is None else robot.name,
        loads=loads,
        before=summary,
        after=summary,
        noise_floor_nm=numbers(noise_floor_nm(estimate)),
        friction_band_nm=numbers(estimate.band_nm),
        next=estimate.next,
        findings=(*estimate.findings, *_findings(estimate, robot, knowledge)),
        nuisance=dict(estimate.nuisance),
        set_aside=estimate.set_aside,
        provenance=dict(provenance or {}),
        method=estimate.method,
        parameters=tuple(
            Parameter(name, float(value), float(std), unit)
            for name, value, std, unit in zip(estimate.names, estimate.value, estimate.std, estimate.units, strict=True)
        ),
        quality=quality | dict(estimate.quality),
        rows=rows,
        bare=estimate.bare,
        motion=estimate.motion,
    )


def _findings(estimate: Estimate, robot: Robot | None, knowledge: Knowledge) -> list[Finding]:
    rows = estimate.rows if estimate.method in (*_AT_REST, "difference") else None
    # a reversed sign is the cause of a refused load, so it is said first
    out = [] if rows is None else reversed_signs(rows.band_nm)
    for load in estimate.loads:
        if load.refused is not None:
            out += refused_findings([load])
            continue
        if load.unidentifiable and estimate.method != "coefficient":
            out.append(Finding("warn", f"load {load.label}", _why_open(estimate, load), _what_to_do(estimate, robot)))
        out += no_body([load_result(load, robot)])
        if robot is not None:
            out += physical_findings(load, robot.last_link, hull_radius_m(robot))
    if rows is not None:
        out += _missing_axes(rows, robot, estimate.sigma_nm, knowledge) + _one_sided(estimate) + _misfit(estimate)
    return out + _gear_losses(estimate)


def noise_floor_nm(estimate: Estimate) -> Floats:
    """Return the noise floor (N,) of a half-sum at rest: from repeated visits, else from the half-differences.

    The residual of the fit does not enter. NaN where the visits show neither. A moving run has no half-differences: its
    floor is the one of the fit.
    """
    rows = estimate.rows
    if rows is None or estimate.method not in _AT_REST or estimate.motion:
        return estimate.sigma_nm
    place, load = places_of(rows.q_rad), np.unique(rows.load, return_inverse=True)[1].ravel()
    square, _ = half_difference_scatter(rows.band_nm, rows.model_nm)
    repeated = repeated_std(rows.tau_nm, place + (place.max(initial=0) + 1) * load, rows.direction.astype(float))
    return np.where(np.isfinite(repeated), repeated, np.sqrt(square))


def _misfit(estimate: Estimate) -> list[Finding]:
    """Report axes whose residual exceeds the noise floor by more than chance and friction rounding explain."""
    rows = estimate.rows
    if rows is None or estimate.motion or estimate.method == "difference":
        return []
    floor, out = noise_floor_nm(estimate), []
    for k in np.flatnonzero(np.isfinite(floor) & (floor > 0)):
        use = np.isfinite(rows.residual_nm[:, k]) & np.isfinite(rows.band_nm[:, k])
        freedom = float(np.sum(1.0 - rows.leverage[use, k]))
        if use.sum() < _FEWEST_ROWS or freedom < 1.0:
            continue
        square = float(np.sum(rows.residual_nm[use, k] ** 2))
        least = _TORQUE_RESOLUTION * float(np.sqrt(np.mean(rows.tau_nm[use, k] ** 2)))
        ratio = np.sqrt(square / freedom) / max(float(floor[k]), least)
        if ratio > _MISFIT_RATIO and fdtrc(freedom, use.sum() - 2.0, ratio**2) < _MISFIT_P:
            out.append(
                Finding(
                    "warn", f"J{k + 1}",
                    f"the model does not fit: the residual is {np.sqrt(square / use.sum()):.2g} Nm and repeated visits"
                    f" agree to {floor[k]:.2g} Nm; the difference is model error, not noise",
                    "run `servo-gateway diagnose` on the same data: it searches for the effect that is missing",
                    MISFIT,
                )
            )  # fmt: skip
    return out


def reversed_signs(half_nm: Floats) -> list[Finding]:
    """Report axes with negative half-differences (n, N): the torque sign or the approach direction is reversed."""
    seen = int(np.isfinite(half_nm).any(axis=0).sum())
    negative = np.flatnonzero(negative_bands(half_nm))
    if seen < 2:
        return []
    together = [negative] if len(negative) == seen else [np.array([k]) for k in negative]
    return [
        Finding(
            "fail", ", ".join(f"J{k + 1}" for k in part),
            "torque sign is reversed, or the approach directions are: friction would drive the motion (half-difference"
            f" {', '.join(f'{np.nanmedian(half_nm[:, k]):.3g}' for k in part)} Nm)",
            "check `torque_sign` in the cell file or the sign of the torque column, and the columns dir1, dir2, ...",
            "sign_reversed",
        )
        for part in together
    ]  # fmt: skip


def _gear_losses(estimate: Estimate) -> list[Finding]:
    """Report axes whose friction grows with the torque more than usual: the gear efficiency is not stated."""
    loss = estimate.nuisance.get("load_friction")
    if loss is None:
        return []
    most = LOAD_FRICTION + NUISANCE_STD * LOAD_FRICTION_STD
    return [
        Finding(
            "warn", f"J{joint}",
            f"its friction grows by {100 * value:.0f} % of the torque, as of a gear of efficiency"
            f" {efficiency_of(value):.2f} that is not stated; the intervals are widened for it",
            "state `gear_efficiency` in the cell file",
            "gear_efficiency",
        )
        for joint, (value, std) in enumerate(zip(loss.value, loss.std, strict=True), start=1)
        if value - NUISANCE_STD * std > most
    ]  # fmt: skip


def _why_open(estimate: Estimate, load: LoadEstimate) -> str:
    open_, axes = ", ".join(load.unidentifiable), len(estimate.sigma_nm)
    bare = (estimate.rows is not None and (estimate.rows.load == "none").any()) or estimate.bare is not None
    if "mass_kg" in load.unidentifiable and not bare:
        return (
            f"{open_} cannot be determined: the load cannot be separated from link {axes}, because "
            "the unloaded arm is unknown"
        )
    if "mass_kg" in load.unidentifiable:
        return f"{open_} cannot be determined from the measured axes and poses"
    return f"{open_} cannot be determined: in all poses gravity comes from the same side of the flange"


def _what_to_do(estimate: Estimate, robot: Robot | None) -> str:
    if len(estimate.sigma_nm) == 1:
        return "one axis measures mass times distance: weigh the load, and calibrate the axis with it"
    if estimate.next:
        return "measure the pose that is named under `next`"
    turn = "" if robot is None else f", and turn {wrist_in_words(robot)} between the poses"
    return f"measure the unloaded arm too, give --bare or trusted --inertials{turn}"


def _missing_axes(rows: FittedRows, robot: Robot | None, sigma: Floats, knowledge: Knowledge) -> list[Finding]:
    measured = np.isfinite(rows.tau_nm).any(axis=0)
    if measured.all() or robot is None:
        return []
    names = ", ".join(f"J{k + 1}" for k in np.flatnonzero(~measured))
    cost = cost_of_missing_axes(robot, rows.q_rad, np.where(measured, sigma, np.nan), knowledge)
    said = (
        "with them it could be"
        if np.isinf(cost)
        else f"with them its standard deviation would be {1 / cost:.2f} of this"
    )
    return [Finding("info", names, f"not measured; the mass comes from the other axes alone, {said}")]


def _one_sided(estimate: Estimate) -> list[Finding]:
    rows = estimate.rows
    if rows is None or estimate.method == "difference":
        return []
    measured = np.isfinite(rows.tau_nm).any(axis=1)
    alone = np.asarray(np.isnan(rows.band_nm[measured]).all(axis=1))
    if not alone.any():
        return []
    if not (np.isfinite(rows.band_nm) | (rows.direction != 0)).any():
        return [
            Finding(
                "warn", "approach",
                "no approach direction is known: friction cannot be separated from gravity, and may act like a constant"
                " torque and like a share of the torque on every axis; the intervals are widened for both",
                "approach every pose from both sides, slowly, by the same offset, and record dir1, dir2, ...",
                "sides_unknown",
            )
        ]  # fmt: skip
    return [
        Finding(
            "info", "approach",
            f"{int(alone.sum())} of {len(alone)} visits came from one side only, or from an unknown one: what friction"
            " held there is in the noise",
            "approach every pose from both sides, slowly, by the same offset",
        )
    ]  # fmt: skip
