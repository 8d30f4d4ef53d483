"""Fit moving runs: rigid bodies, loads, and per axis Coulomb and viscous friction, rotor inertia and torque offset.

The baseline of the field: base parameters of the full regressor with friction, axes weighted by their residual. Rows in
which an axis is slower than a share of its speed limit are not used on that axis: friction at rest is a set. Residuals
of filtered data are autocorrelated; the covariance is widened by their correlation. Effects of the library are further
columns of the same model: a fit without any is the one that an estimate reports. The link masses of the robot model are
tested against the rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from gateway.data.periods import uninterrupted
from gateway.data.rows import Table
from gateway.errors import DataUnusable
from gateway.identify.alternatives import LINK_SCALE, wider_links
from gateway.identify.conflict import dropped, links_finding, without_placeholder
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import LoadEstimate, refused_load
from gateway.identify.model_conflict import motion_conflict
from gateway.identify.motion.columns import Columns, Effects, MovingSetup, SeenEffects, moving_columns
from gateway.identify.motion.periods import Periods, averaged
from gateway.identify.motion.prior import gains_prior, held_to_friction, with_common_part, with_run_scatter
from gateway.identify.motion.problem import MotionProblem, Settled, Still, about, settle, solved
from gateway.identify.motion.rest_rows import columns_beside
from gateway.identify.motion.stretches import Stretches
from gateway.identify.motion.uncertainty import MovingSpread, correlation_times, spread_of
from gateway.identify.nuisance import BIAS_SHARE, gain_stds
from gateway.identify.prior_loads import BARE_LABEL, unknown_labels
from gateway.identify.rest.linear import Fit
from gateway.identify.rest.rest_thresholds import CONFLICT
from gateway.identify.solve import Solution, determined
from gateway.model.motion import at_links, turns
from gateway.model.placeholders import wide_inertia
from gateway.model.robot import Robot
from gateway.result.result import Finding

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REWEIGHTS = 12
_SETTLED = 1e-3
_LEAST_SHARE = 1e-3
#: Largest difference between position change and integrated speed, as a share of the travel.
_MISMATCH = 0.5
#: Number of times that the weights are computed again from the residual of the full model.
_WEIGHTED_AGAIN = 2
#: Largest factor by which that may change a weight.
_MOST_REWEIGHTINGS = 10.0
#: Least standard deviation of a torque, as a share of its size, so that priors are not lost by rounding.
_FINEST = 1e-5
#: Prior of link masses that are stated as exact, for their test.
NEARLY_EXACT: Final = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class MotionFit:
    """Solution of a moving problem with its uncertainty."""

    problem: MotionProblem
    settled: Settled
    spread: MovingSpread

    @property
    def columns(self) -> Columns:
        """Columns of the problem."""
        return self.problem.columns

    @property
    def value(self) -> Floats:
        """Parameters (p,)."""
        return self.settled.solution.value

    @property
    def std(self) -> Floats:
        """Standard deviation (p,) of each parameter; NaN where the rows do not determine it."""
        found = determined(self.settled.solution, np.eye(len(self.columns.names)))
        return np.where(found, np.sqrt(np.maximum(np.diag(self.spread.covariance), 0.0)), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class FittedMotion:
    """Rows, their fit, and refused loads; no fit if all loads were refused.

    `findings`: statements that the rows contradict; a failing one refuses all loads.
    """

    periods: Periods
    fit: MotionFit | None
    refused: tuple[LoadEstimate, ...]
    findings: tuple[Finding, ...] = ()


def fit_motion(
    moving: Table,
    robot: Robot,
    knowledge: Knowledge,
    setup: MovingSetup,
    rest: Fit | None = None,
    effects: Effects | None = None,
) -> FittedMotion:
    """Fit moving rows; their torque is that at the gear output.

    Parameters
    ----------
    moving : Table
    robot : Robot
    knowledge : Knowledge
        Inertials, known loads, gravity, torque constants.
    setup : MovingSetup
    rest : Fit, optional
        Of rest visits of the same arm, which are solved with the moving rows.
    effects : Effects, optional
        Effects in addition to the nuisance parameters.

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        No axis moves while its torque is measured, or fewer rows than unknowns.
    """
    if not len(moving):
        raise DataUnusable("the data hold no moving rows")
    moving = at_links(moving)
    # Refuse speeds that contradict the positions: rows too far apart, or another unit
    off = Stretches.of(uninterrupted(moving), moving.time_s).mismatch(moving.q_rad, moving.qd_rad_s)
    axis = int(np.argmax(off))
    if off[axis] > _MISMATCH:
        raise DataUnusable(
            f"J{axis + 1}: from row to row the change of its position differs from its speed, by"
            f" {100 * off[axis]:.0f} % of the travel: the motion was sampled too slowly, or the speed has another unit;"
            " record at 100 Hz or more, speeds in rad/s"
        )
    periods = averaged(moving, _used(moving, robot, setup))
    sound, refused = _without_slipped(periods, knowledge)
    if not len(sound.mean):
        return FittedMotion(sound, None, refused)
    if refused:
        knowledge = knowledge.of_loads(sound.mean.load)
    trusted, placeholder = without_placeholder(robot, knowledge)
    fit, conflicts = _tested(sound, robot, trusted, setup, (rest, effects))
    findings = (*placeholder, *_wide_inertia(robot, trusted), *conflicts)
    if reasons := [finding.what for finding in conflicts if finding.severity == "fail"]:
        labels = (*unknown_labels(sound.mean.load, knowledge.known), *knowledge.parts)
        return FittedMotion(sound, None, (*refused, *(refused_load(each, reasons[0]) for each in labels)), findings)
    return FittedMotion(sound, fit, refused, findings)


def _wide_inertia(robot: Robot, knowledge: Knowledge) -> Iterator[Finding]:
    """Report the links whose inertia the fit treats as unknown."""
    wide = wide_inertia(robot)
    if not wide.any() or not 0.0 < knowledge.trust < np.inf:
        return
    names = ", ".join(name for name, placeholder in zip(robot.link_names, wide.tolist(), strict=True) if placeholder)
    what = "the URDF's inertia is too large for a link of this mass and size: a placeholder, taken as unknown"
    yield Finding("warn", names, what, "state the inertia of the data sheet in the URDF", "link_inertia_placeholder")


def _tested(
    periods: Periods,
    robot: Robot,
    knowledge: Knowledge,
    setup: MovingSetup,
    beside: tuple[Fit | None, Effects | None],
) -> tuple[MotionFit, tuple[Finding, ...]]:
    """Fit, and fit again with a wider prior of the link masses if the rows contradict them.

    A fit without nuisance parameters is not tested: it reproduces other programs' fits, and its rows contradict any
    robot model.
    """
    stated = fit = _fit(periods, robot, knowledge, setup, beside)
    if not setup.nuisances:
        return fit, ()
    if knowledge.trust == 0.0:
        knowledge = replace(knowledge, link_std=NEARLY_EXACT)
        stated = _fit(periods, robot, knowledge, setup, beside)
    bare = np.asarray(periods.mean.load) == BARE_LABEL
    wider = contradicted_links(stated.columns, stated.settled.solution, knowledge, bool(bare.any()))
    if wider is None:
        return fit, ()
    other = _fit(periods, robot, wider, setup, beside)
    rows = (bare | ~bare.any())[:, None] & other.problem.used
    conflict = contradiction(stated.columns, other, rows, wider.trust)
    return (fit, ()) if conflict is None else (other, (conflict,))


def _fit(
    periods: Periods,
    robot: Robot,
    knowledge: Knowledge,
    setup: MovingSetup,
    beside: tuple[Fit | None, Effects | None],
) -> MotionFit:
    moving, (rest, effects) = periods.mean, beside
    columns, still = columns_beside(moving, robot, knowledge, setup, rest)
    used = _used(moving, robot, setup)
    if used.sum() < columns.design.shape[2]:
        raise DataUnusable(
            f"{int(used.sum())} usable torque values in motion are fewer than the {columns.design.shape[2]} unknowns;"
            " record a longer run that moves all axes"
        )
    seen = None if effects is None else effects.of_rows(moving)
    # a fit without nuisance parameters is that of other programs
    low_pass = periods.low_pass if setup.nuisances else None
    scale_nm, level_nm = _weights(periods, robot, knowledge.of_loads(moving.load), setup, (used, low_pass, seen))
    columns = columns.with_effects(seen)
    if "bias" in setup.nuisances:
        # a free constant torque swallows the gravity of an unknown load
        offset = BIAS_SHARE if columns.loads else np.inf
        prior = held_to_friction(columns.prior, columns.names, level_nm, offset)
        columns = replace(columns, prior=prior)
    return _solved((columns, still), periods, (used, low_pass), scale_nm, knowledge)


def _used(moving: Table, robot: Robot, setup: MovingSetup) -> Mask:
    """Mask (n, N) of rows in which an axis is measured and moves, relative to its speed limit or its top speed."""
    top_rad_s = np.abs(moving.qd_rad_s).max(axis=0, initial=0.0)
    stated = np.isfinite(robot.velocity_rad_s) & (robot.velocity_rad_s > 0.0)
    fastest = np.where(stated, robot.velocity_rad_s, top_rad_s)
    return np.isfinite(moving.tau_nm) & turns(moving.qd_rad_s, fastest, setup.slow_share)


def _solved(
    rows: tuple[Columns, Still | None],
    periods: Periods,
    taken: tuple[Mask, csr_array | None],
    scale_nm: Floats,
    knowledge: Knowledge,
) -> MotionFit:
    """Solve with equal weights, weight each axis by its residual, and solve again."""
    run, (columns, still), (used, low_pass) = np.asarray(periods.mean.run), rows, taken
    scatter = periods.scatter if low_pass is None else periods.scatter.filtered(low_pass)
    problem = MotionProblem.of(columns, periods.mean, used, periods.contrasts, low_pass, still)
    problem = _with_gains(problem, knowledge, None)
    finest_nm = _FINEST * float(np.sqrt(np.mean(problem.tau_nm[used] ** 2)))
    scale_nm = np.maximum(scale_nm, finest_nm)
    settled = settle(problem, scale_nm)
    spread = spread_of(problem, settled, scale_nm, run, scatter)
    for _ in range(_WEIGHTED_AGAIN * bool(columns.nuisances)):
        prior = with_run_scatter(columns.prior, columns.names, settled.free.value, settled.free.covariance)
        columns = replace(columns, prior=prior)
        problem = _with_gains(replace(problem, columns=columns), knowledge, MotionFit(problem, settled, spread))
        least_nm = np.maximum(scale_nm / _MOST_REWEIGHTINGS, finest_nm)
        reweighted_nm = np.clip(spread.scale_nm, least_nm, _MOST_REWEIGHTINGS * scale_nm)
        settled = settle(problem, reweighted_nm, settled.here)
        spread = spread_of(problem, settled, reweighted_nm, run, scatter)
    return MotionFit(problem, settled, spread)


def _with_gains(problem: MotionProblem, knowledge: Knowledge, before: MotionFit | None) -> MotionProblem:
    """Return the problem with priors of the gains from the losses of a previous fit, common gain included."""
    columns = problem.columns
    if "gain" not in columns.nuisances:
        return problem
    prior = columns.prior
    if before is not None and "load_friction" in columns.nuisances:
        constants = gain_stds(knowledge.gain_std, len(columns.nuisances["gain"]))
        prior = gains_prior(prior, columns.nuisances, constants, before.value, before.std)
    prior = with_common_part(prior, columns.nuisances["gain"])
    return replace(problem, columns=replace(columns, prior=prior.freed(columns.taken)))


def _without_slipped(periods: Periods, knowledge: Knowledge) -> tuple[Periods, tuple[LoadEstimate, ...]]:
    """Return the periods without slipped loads, and these loads."""
    gone = {
        label: why for label, why in periods.slipped.items() if label != BARE_LABEL and label not in knowledge.known
    }
    if not gone:
        return periods, ()
    kept = ~np.isin(np.asarray(periods.mean.load), list(gone))
    sound = replace(periods, mean=periods.mean.take(kept), excitation=periods.excitation[kept])
    return sound, tuple(refused_load(label, why) for label, why in gone.items())


def _weights(
    periods: Periods,
    robot: Robot,
    knowledge: Knowledge,
    setup: MovingSetup,
    rows: tuple[Mask, csr_array | None, SeenEffects | None],
) -> tuple[Floats, Floats]:
    """Standard deviation of each part from its residual in a fit with free links, and Coulomb friction (N,) of that
    fit.
    """
    moving, (used, low_pass, seen) = periods.mean, rows
    plain = replace(setup, nuisances=tuple(name for name in setup.nuisances if name == "load_inertia"))
    trust = knowledge.trust if setup.passes is not None else np.inf
    columns = moving_columns(moving, robot, replace(knowledge, link_std=trust), plain).with_effects(seen)
    problem = MotionProblem.of(columns, moving, used, periods.contrasts, low_pass)
    solution, sigma = _reweighted(problem, setup.passes or _REWEIGHTS)
    level_nm = np.maximum(np.abs(columns.dry(solution.value)), _LEAST_SHARE * sigma.max())
    if not setup.nuisances:
        return sigma, level_nm
    # the weight of the rows against the priors counts independent rows only
    left = moving.tau_nm - about(problem, solution.value).model_nm
    return sigma * np.sqrt(correlation_times(problem, left, np.asarray(moving.run))), level_nm


def _reweighted(problem: MotionProblem, passes: int) -> tuple[Solution, Floats]:
    """Solve again with each axis weighted by its previous residual (N,); the first weights are one."""
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
    """Root mean square of the residual of each part; the orthonormal basis preserves lengths."""
    ends = np.cumsum([len(part.factor) for part in problem.parts])[:-1]
    lengths = [float(np.linalg.norm(left)) for left in np.split(solution.residual, ends)]
    return np.array(lengths) / np.sqrt([len(part.rows) for part in problem.parts])


def contradicted_links(columns: Columns, solution: Solution, knowledge: Knowledge, unloaded: bool) -> Knowledge | None:
    """Return the knowledge with the link prior that the rows support; None if that is the stated one.

    They are dropped only where the arm was measured `unloaded`: else load and last link could not be separated.

    Another prior has a marginal likelihood over that of the stated one. It is the mean of the ratio of both densities
    over the posterior of the fit, Gaussian and so in closed form.
    """
    links = columns.links
    rows = columns.prior.rows[:, links]
    precision = rows.T @ rows
    held = np.diag(precision) > 0.0
    if not held.any():
        return None
    precision, mean = precision[np.ix_(held, held)], columns.prior.mean[links][held]
    covariance = solution.covariance[np.ix_(links[held], links[held])]
    step = solution.value[links][held] - mean

    def odds(change: Floats, log_density: float) -> float:
        """Log odds of a prior whose precision differs by `change`, with the change of its normalisation."""
        mixed = np.eye(len(step)) + covariance @ change
        pull = float(step @ change @ np.linalg.solve(mixed, step))
        return log_density - 0.5 * (float(np.linalg.slogdet(mixed)[1]) + pull)

    trust, best, found = knowledge.trust, CONFLICT.log_odds, None
    for wider in wider_links(trust):
        ratio = trust / wider
        value = odds((ratio**2 - 1.0) * precision, len(step) * float(np.log(ratio)))
        if value > best:
            best, found = value, replace(knowledge, link_std=wider)
    tied = precision @ mean
    size = LINK_SCALE**2 * float(mean @ tied)
    if odds(-np.outer(tied, tied) * LINK_SCALE**2 / (1.0 + size), -0.5 * float(np.log1p(size))) > best:
        return replace(knowledge, link_std=np.inf if unloaded else LINK_SCALE)
    return dropped(knowledge, found) if found is not None and unloaded else found


def contradiction(stated: Columns, fit: MotionFit, rows: Mask, trust: float) -> Finding | None:
    """Report a large contradiction of the robot model, or the axis whose torque of the bodies differs most from it.

    Parameters
    ----------
    stated : Columns
        With the prior that is contradicted.
    fit : MotionFit
        With the wider prior.
    rows : bool array of shape (n, N)
        Of the unloaded arm, where an axis is used.
    trust : float
        Relative standard deviation of the link masses now.

    Returns
    -------
    Finding or None
        A failing one after a large contradiction; None where both agree within the uncertainty.
    """
    columns, value = fit.columns, fit.value
    own, links = columns.links, stated.links
    expected_nm = rows * (stated.design[:, :, links] @ stated.prior.mean[links])
    found_nm = rows * (columns.design[:, :, own] @ value[own])
    part = fit.spread.covariance[np.ix_(own, own)]
    spread = np.einsum("nak,kl,nal->na", columns.design[:, :, own], part, columns.design[:, :, own], optimize=True)

    def rms(values: Floats) -> Floats:
        return np.sqrt((values * rows).sum(axis=0) / np.maximum(rows.sum(axis=0), 1))

    std = np.maximum(rms(spread), 1e-9)
    away = rms((found_nm - expected_nm) ** 2) / std
    axis = int(np.argmax(away))
    if away[axis] <= CONFLICT.shown:
        return None
    torque = float(rms(expected_nm**2)[axis]), float(rms(found_nm**2)[axis]), float(std[axis])
    large = motion_conflict(expected_nm, found_nm, np.abs(columns.dry(value)))
    return large or links_finding(axis, torque, "in motion (rms)", trust)
