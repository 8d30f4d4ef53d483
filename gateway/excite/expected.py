"""What a motion promises to tell of a load: expected standard deviations, before anything has moved.

Bare and loaded along the same motion: the difference of both removes links and friction, and has twice the variance.
What stays beside the load's ten numbers has its prior: torque constants, and losses in proportion to the torque. Noise
hangs together in time, so that so many rows make one independent one (Cramer-Rao bound; Swevers et al., 1997).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.excite.limits import States
from gateway.feedforward.load import FeedLoad
from gateway.identify.nuisance import LOAD_FRICTION_STD
from gateway.model.regressor import regressor
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

#: Speed below which the sign of dry friction is rounded [rad/s], as moving runs are fitted.
SMOOTH_RAD_S = 0.02
#: Time over which the error of a torque hangs together [s], one way: what is left of friction changes as slowly.
CORRELATION_S = 0.05
#: What is added to the information on each number, as a share of it: nothing is divided by nothing.
_LEAST = 1e-12
#: A standard deviation in which this is felt is none.
_LOST = 1e-9
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


@dataclass(frozen=True, slots=True, eq=False)
class LoadModel:
    """What tells a load.

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

    def covariance(self, states: States, rigid: Floats, motions: int, duration_s: float) -> Floats:
        """Covariance of mass, centre of gravity and inertia, as `LOAD_NUMBERS`, of several motions.

        Parameters
        ----------
        states : States
            Arrays of shape (motions n, N): the same number of instants of each, evenly spread.
        rigid : array of shape (motions n, N, 10 N)
            Full rows there.
        motions : int
        duration_s : float
            Of all periods of one motion.

        Returns
        -------
        array of shape (motions, 10, 10)
        """
        axes, instants = self.workspace.robot.axes, len(states.q_rad) // motions
        torque = rigid[:, :, -10:] @ self.load.parameters
        bare = np.zeros_like(torque) if self.links is None else rigid @ self.links
        lost = (np.abs(bare + torque) - np.abs(bare)) * np.tanh(states.qd_rad_s / SMOOTH_RAD_S)
        own = np.eye(axes)
        rows = np.concatenate([rigid[:, :, -10:], torque[:, :, None] * own, lost[:, :, None] * own], axis=2)
        rows /= self.noise.std_nm[:, None]
        rows = rows.reshape(motions, instants * axes, -1)
        independent = duration_s / (2.0 * self.noise.correlation_s) / instants
        information = np.matmul(rows.transpose(0, 2, 1), rows) * (independent / 2.0)
        prior = np.concatenate([np.zeros(10), self.noise.gain_std**-2.0, np.full(axes, LOAD_FRICTION_STD**-2.0)])
        index = np.arange(len(prior))
        information[:, index, index] += prior
        found = _inverse(information)[:, :10, :10]
        turn = load_jacobian(self.load)
        return turn @ found @ turn.T


def _inverse(information: Floats) -> Floats:
    """Covariances (m, p, p) of informations; very large where there is none."""
    size = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    size = np.where(size > 0.0, size, 1.0)
    scaled = information / (size[:, :, None] * size[:, None, :])
    index = np.arange(information.shape[1])
    scaled[:, index, index] += _LEAST
    covariance = np.linalg.inv(scaled)
    return covariance / (size[:, :, None] * size[:, None, :])


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


def arm_rows(workspace: Workspace, states: States) -> Floats:
    """Full rows (n, N, 10 N) of the moving arm."""
    q, qd, qdd = states.q_rad, states.qd_rad_s, states.qdd_rad_s2
    return regressor(workspace.robot, q, qd, qdd, workspace.gravity_m_s2)
