"""What is known of a load so far, and what one more rest pose would add to it: the arithmetic of what to measure next.

All that a fit holds takes part: links with their priors or bare rows, gains of the torque constants, torque offsets of
the friction bands, the load. A pose from both sides adds a row per axis; the covariance after it follows by Woodbury's
identity, `C - C D' (S + D C D')^-1 D C`, for hundreds of postures at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.describe import describe
from gateway.estimate.fitting import Fitted, fit_problem
from gateway.estimate.joint import contradiction
from gateway.estimate.options import EstimateOptions
from gateway.estimate.problem import Problem, build_problem, link_knowledge
from gateway.identify.links import PER_LINK_AT_REST
from gateway.identify.load_estimate import LoadEstimate, load_directions
from gateway.identify.loads import bare_and_gain_rows
from gateway.identify.nuisance import BIAS_SHARE, gain_stds
from gateway.model.regressor import LOAD_COLUMNS
from gateway.model.robot import Robot, reach_m
from gateway.model.visits import Visits

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Before anything of a load was measured, its mass is taken as known to so many times the guess.
_WIDE: Final = 3.0
#: Directions that nothing determines yet have this standard deviation, over the length of their scaled columns.
_OPEN: Final = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class PoseNoise:
    """Noise of an axis's half-sum at a pose to come.

    Attributes
    ----------
    friction_nm2 : array of shape (N,)
        Variance of what friction leaves after both approaches [Nm2]; NaN = the axis is not measured.
    sample_nm2 : array of shape (N,)
        Variance of one sample of one side [Nm2].
    """

    friction_nm2: Floats
    sample_nm2: Floats

    def variance(self, samples: int) -> Floats:
        """Variance (N,) [Nm2] of the half-sum of so many samples a side."""
        return self.friction_nm2 + self.sample_nm2 / (2.0 * samples)

    def samples(self, visit_s: float, period_s: float, least: int, most: int) -> int:
        """Samples a side that tell most per second of a pose that takes `visit_s` without them.

        Minimises `(f + s / 2n) (T + 2 n dt)`, so `n = sqrt(s T / (4 f dt))`, on the axis that asks for most.
        """
        told = np.isfinite(self.friction_nm2) & np.isfinite(self.sample_nm2) & (self.sample_nm2 > 0)
        if not told.any():
            return most
        friction = np.maximum(self.friction_nm2[told], 1e-300)
        wanted = float(np.sqrt(self.sample_nm2[told] * visit_s / (4.0 * friction * period_s)).max())
        return int(np.clip(np.ceil(min(wanted, most)), min(least, most), most))


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Covariance of what a fit of rest rows has as unknowns, and how a row of a further pose stands to it.

    Attributes
    ----------
    covariance : array of shape (p, p)
    columns : int array of shape (k,)
        Which of the 4 N link columns the first k unknowns are.
    links : array of shape (4 N,)
        Links as far as they are known or fitted.
    load : int
        First of the load's four unknowns.
    moment : array of shape (4,)
        [m, hx, hy, hz] of the load, as fitted or guessed.
    axis : int array of shape (a,)
        Measured axes.
    offset, gain : int arrays of shape (a,)
        Their torque offsets and gains among the unknowns.
    gain_value : array of shape (a,)
    noise : PoseNoise
    """

    covariance: Floats
    columns: Ints
    links: Floats
    load: int
    moment: Floats
    axis: Ints
    offset: Ints
    gain: Ints
    gain_value: Floats
    noise: PoseNoise

    @property
    def std(self) -> Floats:
        """Standard deviation (4,) of mass [kg] and centre of gravity [m]."""
        return self._std(self.covariance[self._own, self._own])

    def std_given(self, known: Ints) -> Floats:
        """The same (4,), were these unknowns known."""
        shared = self.covariance[self._own, known]
        gained = np.linalg.lstsq(self.covariance[np.ix_(known, known)], shared.T, rcond=None)[0]
        return self._std(self.covariance[self._own, self._own] - shared @ gained)

    @property
    def _own(self) -> slice:
        return slice(self.load, self.load + 4)

    def _std(self, own: Floats) -> Floats:
        turn = load_directions(self.moment)
        return np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", turn, own, turn), 0.0))

    def rows(self, regressor: Floats) -> Floats:
        """Rows (n, a, p) of further poses, of their gravity regressors (n, N, 4 N)."""
        here = regressor[:, self.axis]
        scale = (1.0 + self.gain_value)[None, :, None]
        out = np.zeros((*here.shape[:2], len(self.covariance)))
        out[:, :, : len(self.columns)] = scale * here[:, :, self.columns]
        out[:, :, self._own] = scale * here[:, :, LOAD_COLUMNS]
        place = np.arange(len(self.axis))
        out[:, place, self.offset] = 1.0
        out[:, place, self.gain] = here @ self.links + here[:, :, LOAD_COLUMNS] @ self.moment
        return out

    def std_after(self, regressor: Floats, samples: int) -> Floats:
        """Standard deviations (n, 4) of mass and centre of gravity, each pose measured besides what was.

        Parameters
        ----------
        regressor : array of shape (n, N, 4 N)
            Gravity regressors of the poses.
        samples : int
            A side.
        """
        rows = self.rows(regressor)
        reach = rows @ self.covariance
        spread = np.matmul(reach, rows.transpose(0, 2, 1)) + np.diag(self.noise.variance(samples)[self.axis])
        turn = load_directions(self.moment)
        seen = reach[:, :, self._own] @ turn.T
        gained = np.einsum("nak,nak->nk", seen, np.linalg.solve(spread, seen))
        return np.sqrt(np.maximum(self.std**2 - gained, 0.0))

    def with_poses(self, regressor: Floats, samples: int, count: int) -> Outlook:
        """What will be known after `count` poses as that of this regressor (N, 4 N), the load as it is taken now."""
        rows = self.rows(regressor[None])[0]
        reach = rows @ self.covariance
        spread = reach @ rows.T + np.diag(self.noise.variance(samples)[self.axis]) / count
        after = self.covariance - reach.T @ np.linalg.solve(spread, reach)
        return replace(self, covariance=(after + after.T) / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sought:
    """A load that is to be known.

    Attributes
    ----------
    label : str
    guess : array of shape (4,)
        [m, hx, hy, hz] as long as nothing was measured.
    sample_std_nm : array of shape (N,)
        Standard deviation of one sample [Nm]; NaN = not known.
    """

    label: str
    guess: Floats
    sample_std_nm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Stock:
    """What is known of a load: as estimated (None before its first pose), why it is refused if it is, the outlook."""

    load: LoadEstimate | None
    refused: str | None
    outlook: Outlook


def take_stock(visits: Visits, robot: Robot, options: EstimateOptions, sought: Sought) -> Stock:
    """What these visits tell of a load, and what is still open.

    Parameters
    ----------
    visits : Visits
        Gross torques set aside.
    robot : Robot
    options : EstimateOptions
    sought : Sought

    Raises
    ------
    InputError, DataUnusable
        As the joint estimator; one posture of the load is no error here.
    """
    problem = build_problem(visits, robot, options)
    fitted = fit_problem(problem, options)
    solution = fitted.fit.solution
    wide = solution.null * _OPEN
    covariance, value = fitted.fit.covariance + wide @ wide.T, solution.value
    estimated: LoadEstimate | None = None
    refused: str | None = None
    if sought.label in problem.loads:
        first = problem.loads[sought.label]
        moment = value[first : first + 4]
        found = describe(fitted, robot, options).loads
        estimated = next(load for load in found if load.label == sought.label)
        refused = contradiction(problem, fitted.fit, robot, options, sought.label)
    else:
        covariance, first = _with_unknown_load(covariance, sought.guess, robot)
        moment = sought.guess
    count = len(problem.links.columns)
    links = problem.links.fixed.copy()
    links[problem.links.columns] = value[:count]
    known = Outlook(
        covariance=covariance,
        columns=problem.links.columns,
        links=links,
        load=first,
        moment=moment,
        axis=problem.offset_axis,
        offset=problem.offsets,
        gain=problem.gains,
        gain_value=value[problem.gains],
        noise=PoseNoise(_friction(problem, fitted), np.nan_to_num(sought.sample_std_nm) ** 2),
    )
    return Stock(estimated, refused, known)


def outlook_of_priors(
    robot: Robot, options: EstimateOptions, guess: Floats, band_nm: Floats, noise: PoseNoise
) -> Outlook:
    """What is known of a load before any visit: the links by their priors or a stored bare identification.

    Parameters
    ----------
    robot : Robot
    options : EstimateOptions
    guess : array of shape (4,)
        Of the load's mass and first moment.
    band_nm : array of shape (N,)
        Friction bands.
    noise : PoseNoise
    """
    known = link_knowledge(robot, options)
    count, axes = len(known.columns), robot.axes
    gain, offset = count + np.arange(axes), count + axes + np.arange(axes)
    std = np.concatenate([known.std[known.columns], gain_stds(options.gain_std, axes), BIAS_SHARE * band_nm])
    held = np.isfinite(std)
    information = np.diag(np.where(held, 1.0 / np.where(held, std, 1.0), 0.0) ** 2)
    links = known.fixed.copy()
    links[known.held] = known.mean[known.held]
    gain_value = np.zeros(axes)
    if options.bare is not None:
        rows, _ = bare_and_gain_rows(options.bare)
        further = np.zeros((len(rows), count + 2 * axes))
        further[:, :count] = rows[:, known.columns]
        further[:, gain] = rows[:, PER_LINK_AT_REST * axes :]
        information += further.T @ further
        if options.bare.gain:
            gain_value = np.nan_to_num(np.asarray(options.bare.gain, dtype=float))
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    size, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    turned = vectors / scale[:, None]
    covariance = (turned / np.maximum(size, _OPEN**-2)) @ turned.T
    covariance, first = _with_unknown_load(covariance, guess, robot)
    axis = np.arange(axes)
    return Outlook(covariance, known.columns, links, first, guess, axis, offset, gain, gain_value, noise)


def _with_unknown_load(covariance: Floats, guess: Floats, robot: Robot) -> tuple[Floats, int]:
    """The covariance with four more unknowns, and the first of them."""
    first = len(covariance)
    mass_kg = _WIDE * float(guess[0])
    out = np.zeros((first + 4, first + 4))
    out[:first, :first] = covariance
    out[first:, first:] = np.diag([mass_kg, *[mass_kg * reach_m(robot) / 3.0] * 3]) ** 2
    return out, first


def _friction(problem: Problem, fitted: Fitted) -> Floats:
    """Variance (N,) that friction leaves in the half-sum of both sides, as the fit found it."""
    left = np.full(problem.visits.axes, np.nan)
    left[problem.offset_axis] = fitted.fit.extra[problem.offset_axis]
    return left
