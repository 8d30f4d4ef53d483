"""Expected standard deviations of the parameters that a motion identifies, before anything has moved (Cramer-Rao
bound).

Torque noise is correlated in time, so several samples count as one independent sample (Swevers et al., 1997). The
nuisance parameters of the model have the priors of the fit: torque constants, load friction, links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.excite.limits import States
from gateway.feedforward.load import FeedLoad
from gateway.identify.inertia import central_directions
from gateway.identify.links import PER_LINK_MOVING, link_prior
from gateway.identify.load_estimate import load_directions
from gateway.identify.motion.prior import FRICTION, friction_columns, moving_prior
from gateway.identify.solve import ByGroup, Prior, identifiable_stds, solve
from gateway.model.base import moving_base
from gateway.model.motion import SMOOTH_RAD_S
from gateway.model.regressor import regressor
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

Purpose = Literal["load", "friction", "rotor"]

#: One-sided correlation time of the torque error [s]: longer than the filter of any drive.
CORRELATION_S: Final = 0.05
#: Ridge on the scaled information, so that it is regular where a parameter is not determined.
_RIDGE: Final = 1e-12
#: Relative size of a singular value below which the motions do not determine its direction.
_TOLERANCE: Final = 1e-5
#: Friction shapes of a planned motion: Coulomb, viscous, rotor inertia.
_SHAPES: Final = FRICTION[:3]


@dataclass(frozen=True, slots=True, eq=False)
class TorqueNoise:
    """Expected error of the measured torque.

    Attributes
    ----------
    std_nm : array of shape (N,)
    correlation_s : float
        Correlation time: `2 correlation_s` of motion make one independent row.
    source : str
    gain_std : array of shape (N,)
        Relative standard deviation of the torque constants.
    """

    std_nm: Floats
    correlation_s: float
    source: str
    gain_std: Floats

    def weighted(self, columns: Floats, states: States, independent: float) -> Floats:
        """Return columns (n, N, p) over their standard deviation.

        Rows of an axis near standstill have little weight, since friction at rest is not a function of speed.
        `independent` is the number of independent rows per row.
        """
        moves = np.tanh(np.abs(states.qd_rad_s) / SMOOTH_RAD_S)
        return columns * (moves * np.sqrt(independent) / self.std_nm)[:, :, None]

    def independent(self, duration_s: float) -> float:
        """Return the number of independent instants of a motion."""
        return duration_s / (2.0 * self.correlation_s)


class AskedNumbers(Protocol):
    """Quantities to identify with a motion, and the parameters of the model that contains them."""

    @property
    def noise(self) -> TorqueNoise:
        """Expected error of the measured torque."""
        ...

    @property
    def prior(self) -> Prior:
        """Prior of the p parameters."""
        ...

    @property
    def turn(self) -> Floats:
        """Derivative (k, p) of the quantities with respect to the parameters."""
        ...

    def rows(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """Return the weighted rows (motions n, N, p) of several motions.

        Parameters
        ----------
        states : States
            Arrays of shape (motions n, N): the same number of evenly spaced instants of each.
        rigid : array of shape (motions n, N, 10 N)
            Regressor of the arm at these states.
        motions : int
        duration_s : float
            Duration of all periods of one motion.
        """
        ...


def expected_stds(asked: AskedNumbers, rows: Floats, motions: int) -> Floats:
    """Return standard deviations (motions, k) from the weighted rows of each motion; very large if not determined.

    Normal equations of many motions are solved at once: the optimiser needs hundreds per step, and `solve` handles one.
    """
    each = rows.reshape(motions, -1, rows.shape[2])
    total = np.matmul(each.transpose(0, 2, 1), each) + asked.prior.precision
    index = np.arange(total.shape[1])
    size = np.sqrt(np.diagonal(total, axis1=1, axis2=2))
    size = np.where(size > 0.0, size, 1.0)
    total /= size[:, :, None] * size[:, None, :]
    total[:, index, index] += _RIDGE
    turn = asked.turn[None] / size[:, None, :]
    return np.sqrt(np.einsum("mkp,mpq,mkq->mk", turn, np.linalg.inv(total), turn))


def stds_of_all(asked: AskedNumbers, rows: Floats) -> Floats:
    """Return standard deviations (k,) from all weighted rows (n, N, p); NaN if not determined."""
    count, axes, width = rows.shape
    design = ByGroup.of(rows.reshape(-1, width), np.tile(np.arange(axes), count))
    found = solve(design, np.zeros(count * axes), np.ones(count * axes), asked.prior, _TOLERANCE)
    return identifiable_stds(found, asked.turn)


def _usual_prior(links: tuple[Floats, Floats], first: int, gain_std: Floats) -> Prior:
    """Return the prior of links and free parameters, and from index `first` of the gain and load friction."""
    gain = first + np.arange(len(gain_std))
    usual = {"gain": gain, "load_friction": gain + len(gain)}
    return moving_prior(links, first + 2 * len(gain), usual, gain_std, change=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class LoadAsked:
    """Ten inertial parameters of a load, from one motion driven without and with it.

    The difference of both runs is free of links and of friction that does not depend on the load. Its variance is twice
    that of one run. Parameters: the body, gains, load friction.

    Attributes
    ----------
    workspace : Workspace
    noise : TorqueNoise
    load : FeedLoad
        Load for which the standard deviations are expected.
    links : array of shape (10 N,) or None
        Parameters of the links; None = not known.
    """

    workspace: Workspace
    noise: TorqueNoise
    load: FeedLoad
    links: Floats | None

    @property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return _usual_prior((np.zeros(0), np.zeros(0)), PER_LINK_MOVING, self.noise.gain_std)

    @property
    def turn(self) -> Floats:
        """Derivative of mass, centre of gravity and inertia with respect to the parameters."""
        body = self.load.parameters
        turn = np.zeros((PER_LINK_MOVING, PER_LINK_MOVING + 2 * self.workspace.robot.axes))
        turn[:4, :4], turn[4:, :PER_LINK_MOVING] = load_directions(body[:4]), central_directions(body)
        return turn

    def rows(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """Return the weighted rows; see `AskedNumbers.rows`."""
        body = rigid[:, :, -PER_LINK_MOVING:]
        torque = body @ self.load.parameters
        bare = np.zeros_like(torque) if self.links is None else rigid @ self.links
        lost = (np.abs(bare + torque) - np.abs(bare)) * np.tanh(states.qd_rad_s / SMOOTH_RAD_S)
        own = np.eye(self.workspace.robot.axes)
        columns = np.concatenate([body, torque[:, :, None] * own, lost[:, :, None] * own], axis=2)
        independent = self.noise.independent(duration_s) * motions / len(columns)
        return self.noise.weighted(columns, states, independent / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class DriveTrainAsked:
    """Friction or rotor inertia of every axis, from one motion without a load.

    Parameters: links, Coulomb and viscous friction and rotor inertia of every axis, gains, load friction.

    Attributes
    ----------
    workspace : Workspace
    noise : TorqueNoise
    purpose : Purpose
        `friction`: Coulomb, then viscous, of all axes; `rotor`.
    links : array of shape (10 N,) or None
        None = not known.
    chosen : int array of shape (b,)
        Columns of the links: base parameters, or those with a prior.
    link_prior : mean and standard deviation (b,)
        Empty where the links have no prior.
    """

    workspace: Workspace
    noise: TorqueNoise
    purpose: Purpose
    links: Floats | None
    chosen: NDArray[np.int_]
    link_prior: tuple[Floats, Floats]

    @classmethod
    def of(
        cls, workspace: Workspace, noise: TorqueNoise, purpose: Purpose, links: Floats | None, trust: float
    ) -> DriveTrainAsked:
        """Return the quantities for links with relative standard deviation `trust`, infinite = unknown."""
        mean, std = link_prior(workspace.robot, trust, PER_LINK_MOVING)
        if np.isfinite(std).all():
            chosen = np.flatnonzero(std > 0.0)
            return cls(workspace, noise, purpose, links, chosen, (mean[chosen], std[chosen]))
        base = moving_base(workspace.robot, workspace.gravity_m_s2)
        return cls(workspace, noise, purpose, links, base.indices, (np.zeros(0), np.zeros(0)))

    @property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return _usual_prior(self.link_prior, self._first_usual, self.noise.gain_std)

    @property
    def _first_usual(self) -> int:
        return len(self.chosen) + len(_SHAPES) * self.workspace.robot.axes

    @property
    def turn(self) -> Floats:
        """Derivative of the quantities with respect to the parameters."""
        axes = self.workspace.robot.axes
        shapes = (0, 1) if self.purpose == "friction" else (2,)
        columns = [len(self.chosen) + len(_SHAPES) * np.arange(axes) + shape for shape in shapes]
        return np.eye(self._first_usual + 2 * axes)[np.concatenate(columns)]

    def rows(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """Return the weighted rows; see `AskedNumbers.rows`."""
        torque = np.zeros_like(states.q_rad) if self.links is None else rigid @ self.links
        friction = friction_columns(states.qd_rad_s, states.qdd_rad_s2, _SHAPES, SMOOTH_RAD_S)
        lost = np.abs(torque) * np.tanh(states.qd_rad_s / SMOOTH_RAD_S)
        own = np.eye(self.workspace.robot.axes)
        parts = [rigid[:, :, self.chosen], friction, torque[:, :, None] * own, lost[:, :, None] * own]
        columns = np.concatenate(parts, axis=2)
        return self.noise.weighted(columns, states, self.noise.independent(duration_s) * motions / len(columns))


def mean_log_std(
    asked: Sequence[AskedNumbers], states: States, rigid: Floats, motions: int, duration_s: float
) -> Floats:
    """Return the mean logarithm (motions,) of all requested standard deviations."""
    stds = [expected_stds(each, each.rows(states, rigid, motions, duration_s), motions) for each in asked]
    return np.log(np.concatenate(stds, axis=1)).mean(axis=1)


def arm_rows(workspace: Workspace, states: States) -> Floats:
    """Return the regressor (n, N, 10 N) of the moving arm."""
    q, qd, qdd = states.q_rad, states.qd_rad_s, states.qdd_rad_s2
    return regressor(workspace.robot, q, qd, qdd, workspace.gravity_m_s2)
