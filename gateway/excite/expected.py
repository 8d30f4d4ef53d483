"""What motions promise to tell: expected standard deviations, before anything has moved (Cramer-Rao bound).

Noise hangs together in time, so that many rows make one independent one; what is not asked for but stands in every
model has its prior: torque constants, losses in proportion to the torque, links (Swevers et al., 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.excite.limits import States
from gateway.feedforward.load import FeedLoad
from gateway.identify.links import PER_LINK_MOVING, link_prior
from gateway.identify.nuisance import LOAD_FRICTION_STD
from gateway.model.base import moving_base
from gateway.model.motion import SMOOTH_RAD_S
from gateway.model.regressor import regressor
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]
Purpose = Literal["load", "friction", "rotor"]

#: Time over which the error of a torque hangs together [s], one way: longer than the filter of any drive.
CORRELATION_S = 0.05
#: What is added to the information on each number, as a share of it: nothing is divided by nothing.
_LEAST = 1e-12
#: A number whose standard deviation is this many times what it would be by itself cannot be told from others.
_LOST = 1e5
#: Of a load: mass, centre of gravity and inertia, as results have them.
LOAD_NUMBERS = ("mass", "com_x", "com_y", "com_z", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


@dataclass(frozen=True, slots=True, eq=False)
class TorqueNoise:
    """What torque is believed to be off by.

    Attributes
    ----------
    std_nm : array of shape (N,)
    correlation_s : float
        Time over which it hangs together: `2 correlation_s` of motion make one independent row.
    source : str
    gain_std : array of shape (N,)
        Relative standard deviation of the torque constants.
    """

    std_nm: Floats
    correlation_s: float
    source: str
    gain_std: Floats

    def factor(self, sync_period_s: float) -> float:
        """How many rows, one per SYNC, make one independent one."""
        return float(1.0 / np.tanh(sync_period_s / (2.0 * self.correlation_s)))

    def weighted(self, rows: Floats, states: States) -> Floats:
        """Rows (n, N, p) over their standard deviation; those of an axis that hardly moves tell of friction at rest."""
        moves = np.tanh(np.abs(states.qd_rad_s) / SMOOTH_RAD_S)
        return rows * (moves / self.std_nm)[:, :, None]


class AskedNumbers(Protocol):
    """What is asked of motions, with all that stands beside it."""

    @property
    def noise(self) -> TorqueNoise:
        """What torque is believed to be off by."""
        ...

    @property
    def prior(self) -> Floats:
        """What is known of each unknown beforehand: information (p,)."""
        ...

    @property
    def turn(self) -> Floats:
        """Derivative (k, p) of what is asked by the unknowns."""
        ...

    def information(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """Information (motions, p, p) of several motions.

        Parameters
        ----------
        states : States
            Arrays of shape (motions n, N): the same number of instants of each, evenly spread.
        rigid : array of shape (motions n, N, 10 N)
            Full rows of the arm there.
        motions : int
        duration_s : float
            Of all periods of one motion.
        """
        ...


def expected_stds(asked: AskedNumbers, information: Floats) -> Floats:
    """Standard deviations (m, k) of what is asked under informations (m, p, p); very large where nothing tells."""
    size, scaled = _scaled(asked, information)
    spread = asked.turn[None] / size[:, None, :]
    return np.sqrt(np.einsum("mkp,mpq,mkq->mk", spread, np.linalg.inv(scaled), spread))


def told_stds(asked: AskedNumbers, information: Floats) -> Floats:
    """Standard deviations (k,) under one information (p, p); NaN for what it does not tell from others."""
    size, scaled = _scaled(asked, information[None])
    spread = asked.turn / size
    values, vectors = np.linalg.eigh(scaled[0])
    parts = (spread @ vectors) ** 2
    open_ = values < _LOST**-2
    lost = parts[:, open_].sum(axis=1) > _LEAST * parts.sum(axis=1)
    return np.where(lost, np.nan, np.sqrt((parts[:, ~open_] / values[~open_]).sum(axis=1)))


def _scaled(asked: AskedNumbers, information: Floats) -> tuple[Floats, Floats]:
    """Size (m, p) of the information on each unknown, and information (m, p, p) over it."""
    index = np.arange(information.shape[1])
    total = information.copy()
    total[:, index, index] += asked.prior
    size = np.sqrt(np.diagonal(total, axis1=1, axis2=2))
    size = np.where(size > 0.0, size, 1.0)
    total /= size[:, :, None] * size[:, None, :]
    total[:, index, index] += _LEAST
    return size, total


def _gram(rows: Floats, motions: int, independent: float) -> Floats:
    """Information (motions, p, p) of weighted rows (motions n, N, p), of which so many of each are independent."""
    instants = len(rows) // motions
    each = rows.reshape(motions, instants * rows.shape[1], -1)
    return np.matmul(each.transpose(0, 2, 1), each) * (independent / instants)


@dataclass(frozen=True, slots=True, eq=False)
class LoadAsked:
    """A load's ten numbers, from bare and loaded runs of the same motion.

    Their difference is free of links and of friction that no load changes, and has twice the variance. Unknowns: the
    body's parameters, gains, losses in proportion to the torque.

    Attributes
    ----------
    workspace : Workspace
    noise : TorqueNoise
    load : FeedLoad
        The one that the promise is made for.
    links : array of shape (10 N,) or None
        Parameters of the links; None = not known.
    """

    workspace: Workspace
    noise: TorqueNoise
    load: FeedLoad
    links: Floats | None

    @property
    def prior(self) -> Floats:
        """As `AskedNumbers.prior`."""
        gain = self.noise.gain_std
        return np.concatenate([np.zeros(10), gain**-2.0, np.full(len(gain), LOAD_FRICTION_STD**-2.0)])

    @property
    def turn(self) -> Floats:
        """As `AskedNumbers.turn`, of `LOAD_NUMBERS`."""
        return np.hstack([load_jacobian(self.load), np.zeros((10, 2 * self.workspace.robot.axes))])

    def information(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """As `AskedNumbers.information`."""
        torque = rigid[:, :, -10:] @ self.load.parameters
        bare = np.zeros_like(torque) if self.links is None else rigid @ self.links
        lost = (np.abs(bare + torque) - np.abs(bare)) * np.tanh(states.qd_rad_s / SMOOTH_RAD_S)
        own = np.eye(self.workspace.robot.axes)
        rows = np.concatenate([rigid[:, :, -10:], torque[:, :, None] * own, lost[:, :, None] * own], axis=2)
        independent = duration_s / (2.0 * self.noise.correlation_s)
        return _gram(self.noise.weighted(rows, states), motions, independent / 2.0)


def load_jacobian(load: FeedLoad) -> Floats:
    """Derivative (10, 10) of `LOAD_NUMBERS` by a body's parameters, as `body_parameters` has them."""
    mass, com = load.mass_kg, load.com_m
    turn = np.zeros((10, 10))
    turn[0, 0] = 1.0
    turn[1:4, 0], turn[1:4, 1:4] = -com / mass, np.eye(3) / mass
    upper = np.triu_indices(3)
    turn[4:, 0] = (com @ com * np.eye(3) - np.outer(com, com))[upper]
    for axis, unit in enumerate(np.eye(3)):
        turn[4:, 1 + axis] = (np.outer(unit, com) + np.outer(com, unit) - 2.0 * com[axis] * np.eye(3))[upper]
    turn[4:, 4:] = np.eye(6)
    order = [0, 1, 2, 3, 4, 7, 9, 5, 6, 8]  # xx, yy, zz, xy, xz, yz of a result
    return turn[order]


