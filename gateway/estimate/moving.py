"""Moving runs: rigid bodies, loads, and per axis Coulomb and viscous friction, rotor inertia and torque offset.

The baseline of the field: base parameters of the full regressor with friction, axes weighted by their residual. Rows in
which an axis is slower than a share of its speed limit are not used on that axis: friction at rest is a set. Residuals
of filtered data hang together in time; the covariance is widened by their correlation. What the model lacks is not in
it: with no repeated motion the noise floor of a moving run is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.errors import DataUnusable
from gateway.estimate.describe import fitted_rows as rest_rows
from gateway.estimate.estimate import Estimate
from gateway.estimate.moving_columns import Columns, MovingSetup, fast_rows, moving_columns
from gateway.estimate.moving_describe import MotionFit, axis_motions, described_load, fitted_rows, nuisances
from gateway.estimate.moving_noise import correlation_times, spread_of
from gateway.estimate.moving_ordinary import settle
from gateway.estimate.moving_periods import Periods, averaged
from gateway.estimate.moving_prior import alike, gains_prior, held_to_friction, losses_seen
from gateway.estimate.moving_problem import MotionProblem, Still, about, solved
from gateway.estimate.moving_time import Stretches
from gateway.estimate.options import EstimateOptions
from gateway.estimate.together import FittedRest, columns_beside
from gateway.identify.load_estimate import LoadEstimate, refused_load
from gateway.identify.loads import BARE_LABEL
from gateway.identify.nuisance import gain_stds
from gateway.identify.solve import Solution
from gateway.model.motion import behind_gears
from gateway.model.robot import Robot, reach_m
from gateway.result.result import AxisMotion, Finding

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REWEIGHTS = 12
_SETTLED = 1e-3
_LEAST_SHARE = 1e-3
#: Share of its way by which an axis may go otherwise than its speed says.
_MISMATCH = 0.5
#: Delay [s] beyond which a drive is late.
_LATE_S = 0.02
#: Times that the parts are weighed anew by what the whole model leaves of them: free links take up too much.
_WEIGHED_ANEW = 2
#: Times by which that may change a weight: beyond, priors keep a fit from what the rows say, or count for nothing.
_MOST_ANEW = 10.0
#: Share of its size to which no torque is weighed better: beyond, a prior is lost in the rounding of the rows.
_FINEST = 1e-5


def estimate_moving(
    table: Table,
    robot: Robot,
    options: EstimateOptions,
    motion: MovingSetup | None = None,
    rest: FittedRest | None = None,
) -> Estimate:
    """Fit the moving rows of a table.

    Parameters
    ----------
    table : Table
    robot : Robot
    options : EstimateOptions
        Inertials, known loads, gravity.
    motion : MovingSetup, optional
    rest : Fitted, optional
        Rest visits of the same arm, which are solved with the moving rows.

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        No axis moves while its torque is measured, or fewer rows than unknowns.
    """
    motion = MovingSetup() if motion is None else motion
    moving = behind_gears(table.take(table.moving), options.efficiency, options.coupling)
    if not len(moving):
        raise DataUnusable("the data hold no moving rows")
    _check_speeds(moving)
    periods = averaged(moving, np.isfinite(moving.tau_nm) & fast_rows(moving.qd_rad_s, robot, motion))
    sound, refused = _without_slipped(periods, options)
    if not len(sound.mean):
        blank = np.full(moving.axes, np.nan)
        return Estimate("moving", refused, blank, blank, set_aside=sound.set_aside, findings=sound.findings)
    found = _fit(sound, robot, options.of_loads(sound.mean.load) if refused else options, (motion, rest))
    return replace(
        found,
        loads=(*found.loads, *refused),
        set_aside=sound.set_aside,
        findings=(*sound.findings, *found.findings),
    )


def _fit(
    periods: Periods, robot: Robot, options: EstimateOptions, how: tuple[MovingSetup, FittedRest | None]
) -> Estimate:
    moving, (motion, rest) = periods.mean, how
    columns, still = columns_beside(moving, robot, options, motion, rest)
    used = np.isfinite(moving.tau_nm) & fast_rows(moving.qd_rad_s, robot, motion)
    if used.sum() < columns.design.shape[2]:
        raise DataUnusable(
            f"{int(used.sum())} usable torque values in motion are fewer than the {columns.design.shape[2]} unknowns;"
            " record a longer run that moves all axes"
        )
    scale_nm, level_nm = _weights(periods, robot, options.of_loads(moving.load), motion, used)
    if "uneven_friction" in motion.ordinary:
        prior = held_to_friction(columns.prior, columns.names, level_nm, offsets=bool(columns.loads))
        columns = replace(columns, prior=prior)
    fit = _solved((columns, still), periods, used, scale_nm, options)
    found = _estimate(fit, moving, robot)
    return found if rest is None or still is None else replace(found, rows=rest_rows(rest.problem, rest.fit))


def _check_speeds(moving: Table) -> None:
    """Refuse speeds that are not those of the positions: rows too far apart, or another unit.

    Raises
    ------
    DataUnusable
    """
    off = Stretches.of(np.asarray(moving.run), moving.time_s).mismatch(moving.q_rad, moving.qd_rad_s)
    axis = int(np.argmax(off))
    if off[axis] > _MISMATCH:
        raise DataUnusable(
            f"J{axis + 1}: from row to row its position goes otherwise than its speed says, by"
            f" {100 * off[axis]:.0f} % of the way: the motion was sampled too slowly, or the speed is in another unit;"
            " record at 100 Hz or more, speeds in rad/s"
        )


def _late(motions: Sequence[AxisMotion]) -> list[Finding]:
    """Axes whose torque lags more than filters of a drive do."""
    return [
        Finding(
            "warn", f"J{one.joint}",
            f"its drive reports the torque {1000 * one.delay_s:.0f} ms late; the fit allows for it",
            "see the torque filter of the drive and the order of its PDOs, since a watch on contact is as late",
        )
        for one in motions
        if one.delay_s > _LATE_S
    ]  # fmt: skip


def _solved(
    rows: tuple[Columns, Still | None], periods: Periods, used: Mask, scale_nm: Floats, options: EstimateOptions
) -> MotionFit:
    """Settle, weigh the parts anew by what the whole model leaves of them, and settle again."""
    run, (columns, still) = np.asarray(periods.mean.run), rows
    problem = MotionProblem.of(columns, periods.mean, used, periods.contrasts, still)
    problem = _with_gains(problem, options, None)
    finest_nm = _FINEST * float(np.sqrt(np.mean(problem.tau_nm[used] ** 2)))
    scale_nm = np.maximum(scale_nm, finest_nm)
    settled = settle(problem, scale_nm)
    spread = spread_of(problem, settled, scale_nm, run, periods.scatter)
    for _ in range(_WEIGHED_ANEW * bool(columns.ordinary)):
        problem = _with_gains(replace(problem, columns=columns), options, MotionFit(problem, settled, spread))
        least_nm = np.maximum(scale_nm / _MOST_ANEW, finest_nm)
        anew_nm = np.clip(spread.scale_nm, least_nm, _MOST_ANEW * scale_nm)
        settled = settle(problem, anew_nm, settled.here)
        spread = spread_of(problem, settled, anew_nm, run, periods.scatter)
    return MotionFit(problem, settled, spread)


def _with_gains(problem: MotionProblem, options: EstimateOptions, before: MotionFit | None) -> MotionProblem:
    """The problem with what is known of the gains: by the losses that a fit before it shows, and of all together."""
    columns = problem.columns
    if "gain" not in columns.ordinary:
        return problem
    prior = columns.prior
    if before is not None and "load_friction" in columns.ordinary:
        lost = losses_seen(prior, columns.ordinary, before.value, before.std)
        prior = gains_prior(prior, columns.ordinary, gain_stds(options.gain_std, len(lost)), lost)
    if options.gain_std is None:
        prior = alike(prior, columns.ordinary["gain"])
    return replace(problem, columns=replace(columns, prior=prior))


def _without_slipped(periods: Periods, options: EstimateOptions) -> tuple[Periods, tuple[LoadEstimate, ...]]:
    """The periods without loads that did not stay as they were, and those loads."""
    gone = {label: why for label, why in periods.slipped.items() if label != BARE_LABEL and label not in options.known}
    if not gone:
        return periods, ()
    kept = ~np.isin(np.asarray(periods.mean.load), list(gone))
    sound = replace(periods, mean=periods.mean.take(kept), excitation=periods.excitation[kept])
    return sound, tuple(refused_load(label, why) for label, why in gone.items())


def _weights(
    periods: Periods, robot: Robot, options: EstimateOptions, motion: MovingSetup, used: Mask
) -> tuple[Floats, Floats]:
    """Standard deviation by which each part is weighted, its residual in a fit with free link parameters; and the
    Coulomb friction (N,) of that fit.
    """
    moving = periods.mean
    plain = replace(motion, ordinary=tuple(name for name in motion.ordinary if name == "load_inertia"))
    trust = options.inertials if motion.passes is not None else "ignore"
    columns = moving_columns(moving, robot, replace(options, inertials=trust), plain)
    problem = MotionProblem.of(columns, moving, used, periods.contrasts)
    solution, sigma = _reweighted(problem, motion.passes or _REWEIGHTS)
    level_nm = np.maximum(np.abs(columns.dry(solution.value)), _LEAST_SHARE * sigma.max())
    if not motion.ordinary:
        return sigma, level_nm
    # a prior is weighed against rows that are as good as they are independent
    left = moving.tau_nm - about(problem, solution.value).model_nm
    return sigma * np.sqrt(correlation_times(problem, left, np.asarray(moving.run))), level_nm


def _reweighted(problem: MotionProblem, passes: int) -> tuple[Solution, Floats]:
    """Solution with every axis weighted by its residual (N,) in the pass before; the first weights are one."""
    target = np.where(problem.used, problem.tau_nm - problem.columns.known_nm, 0.0)
    least = 1e-6 * max(float(np.sqrt((target**2).sum() / max(int(problem.used.sum()), 1))), 1e-12)
    sigma = np.ones(len(problem.parts))
    solution = solved(problem, None, sigma, problem.columns.prior)
    for _ in range(passes - 1):
        new = np.maximum(_residual_rms(problem, solution), least)
        if np.allclose(new, sigma, rtol=_SETTLED):
            break
        sigma = new
        solution = solved(problem, None, sigma, problem.columns.prior)
    return solution, sigma


def _residual_rms(problem: MotionProblem, solution: Solution) -> Floats:
    """Root mean square of the residual of each part. The basis keeps lengths."""
    ends = np.cumsum([len(part.factor) for part in problem.parts])[:-1]
    lengths = [float(np.linalg.norm(left)) for left in np.split(solution.residual, ends)]
    return np.array(lengths) / np.sqrt([len(part.rows) for part in problem.parts])


def _estimate(fit: MotionFit, moving: Table, robot: Robot) -> Estimate:
    columns, solution, std = fit.columns, fit.settled.solution, fit.std
    found = np.isfinite(std)
    motions = axis_motions(fit, moving.qd_rad_s)
    band = np.full(moving.axes, np.nan)
    for one in motions:
        band[one.joint - 1] = abs(one.coulomb_nm)
    return Estimate(
        method="moving",
        loads=tuple(described_load(fit, label, reach_m(robot)) for label in columns.loads),
        sigma_nm=np.full(moving.axes, np.nan),
        names=columns.names,
        units=columns.units,
        value=np.where(found, solution.value, np.nan),
        std=std,
        covariance=fit.spread.covariance,
        rows=fitted_rows(fit, moving),
        band_nm=band,
        rank=solution.rank,
        condition=solution.condition,
        lumped=tuple(name for name, good in zip(columns.names, found, strict=True) if not good),
        findings=(*_late(motions), _limits()),
        nuisance=nuisances(fit),
        motion=motions,
        quality={"rows": int(fit.problem.used.sum()), "parameters": len(columns.names)},
    )


def _limits() -> Finding:
    return Finding(
        "info", "moving run",
        "the standard deviations hold for noise, torque constants and losses, not for effects the model lacks",
        "diagnose judges the model on parts of the run that no fit has seen",
    )  # fmt: skip
