"""Estimate of loads, friction and rotor inertia from moving runs.

Effects that the model lacks are not included. Without repeated motion the noise floor of a moving run is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.estimate import fitted_rows as rest_rows
from gateway.identify.knowledge import Knowledge
from gateway.identify.motion.columns import MovingSetup
from gateway.identify.motion.moving_fit import MotionFit, fit_motion
from gateway.identify.motion.moving_results import axis_motions, loads_of, nuisances
from gateway.identify.rest.linear import Fit
from gateway.model.motion import behind_gears
from gateway.model.robot import Robot
from gateway.result.result import AxisMotion, Finding

Floats = NDArray[np.float64]

#: Delay [s] of the torque above which it is reported.
_REPORTED_DELAY_S = 0.02


def estimate_moving(
    table: Table,
    robot: Robot,
    knowledge: Knowledge,
    motion: MovingSetup | None = None,
    rest: Fit | None = None,
) -> Estimate:
    """Fit the moving rows of a table.

    Parameters
    ----------
    table : Table
    robot : Robot
    knowledge : Knowledge
        Inertials, known loads, gravity.
    motion : MovingSetup, optional
    rest : Fit, optional
        Of rest visits of the same arm, which are solved with the moving rows.

    Raises
    ------
    InputError, DataUnusable : as of `fit_motion`
    """
    moving = behind_gears(table.take(table.moving), knowledge.efficiency, knowledge.coupling)
    found = fit_motion(moving, robot, knowledge, motion or MovingSetup(), rest)
    loads, periods = loads_of(found, robot), found.periods
    if found.fit is None:
        blank = np.full(moving.axes, np.nan)
        findings = (*found.findings, *periods.findings)
        return Estimate("moving", loads, blank, blank, set_aside=periods.set_aside, findings=findings)
    estimate = _estimate(found.fit, periods.mean)
    return replace(
        estimate,
        loads=loads,
        rows=estimate.rows if rest is None else rest_rows(rest.problem, rest),
        set_aside=periods.set_aside,
        findings=(*found.findings, *periods.findings, *estimate.findings),
    )


def _estimate(fit: MotionFit, moving: Table) -> Estimate:
    columns, solution, std = fit.columns, fit.settled.solution, fit.std
    found = np.isfinite(std)
    motions = axis_motions(fit, moving.qd_rad_s)
    band = np.full(moving.axes, np.nan)
    for one in motions:
        band[one.joint - 1] = abs(one.coulomb_nm)
    return Estimate(
        method="moving",
        loads=(),
        sigma_nm=np.full(moving.axes, np.nan),
        names=columns.names,
        units=columns.units,
        value=np.where(found, solution.value, np.nan),
        std=std,
        covariance=fit.spread.covariance,
        rows=_fitted_rows(fit, moving),
        band_nm=band,
        rank=solution.rank,
        condition=solution.condition,
        lumped=tuple(name for name, good in zip(columns.names, found, strict=True) if not good),
        findings=(*_delayed_axes(motions), _limits()),
        nuisance=nuisances(fit),
        motion=motions,
        quality={"rows": int(fit.problem.used.sum()), "parameters": len(columns.names)},
    )


def _fitted_rows(fit: MotionFit, moving: Table) -> FittedRows:
    """Measured and modelled torque of the used rows."""
    used = fit.problem.used
    blank = np.full(moving.tau_nm.shape, np.nan)
    return FittedRows(
        run=np.asarray(moving.run).astype(str),
        load=np.asarray(moving.load).astype(str),
        pose=np.asarray(moving.pose),
        time_s=moving.time_s,
        q_rad=moving.q_rad,
        direction=np.sign(moving.qd_rad_s).astype(int),
        tau_nm=np.where(used, moving.tau_nm, np.nan),
        model_nm=np.where(used, fit.settled.here.model_nm, np.nan),
        band_nm=blank,
        std_nm=np.where(used, fit.spread.std_nm, np.nan),
        leverage=blank,
    )


def _delayed_axes(motions: Sequence[AxisMotion]) -> list[Finding]:
    """Axes whose torque lags more than filters of a drive do."""
    return [
        Finding(
            "warn", f"J{one.joint}",
            f"its drive reports the torque {1000 * one.delay_s:.0f} ms after the position; the fit models the delay",
            "check the torque filter of the drive and the order of its PDOs: contact detection has the same delay",
        )
        for one in motions
        if one.delay_s > _REPORTED_DELAY_S
    ]  # fmt: skip


def _limits() -> Finding:
    return Finding(
        "info", "moving run",
        "the standard deviations include noise, torque constants and losses, not effects that the model lacks",
        "`servo-gateway diagnose` tests the model on parts of the run that were not used in the fit",
    )  # fmt: skip
