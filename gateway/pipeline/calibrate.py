"""Calibrate torque constants from rest poses without a load and under a weighed load.

All gains are estimated in one step (Gautier and Briot 2011): the weighed load sets the scale of every axis that carries
it. The link masses of the robot model are not used, so that a wrong mass has no influence. Load, stated constants and
the previous calibration are checked before a calibration is stored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.calibration import ArmCalibration, CalibratedAxis
from gateway.cell.config import ArmConfig
from gateway.data.labels import BARE_LABEL
from gateway.data.rows import Table
from gateway.errors import ConfigError, DataUnusable
from gateway.estimate.estimate import axis_sigma, fitted_rows
from gateway.estimate.joint import estimate_joint
from gateway.identify.drift import drift_findings, drift_of
from gateway.identify.knowledge import Knowledge
from gateway.identify.nuisance import COMMON_SHARE, day_std, gain_stds
from gateway.identify.outliers import without_outliers
from gateway.identify.prior_loads import load_vector, refuse_absent, require_postures
from gateway.identify.rest.hypothesis_fit import fit_to_report
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import nuisance_results
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits, pair_visits
from gateway.pipeline.calibrated import serial_numbers
from gateway.pipeline.finalize import data_findings
from gateway.pipeline.inputs import AnalysisInputs, profile_of, uses_torque_constant
from gateway.result.result import Finding

Floats = NDArray[np.float64]

#: Largest ratio of measured to stated standard deviation at which a constant is stored.
LARGEST_SHARE: Final = 0.5
#: Smallest stated standard deviation that is assumed: `exact` is only a statement.
_STATED_STD: Final = 0.01
#: Smallest prior standard deviation of every gain: the stated constant must not influence the measured one.
PRIOR_STD: Final = 0.05
#: Difference in standard deviations from which two statements contradict each other.
CONFLICT: Final = 3.5
#: The same of a factor that all calibrated axes have in common: a wrong weight looks like this on every arm.
COMMON_CONFLICT: Final = 3.0
#: Least number of calibrated axes that have a factor in common.
_COMMON_AXES: Final = 2
#: Visits of a proposed pose, and variance of the difference between one visit and the mean of two, in visit variances.
_VISITS, _VARIANCES = 3, 1.5
#: Torque of the load relative to its largest on any axis, below which gravity does not act on an axis.
_NO_TORQUE: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Weight:
    """Weighed load: label, mass [kg], centre of gravity [m] in the last link (None = not known), and their standard
    deviations (0 = exact).
    """

    label: str
    mass_kg: float
    com_m: tuple[float, float, float] | None
    mass_std_kg: float = 0.0
    com_std_m: float = 0.0

    @staticmethod
    def of(label: str, about: AnalysisInputs) -> Weight:
        """Return the known load with a label.

        Raises
        ------
        ConfigError
            The mass of the load is 0, or its centre of gravity is not stated on an arm of one axis.
        """
        load = about.knowledge.stated_loads[label]
        if not load.mass_kg > 0.0:
            raise ConfigError(
                f"--known {label}={load.mass_kg:g}: a load of 0 kg cannot calibrate an axis; state the weighed mass"
            )
        if load.com_m is None and about.model.axes == 1:
            raise ConfigError(
                f"--known {label}={load.mass_kg:g}: one axis measures mass times distance; state the centre of gravity:"
                f" --known {label}={load.mass_kg:g},flange=X,Y,Z"
            )
        return Weight(label, load.mass_kg, load.com_m, load.mass_std_kg, load.com_std_m)


@dataclass(frozen=True, slots=True)
class AxisCalibration:
    """Calibrated torque constant of one axis.

    Attributes
    ----------
    joint : counts from 1
    scale, std : true torque over stated, and its relative standard deviation
    stated_std : relative standard deviation of the stated constant
    is_known : the standard deviation is small enough to store the constant
    deviation : difference from the stated constant in standard deviations
    load_nm : largest torque of the load on the axis, over the poses
    constant_nm_per_a : measured torque constant; None where the drive reports torque by a constant of its own
    stated_nm_per_a : of the cell file
    """

    joint: int
    scale: float
    std: float
    stated_std: float
    is_known: bool
    deviation: float
    load_nm: float
    constant_nm_per_a: float | None
    stated_nm_per_a: float


def stated_std(about: AnalysisInputs, axes: int) -> Floats:
    """Return the relative standard deviations (N,) of the stated constants."""
    return np.maximum(gain_stds(about.knowledge.gain_std, axes), _STATED_STD)


def expected_std(load_nm: Floats, noise_nm: Floats) -> Floats:
    """Return the expected standard deviation (N,) of a gain from a load with known mass and centre of gravity.

    Parameters
    ----------
    load_nm : array of shape (n, N)
        Torque of the load at each pose; the unloaded arm is measured before and after.
    noise_nm : array of shape (N,)
        Standard deviation of a visit.
    """
    information = np.sum(load_nm**2, axis=0) / (_VARIANCES * noise_nm**2)
    return np.asarray(1.0 / np.sqrt(PRIOR_STD**-2 + information), dtype=float)


def load_torque(robot: Robot, q_rad: Floats, gravity_m_s2: Sequence[float], moment: Floats) -> Floats:
    """Return the torque (n, N) [Nm] of a load [m, h] (4,) at postures (n, N)."""
    return np.asarray(gravity_regressor(robot, q_rad, gravity_m_s2)[:, :, -4:] @ moment, dtype=float)


def carried_by_none(load_nm: Floats, noise_nm: Floats, stated: Floats) -> str:
    """Return the reason why poses cannot calibrate any axis; empty if at least one axis can be calibrated."""
    if (expected_std(load_nm, noise_nm) <= LARGEST_SHARE * stated).any():
        return ""
    largest = np.abs(load_nm).max(axis=0)
    at = int(np.argmax(largest / noise_nm))
    return (
        f"no axis carries enough of the load: on J{at + 1} its torque is at most {largest[at]:.3g} Nm, and the"
        f" standard deviation of a visit is {noise_nm[at]:.3g} Nm; use a heavier load, or poses with the arm"
        " stretched out"
    )


def mass_finding(visits: Visits, robot: Robot, knowledge: Knowledge, weight: Weight) -> Iterator[Finding]:
    """Compare the stated mass with the mass estimated with the stated constants, so that a wrong load is detected."""
    free = replace(knowledge, known={}, weighed={})
    load = next(each for each in estimate_joint(visits, robot, free).loads if each.label == weight.label)
    if load.refused:
        raise DataUnusable(f"load '{weight.label}' calibrates no axis: {load.refused}")
    if abs(load.mass_kg - weight.mass_kg) > CONFLICT * np.hypot(load.mass_std_kg, weight.mass_std_kg):
        factor = weight.mass_kg / max(load.mass_kg, 1e-9)
        yield Finding(
            "fail",
            f"load {weight.label}",
            f"stated as {weight.mass_kg:.4g} kg, but estimated as {load.mass_kg:.4g} kg with a standard deviation of"
            f" {load.mass_std_kg:.2g} kg with the constants of the cell file",
            f"the stated mass or the constants are wrong by a common factor of {factor:.3g}, and the"
            " data cannot determine which: weigh the mass, check that this load was mounted, its unit (kg), and the"
            " constants (rms or peak, ratio); if all are right, --force stores the calibration",
            "known_load",
        )


def common_finding(axes: Sequence[AxisCalibration], weight: Weight) -> Iterator[Finding]:
    """Test the factor that the calibrated axes have in common against the common part of the stated constants' errors.

    A wrong weight scales all axes by one factor. Its estimate is more certain than the deviation of any single axis,
    since the independent half of the stated variance averages out.
    """
    known = [axis for axis in axes if axis.is_known]
    if len(known) < _COMMON_AXES:
        return
    stated = np.array([axis.stated_std for axis in known])
    independent = np.square([axis.std for axis in known]) + (1.0 - COMMON_SHARE) * stated**2
    weights = (1.0 / independent) / np.sum(1.0 / independent)
    common = float(weights @ np.array([axis.scale - 1.0 for axis in known]))
    std = float(np.sqrt(weights**2 @ independent + COMMON_SHARE * (weights @ stated) ** 2))
    std = float(np.hypot(std, weight.mass_std_kg / weight.mass_kg))
    if abs(common) <= COMMON_CONFLICT * std:
        return
    names = ", ".join(f"J{axis.joint}" for axis in known)
    yield Finding(
        "fail",
        names,
        f"the ratio of true to stated torque is {1.0 + common:.3f} in common on these axes, {abs(common) / std:.1f}"
        f" standard deviations ({100 * std:.2g} %) from 1: a wrong weight gives one factor on all axes, wrong constants"
        " rarely do; nothing is stored",
        f"in this order: weigh load {weight.label} again (a true mass of {weight.mass_kg / (1.0 + common):.4g} kg"
        f" instead of {weight.mass_kg:.4g} kg would explain it); check that it was mounted alone, and its unit (kg);"
        " check the constants of all axes (rms or peak value, voltage, gear ratio); if all are right, --force stores"
        " the calibration",
        "known_load",
    )


def stated_findings(axes: Sequence[AxisCalibration]) -> Iterator[Finding]:
    for axis in axes:
        if axis.is_known and abs(axis.deviation) > CONFLICT:
            value = axis.constant_nm_per_a
            measured, stated = (
                (f"the ratio of true to reported torque is {axis.scale:.4f}", "the drive assumes 1")
                if value is None
                else (
                    f"the torque constant is {value:.4g} Nm/A",
                    f"the cell file states {axis.stated_nm_per_a:.4g} Nm/A",
                )
            )
            yield Finding(
                "warn",
                f"J{axis.joint}",
                f"{measured} (standard deviation {100 * axis.std:.2g} %), {stated} (to {100 * axis.stated_std:.2g} %):"
                f" they differ by {abs(axis.deviation):.1f} standard deviations",
                "check the constant, rms or peak, and the gear ratio in the cell file",
                "torque_constants",
            )


def unknown_axes(
    axes: Sequence[AxisCalibration],
    noise_nm: Floats,
    weight: Weight,
    robot: Robot,
    gravity_m_s2: Sequence[float],
    moment: Floats,
    postures: Callable[[], Floats | None],
) -> Iterator[Finding]:
    """Report each axis that is not calibrated, with the pose or load that would calibrate it.

    `moment` (4,) is [m, h] of the load; `postures` returns those (k, N) where it can be measured, if they are known.
    """
    unknown = [axis for axis in axes if not axis.is_known]
    if not unknown:
        return
    known_rad = postures()
    q_rad = np.zeros((0, robot.axes)) if known_rad is None else known_rad
    torque = load_torque(robot, q_rad, gravity_m_s2, moment)
    largest = np.abs(torque).max(initial=0.0)
    for axis in unknown:
        at = axis.joint - 1
        what = (
            f"the torque constant is not identifiable: its standard deviation is {100 * axis.std:.2g} %, that of the"
            f" stated one {100 * axis.stated_std:.2g} %; the torque of the load on this axis is at most"
            f" {axis.load_nm:.3g} Nm"
        )
        own = np.abs(torque[:, at])
        best = float(own.max(initial=0.0))
        if not len(own) or best <= _NO_TORQUE * largest:
            advice = (
                "gravity causes no torque on this axis in any pose: its torque constant has no effect on a mass at rest"
            )
            yield Finding("info", f"J{axis.joint}", what, advice if len(own) else "")
            continue
        reached = expected_std(np.full((_VISITS, 1), best), noise_nm[at : at + 1])[0]
        wanted = LARGEST_SHARE * axis.stated_std
        at_pose = ", ".join(f"{angle:.2f}" for angle in q_rad[int(own.argmax())])
        advice = f"measure poses such as [{at_pose}] rad, where the torque of the load is {best:.3g} Nm"
        if reached > wanted:
            information = (wanted**-2 - PRIOR_STD**-2) * _VARIANCES / _VISITS
            needed_kg = weight.mass_kg * float(noise_nm[at]) * np.sqrt(max(information, 0.0)) / best
            advice += f", with a load of {needed_kg:.3g} kg or more, or with a longer lever"
        yield Finding("info", f"J{axis.joint}", what, advice)


def contradictions(
    stored: Mapping[int, tuple[ArmCalibration, CalibratedAxis]], new: ArmCalibration
) -> Iterator[Finding]:
    """Compare a calibration with the stored one of the same drives and the same stated constants."""
    for axis in new.axis:
        if axis.joint not in stored:
            continue
        run, old = stored[axis.joint]
        drives = (old.serial_number, axis.serial_number)
        if None not in drives and drives[0] != drives[1]:
            continue
        if (old.stated_nm_per_a, old.stated_gear_ratio) != (axis.stated_nm_per_a, axis.stated_gear_ratio):
            continue
        std = np.hypot(old.std_percent, axis.std_percent) / 100.0
        apart = abs(axis.torque_scale - old.torque_scale) / std
        if apart > CONFLICT:
            yield Finding(
                "fail",
                f"J{axis.joint}",
                f"the ratio of true to stated torque is {axis.torque_scale:.4f} (standard deviation"
                f" {axis.std_percent:.2g} %), the"
                f" calibration of {run.measured:%Y-%m-%d} says {old.torque_scale:.4f} ({old.std_percent:.2g} %): they"
                f" differ by {apart:.1f} standard deviations",
                "check the mass, the mounted load and the drive; --force replaces the stored calibration",
            )


@dataclass(frozen=True, slots=True)
class Calibration:
    """Result of a calibration: every measured axis, the constants to store, and the findings."""

    axes: tuple[AxisCalibration, ...]
    stored: ArmCalibration
    findings: tuple[Finding, ...]


def calibrate(
    table: Table,
    about: AnalysisInputs,
    weight: Weight,
    data: Sequence[str],
    now: datetime,
    postures: Callable[[], Floats | None],
) -> Calibration:
    """Estimate the torque constants of an arm.

    Parameters
    ----------
    table : Table
        Samples converted with the constants of the cell file.
    about : AnalysisInputs
        Inputs of a request with `calibrated` False.
    weight : Weight
    data : sequence of str
        Names of the files.
    now : datetime
    postures : callable
        Returns the postures (k, N) that may be proposed; None = those of the table.

    Raises
    ------
    InputError
        No sample was measured with the load.
    DataUnusable
        No samples of the unloaded arm, only one posture, contradictory samples, or no axis carries the load.
    """
    robot, arm = about.model, about.arm
    if arm is None:
        raise ConfigError("calibrate needs the cell file, whose torque constants it measures")
    refuse_absent(table.load, [weight.label], table.file)
    knowledge = replace(about.knowledge, link_std=np.inf, bare=None)
    found = pair_visits(table.take(~table.moving), knowledge.efficiency, knowledge.coupling)
    visits, rejected = without_outliers(found, robot, knowledge.gravity_m_s2)
    if not (visits.load == BARE_LABEL).any():
        raise DataUnusable(
            f"the data hold no rest pose of the unloaded arm (load '{BARE_LABEL}'): measure it before and after the"
            " load"
        )
    gain_std = tuple(np.maximum(stated_std(about, robot.axes), PRIOR_STD).tolist())
    problem = build_problem(robot, visits, replace(knowledge, gain_std=gain_std))
    for label in (weight.label, BARE_LABEL):
        require_postures(visits.q_rad[visits.load == label], label)
    fit = fit_to_report(problem)
    moment = (
        fit.loads[problem.labels.index(weight.label)]
        if weight.com_m is None
        else load_vector((weight.mass_kg, *weight.com_m))
    )
    noise_nm = axis_sigma(problem, fit)
    load_nm = load_torque(robot, visits.q_rad[visits.load == weight.label], knowledge.gravity_m_s2, moment)
    axes = tuple(_axes(arm, about, problem, fit, np.abs(load_nm).max(axis=0)))
    mismatch = tuple(mass_finding(visits, robot, knowledge, weight))
    if not any(axis.is_known for axis in axes):
        why = carried_by_none(load_nm, np.nan_to_num(noise_nm, nan=np.inf), stated_std(about, robot.axes))
        least = min(axes, key=lambda axis: axis.std / axis.stated_std)
        why = why or (
            f"the smallest standard deviation is {100 * least.std:.2g} % (J{least.joint}); use a heavier load or more"
            " poses"
        )
        raise DataUnusable(f"load '{weight.label}' calibrates no axis: {why}; nothing is stored")
    stored = ArmCalibration(
        name=arm.name,
        measured=now,
        load=weight.label,
        mass_kg=weight.mass_kg,
        mass_std_kg=weight.mass_std_kg or None,
        com_m=weight.com_m,
        com_std_m=weight.com_std_m or None,
        data=tuple(data),
        axis=tuple(_stored(arm, about, axes, fitted_rows(problem, fit).rms_nm, visits)),
    )
    unknown = unknown_axes(axes, noise_nm, weight, robot, knowledge.gravity_m_s2, moment, postures)
    mismatch = mismatch or tuple(common_finding(axes, weight))
    findings = (*mismatch, *stated_findings(axes), *unknown)
    about_data = (*data_findings(about, table), *rejected.findings, *drift_findings(drift_of(visits)))
    return Calibration(axes, stored, (*findings, *about_data))


def _axes(
    arm: ArmConfig, about: AnalysisInputs, problem: RestProblem, fit: Fit, load_nm: Floats
) -> Iterator[AxisCalibration]:
    found = nuisance_results(problem, fit)["gain"]
    gain, std = np.array(found.value), np.hypot(found.std, day_std(problem.nuisance.changes.factor))
    stated = stated_std(about, len(gain))
    find = profile_of(about.recordings, about.loaded)
    for at in np.flatnonzero(np.isfinite(std)):
        config = arm.axis[at]
        scale, own = 1.0 / (1.0 + gain[at]), std[at] / (1.0 + gain[at])
        value = config.torque_constant_nm_per_a.value
        yield AxisCalibration(
            joint=int(at) + 1,
            scale=float(scale),
            std=float(own),
            stated_std=float(stated[at]),
            is_known=bool(own <= LARGEST_SHARE * stated[at]),
            deviation=float((scale - 1.0) / np.hypot(own, stated[at])),
            load_nm=float(load_nm[at]),
            constant_nm_per_a=float(scale * value) if uses_torque_constant(config, find) else None,
            stated_nm_per_a=value,
        )


def _stored(
    arm: ArmConfig, about: AnalysisInputs, axes: Sequence[AxisCalibration], rms_nm: Floats, visits: Visits
) -> Iterator[CalibratedAxis]:
    serials = serial_numbers(about.recordings, arm.name)
    for axis in axes:
        if not axis.is_known:
            continue
        config, at = arm.axis[axis.joint - 1], axis.joint - 1
        warm = visits.temperature_c[np.isfinite(visits.temperature_c[:, at]), at]
        yield CalibratedAxis(
            joint=axis.joint,
            torque_scale=axis.scale,
            std_percent=100.0 * axis.std,
            torque_constant_nm_per_a=axis.constant_nm_per_a,
            stated_nm_per_a=axis.stated_nm_per_a,
            stated_gear_ratio=config.gear_ratio.value,
            stated_gear_efficiency=config.gear_efficiency.value,
            residual_nm=float(rms_nm[at]) if np.isfinite(rms_nm[at]) else None,
            temperature_c=float(warm.mean()) if len(warm) else None,
            serial_number=serials.get(axis.joint),
        )
