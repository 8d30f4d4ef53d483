"""Expected covariance of a load after further rest poses, to choose what to measure next.

All unknowns of the fit are included: links with their priors or unloaded rows, gains of the torque constants, torque
offsets of the friction bands, the load. A pose approached from both sides adds a row per axis. The covariance follows
from Woodbury's identity, `C - C D' (S + D C D')^-1 D C`, for hundreds of postures at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.estimate import axis_sigma
from gateway.estimate.joint import refused_loads
from gateway.identify.knowledge import Knowledge
from gateway.identify.links import PER_LINK_AT_REST
from gateway.identify.load_estimate import LoadEstimate, load_directions
from gateway.identify.nuisance import BIAS_SHARE, change_covariance, gain_stds
from gateway.identify.prior_loads import bare_rows
from gateway.identify.rest.hypothesis_fit import fit_without_effects, with_place_effects
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem, open_link_prior
from gateway.identify.rest.rest_loads import load_estimates
from gateway.identify.rest.rest_nuisance import KINDS
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
    """Noise of an axis's half-sum at a future pose.

    Attributes
    ----------
    friction_nm2 : array of shape (N,)
        Variance that friction leaves in the half-sum of both approaches [Nm2]; NaN = the axis is not measured.
    sample_nm2 : array of shape (N,)
        Variance of one sample of one approach [Nm2].
    """

    friction_nm2: Floats
    sample_nm2: Floats

    def variance(self, samples: int) -> Floats:
        """Variance (N,) [Nm2] of the half-sum with this number of samples per approach."""
        return self.friction_nm2 + self.sample_nm2 / (2.0 * samples)


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedInformation:
    """Covariance of the unknowns of a rest fit, with their positions, to predict the effect of further poses.

    Attributes
    ----------
    covariance : array of shape (p, p)
    links : array of shape (4 N,)
        As known or fitted; their columns come first.
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
        """Standard deviation (4,) of mass and centre of gravity if these unknowns were known exactly."""
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
        """Rows (n, a, p) of further poses from their gravity regressors (n, N, 4 N)."""
        here = regressor[:, self.axis]
        scale = (1.0 + self.gain_value)[None, :, None]
        out = np.zeros((*here.shape[:2], len(self.covariance)))
        out[:, :, : here.shape[2]] = scale * here
        out[:, :, self._own] = scale * here[:, :, LOAD_COLUMNS]
        place = np.arange(len(self.axis))
        out[:, place, self.offset] = 1.0
        out[:, place, self.gain] = here @ self.links + here[:, :, LOAD_COLUMNS] @ self.moment
        return out

    def std_after(self, regressor: Floats, samples: int) -> Floats:
        """Standard deviations (n, 4) of mass and centre of gravity after measuring one of n further poses.

        Parameters
        ----------
        regressor : array of shape (n, N, 4 N)
            Gravity regressors of the poses.
        samples : int
            Per approach direction.
        """
        rows = self.rows(regressor)
        reach = rows @ self.covariance
        spread = np.matmul(reach, rows.transpose(0, 2, 1)) + np.diag(self.noise.variance(samples)[self.axis])
        turn = load_directions(self.moment)
        seen = reach[:, :, self._own] @ turn.T
        gained = np.einsum("nak,nak->nk", seen, np.linalg.solve(spread, seen))
        return np.sqrt(np.maximum(self.std**2 - gained, 0.0))

    def with_poses(self, regressor: Floats, samples: int, count: int) -> ExpectedInformation:
        """Return the expected information after `count` poses with this regressor (N, 4 N)."""
        rows = self.rows(regressor[None])[0]
        reach = rows @ self.covariance
        spread = reach @ rows.T + np.diag(self.noise.variance(samples)[self.axis]) / count
        after = self.covariance - reach.T @ np.linalg.solve(spread, reach)
        return replace(self, covariance=(after + after.T) / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sought:
    """Load to be estimated, with the values assumed before it is measured.

    Attributes
    ----------
    label : str
    guess : array of shape (4,)
        [m, hx, hy, hz] assumed before anything is measured.
    sample_std_nm : array of shape (N,)
        Standard deviation of one sample [Nm]; NaN = not known.
    """

    label: str
    guess: Floats
    sample_std_nm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Stock:
    """Present knowledge of a load: estimate (None before its first pose), reason of a refusal, expected information."""

    load: LoadEstimate | None
    refused: str | None
    information: ExpectedInformation


def take_stock(visits: Visits, robot: Robot, knowledge: Knowledge, sought: Sought) -> Stock:
    """Estimate a load from these visits, with the covariance for predicting further poses.

    Parameters
    ----------
    visits : Visits
        Visits without outliers.
    robot : Robot
    knowledge : Knowledge
    sought : Sought

    Raises
    ------
    InputError, DataUnusable
        As of the joint estimator, except that a single posture of the load is accepted.
    """
    problem = build_problem(robot, visits, knowledge)
    plain = fit_without_effects(problem)
    fit = with_place_effects(plain)
    wide = fit.null * _OPEN
    gain, offset = (problem.nuisance_part.start + KINDS.index(kind) * problem.axes for kind in ("gain", "bias"))
    gains = slice(gain, gain + problem.axes)
    measured = np.flatnonzero(visits.load == sought.label)
    last = _last(visits) if not len(measured) else measured[_last(visits.take(measured))]
    complete = np.eye(problem.n_common)
    next_visit = replace(visits.take(np.array([last])), load=np.array([sought.label]))
    complete[gains] = problem.gains_at(next_visit)[0]
    covariance = complete @ (fit.covariance + wide @ wide.T) @ complete.T
    estimated: LoadEstimate | None = None
    refused: str | None = None
    if sought.label in problem.labels:
        index = problem.labels.index(sought.label)
        first, moment = problem.load_part(index).start, fit.loads[index]
        estimated = load_estimates(problem, fit, robot)[index]
        against = refused_loads(problem, plain, robot, knowledge).get(sought.label)
        refused = None if against is None else against.refused
    else:
        covariance[gains, gains] += change_covariance(problem.axes, knowledge.change)
        covariance, first = _with_unknown_load(covariance, sought.guess, robot)
        moment = sought.guess
    axis = np.flatnonzero(problem.use_sum.any(axis=0))
    known = ExpectedInformation(
        covariance=covariance,
        links=fit.links,
        load=first,
        moment=moment,
        axis=axis,
        offset=offset + axis,
        gain=gain + axis,
        gain_value=complete[gains][axis] @ fit.common,
        noise=PoseNoise(_friction(problem, fit), np.nan_to_num(sought.sample_std_nm) ** 2),
    )
    return Stock(estimated, refused, known)


def _last(visits: Visits) -> int:
    """Return the latest visit; the gains of the next visit are assumed equal to its gains."""
    return int(np.argmax(visits.time_s)) if np.isfinite(visits.time_s).all() else len(visits) - 1


def information_of_priors(
    robot: Robot, knowledge: Knowledge, guess: Floats, band_nm: Floats, noise: PoseNoise
) -> ExpectedInformation:
    """What is known of a load before any visit: the links by their priors or a stored bare identification.

    Parameters
    ----------
    robot : Robot
    knowledge : Knowledge
    guess : array of shape (4,)
        Of the load's mass and first moment.
    band_nm : array of shape (N,)
        Friction bands.
    noise : PoseNoise
    """
    count, axes = PER_LINK_AT_REST * robot.axes, robot.axes
    gain, offset = count + np.arange(axes), count + axes + np.arange(axes)
    links, link_std = open_link_prior(robot, knowledge.trust)
    std = np.concatenate([link_std, gain_stds(knowledge.gain_std, axes), BIAS_SHARE * band_nm])
    information = np.diag(1.0 / std**2)
    gain_value = np.zeros(axes)
    if knowledge.bare is not None:
        rows, _ = bare_rows(knowledge.bare, knowledge.change)
        information += rows.T @ rows
        if knowledge.bare.gain:
            gain_value = np.nan_to_num(np.asarray(knowledge.bare.gain, dtype=float))
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    size, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    turned = vectors / scale[:, None]
    covariance = (turned / np.maximum(size, _OPEN**-2)) @ turned.T
    covariance[np.ix_(gain, gain)] += change_covariance(axes, knowledge.change)
    covariance, first = _with_unknown_load(covariance, guess, robot)
    axis = np.arange(axes)
    return ExpectedInformation(covariance, links, first, guess, axis, offset, gain, gain_value, noise)


def _with_unknown_load(covariance: Floats, guess: Floats, robot: Robot) -> tuple[Floats, int]:
    """Return the covariance with four unknowns of a load appended, and the index of the first of them."""
    first = len(covariance)
    mass_kg = _WIDE * float(guess[0])
    out = np.zeros((first + 4, first + 4))
    out[:first, :first] = covariance
    out[first:, first:] = np.diag([mass_kg, *[mass_kg * reach_m(robot) / 3.0] * 3]) ** 2
    return out, first


def _friction(problem: RestProblem, fit: Fit) -> Floats:
    """Variance (N,) that friction leaves in the half-sum of both approaches, from the fit; NaN = not measured."""
    sampled = np.nan_to_num(np.nanmedian(np.where(problem.use_sum, problem.rows.sample_std_nm, np.nan), axis=0))
    return np.where(problem.use_sum.any(axis=0), np.maximum(axis_sigma(problem, fit) ** 2 - sampled**2, 0.0), np.nan)