@dataclass(frozen=True, slots=True, eq=False)
class DriveTrainAsked:
    """Friction or rotors of every axis, from one run bare.

    Unknowns: links, dry and viscous friction, rotor inertia, gains, losses in proportion to the torque.

    Attributes
    ----------
    workspace : Workspace
    noise : TorqueNoise
    purpose : Purpose
        `friction`: dry, then viscous, of all axes; `rotor`.
    links : array of shape (10 N,) or None
        None = not known.
    chosen : int array of shape (b,)
        Columns of the links that can be told at all, or that something is known of.
    link_information : array of shape (b,)
        What is known of them.
    """

    workspace: Workspace
    noise: TorqueNoise
    purpose: Purpose
    links: Floats | None
    chosen: NDArray[np.int_]
    link_information: Floats

    @classmethod
    def of(
        cls, workspace: Workspace, noise: TorqueNoise, purpose: Purpose, links: Floats | None, trust: float
    ) -> DriveTrainAsked:
        """With links that are trusted so far: relative standard deviation, infinite = not at all."""
        std = link_prior(workspace.robot, trust, PER_LINK_MOVING)[1]
        free = not np.isfinite(std).all()
        chosen = moving_base(workspace.robot, workspace.gravity_m_s2).indices if free else np.flatnonzero(std > 0.0)
        known = np.zeros(len(chosen)) if free else std[chosen] ** -2.0
        return cls(workspace, noise, purpose, links, chosen, known)

    @property
    def prior(self) -> Floats:
        """As `AskedNumbers.prior`."""
        gain = self.noise.gain_std
        free, lost = np.zeros(3 * len(gain)), np.full(len(gain), LOAD_FRICTION_STD**-2.0)
        return np.concatenate([self.link_information, free, gain**-2.0, lost])

    @property
    def turn(self) -> Floats:
        """As `AskedNumbers.turn`."""
        axes, first = self.workspace.robot.axes, len(self.chosen)
        columns = np.arange(2 * axes) if self.purpose == "friction" else np.arange(2 * axes, 3 * axes)
        return np.eye(first + 5 * axes)[first + columns]

    def information(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """As `AskedNumbers.information`."""
        torque = np.zeros_like(states.q_rad) if self.links is None else rigid @ self.links
        sign = np.tanh(states.qd_rad_s / SMOOTH_RAD_S)
        shapes = (sign, states.qd_rad_s, states.qdd_rad_s2, torque, np.abs(torque) * sign)
        own = np.eye(self.workspace.robot.axes)
        rows = np.concatenate([rigid[:, :, self.chosen], *(shape[:, :, None] * own for shape in shapes)], axis=2)
        independent = duration_s / (2.0 * self.noise.correlation_s)
        return _gram(self.noise.weighted(rows, states), motions, independent)


def promise(asked: Sequence[AskedNumbers], states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
    """Mean logarithm (motions,) of all standard deviations asked for; its arguments are those of `information`."""
    stds = [expected_stds(each, each.information(states, rigid, motions, duration_s)) for each in asked]
    return np.log(np.concatenate(stds, axis=1)).mean(axis=1)


def arm_rows(workspace: Workspace, states: States) -> Floats:
    """Full rows (n, N, 10 N) of the moving arm."""
    q, qd, qdd = states.q_rad, states.qd_rad_s, states.qdd_rad_s2
    return regressor(workspace.robot, q, qd, qdd, workspace.gravity_m_s2)
