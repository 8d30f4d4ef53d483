"""Detect torques of a table that were not measured, and by the weight of the links a wrong torque unit."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from gateway.data.table import Table
from gateway.errors import DataUnusable, InputError
from gateway.identify.links import PER_LINK_AT_REST, has_inertials, link_values
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import pair_visits
from gateway.result.result import Finding

#: Extra column of the table: axes (n, N) that were left out because their torque does not scatter.
LEFT_OUT: Final = "axes_without_scatter"
#: Least number of samples, or of visits from both directions, from which equal torques are not chance.
_LEAST_SAMPLES: Final = 4
#: Relative difference of two torques that is rounding.
_ROUNDING: Final = 1e-6
#: Share of the gravity torque of the links below which the unit must be wrong; arms with balancers are above it.
LEAST_SHARE: Final = 1.0 / 30.0


def without_constant_torques(table: Table) -> Table:
    """Return the table with axes as not measured whose torque is the same in all samples.

    Raises
    ------
    DataUnusable
        That is every axis, or the torques of both approach directions are equal: computed torques, without friction.
    """
    measured = np.isfinite(table.tau_nm)
    low = np.where(measured, table.tau_nm, np.inf).min(axis=0)
    high = np.where(measured, table.tau_nm, -np.inf).max(axis=0)
    largest = np.abs(np.where(measured, table.tau_nm, 0.0)).max(axis=0)
    constant = (measured.sum(axis=0) >= _LEAST_SAMPLES) & (high - low <= _ROUNDING * largest)
    if constant.any() and (constant | ~measured.any(axis=0)).all():
        raise DataUnusable(
            f"{table.file[0]}: the torque of every axis is the same in all samples, so nothing was measured: check that"
            " the drives report torque and that the recording or log contains it"
        )
    halves = pair_visits(table.take(~table.moving)).difference_nm
    two_sided = np.isfinite(halves) & ~constant
    if two_sided.sum() >= _LEAST_SAMPLES and (np.abs(halves[two_sided]) <= _ROUNDING * largest.max()).all():
        raise DataUnusable(
            f"{table.file[0]}: the torques from both approach directions are equal on all axes. A real axis has"
            " friction: these torques look computed, not measured. Use the measured torque or current of the drives"
        )
    if not constant.any():
        return table
    tau, motor = (np.where(constant, np.nan, values) for values in (table.tau_nm, table.motor_torque_nm))
    marks = np.tile(constant, (len(table.load), 1))
    return replace(table, tau_nm=tau, motor_torque_nm=motor, extra={**table.extra, LEFT_OUT: marks})


def constant_torques(table: Table) -> tuple[Finding, ...]:
    """Return the finding on axes that `without_constant_torques` left out."""
    marks = table.extra.get(LEFT_OUT)
    if marks is None or not marks.any():
        return ()
    names = ", ".join(f"J{axis + 1}" for axis in np.flatnonzero(marks.any(axis=0)))
    what = "the torque is the same in all samples: it holds no information and was left out, as if not measured"
    return (Finding("warn", names, what, "check that this drive reports its torque", "torque_without_scatter"),)


def refuse_small_torques(table: Table, robot: Robot, gravity_m_s2: tuple[float, float, float]) -> None:
    """Refuse joint torques that are far below the gravity torque of the links.

    Raises
    ------
    InputError
        The torques are too small; the message names the ratio and the likely units.
    """
    at_rest = table.take(~table.moving)
    if not has_inertials(robot) or not len(at_rest.load):
        return
    links = link_values(robot)[:, :PER_LINK_AT_REST].ravel()
    needed_nm = gravity_regressor(robot, at_rest.q_rad, gravity_m_s2) @ links
    measured = np.isfinite(at_rest.tau_nm)
    square = float(np.sum(at_rest.tau_nm[measured] ** 2))
    share = np.sqrt(square / max(float(np.sum(needed_nm[measured] ** 2)), 1e-12))
    if share < LEAST_SHARE:
        raise InputError(
            f"{at_rest.file[0]}: the torques are {100 * share:.2g} % of the gravity torque of the links: they may be"
            " in kNm, of the motors, or currents in A. Use column tauN_nm for joint torque [Nm], taumN_nm for motor"
            " torque [Nm], iN_a for current [A]"
        )
