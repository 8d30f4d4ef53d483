"""Checks before a calibration is stored: load, stated constants, and previous calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.calibration import ArmCalibration, CalibratedAxis
from gateway.errors import ConfigError, DataUnusable
from gateway.estimate.joint import estimate_joint
from gateway.identify.knowledge import Knowledge
from gateway.identify.nuisance import COMMON_SHARE, gain_stds
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.pipeline.inputs import AnalysisInputs
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
