"""Calibrate torque constants from rest poses without a load and under a weighed load.

All gains are estimated in one step (Gautier and Briot 2011): the weighed load sets the scale of every axis that carries
it. The link masses of the robot model are not used, so that a wrong mass has no influence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from drives.errors import ProfileError
from gateway.cell.calibration import ArmCalibration, CalibratedAxis
from gateway.cell.config import ArmConfig
from gateway.data.labels import BARE_LABEL
from gateway.data.rows import Table
from gateway.errors import ConfigError, DataUnusable
from gateway.estimate.describe import axis_sigma, fitted_rows
from gateway.identify.drift import drift_findings, drift_of
from gateway.identify.nuisance import day_std
from gateway.identify.prior_loads import load_vector, require_postures
from gateway.identify.rejected import without_outliers
from gateway.identify.rest.hypothesis_fit import fit_to_report
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import nuisance_results
from gateway.model.visits import Visits, pair_visits
from gateway.pipeline.calibrated import serial_numbers
from gateway.pipeline.calibration_checks import (
    LARGEST_SHARE,
    PRIOR_STD,
    AxisCalibration,
    Weight,
    carried_by_none,
    common_finding,
    load_torque,
    mass_finding,
    stated_findings,
    stated_std,
    unknown_axes,
)
from gateway.pipeline.finalize import data_findings
from gateway.pipeline.inputs import AnalysisInputs, profile_of
from gateway.result.result import Finding

Floats = NDArray[np.float64]


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
        try:
            used = find(config.profile).needs_torque_constant
        except ProfileError:
            # a table needs no drive profile; its torque was computed elsewhere, with this constant
            used = True
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
            constant_nm_per_a=float(scale * value) if used else None,
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
