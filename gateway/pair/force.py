"""The force on a gripper from joint torques, and which part of it squeezes the workpiece (CN104379308 [0063]).

A wrench `[F (3) N; M (3) Nm]` is what the WORKPIECE exerts ON THE GRIPPER, about the fingertip, in the axes of that
robot's base. Joint torque is actuator torque, positive in +q: `tau_motor = tau_model + tau_friction - J^T W`.

Both grippers also carry the part. About the part's centre `h_ext = h_1 + h_2` holds its weight and inertia reaction,
`h_int = (h_2 - h_1)/2` is what squeezes and bends it, and only that is corrected: a hand that nulled the whole wrench
would let go of its share of the weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.inverse import SINGULAR, ForwardChain
from gateway.pair.transform import Floats, cross_matrix

DAMPING = 0.02
GRAVITY_M_S2 = (0.0, 0.0, -9.80665)


@dataclass(frozen=True, slots=True, eq=False)
class WrenchEstimate:
    """Wrenches (n, 6) [N, Nm]; `observable` (n,) is False next to a singular posture: unknown there, not zero."""

    wrench: Floats
    observable: np.ndarray


def external_torque(measured_nm: ArrayLike, model_nm: ArrayLike, friction_nm: ArrayLike) -> Floats:
    """What is left of the measured joint torque (..., 6) [Nm] after rigid body (gripper included) and friction."""
    return np.asarray(measured_nm, dtype=float) - np.asarray(model_nm) - np.asarray(friction_nm)


def still_band(external_nm: ArrayLike, band_nm: ArrayLike) -> Floats:
    """External torque (..., 6) [Nm] at standstill: inside the friction band (6,) it is taken as zero."""
    given = np.asarray(external_nm, dtype=float)
    return np.where(np.abs(given) < np.asarray(band_nm), 0.0, given)


def dead_band(value: ArrayLike, band: ArrayLike) -> Floats:
    """Value (..., 6) without what lies inside the band (6,); continuous at its edge."""
    given = np.asarray(value, dtype=float)
    return np.sign(given) * np.maximum(np.abs(given) - np.asarray(band), 0.0)


def wrench_from_torque(jacobian: ArrayLike, external_nm: ArrayLike) -> WrenchEstimate:
    """Wrench on the gripper from external joint torque, `W = -J^-T tau_ext`.

    Parameters
    ----------
    jacobian : array of shape (n, 6, 6)
        Nominal geometric Jacobian at the fingertip, base axes.
    external_nm : array of shape (n, 6)

    Returns
    -------
    WrenchEstimate
        Where the smallest singular value is below 0.05, `J^-T` becomes `(J J^T + 0.02^2 I)^-1 J` and the row is
        flagged as not observable.
    """
    matrix, torque = np.asarray(jacobian, dtype=float), np.asarray(external_nm, dtype=float)
    observable = np.linalg.svd(matrix, compute_uv=False)[:, -1] >= SINGULAR
    damping = np.where(observable, 0.0, DAMPING**2)[:, None, None] * np.eye(6)
    normal = matrix @ np.swapaxes(matrix, 1, 2) + damping
    wrench = np.asarray(-np.linalg.solve(normal, matrix @ torque[..., None])[..., 0], dtype=float)
    return WrenchEstimate(wrench, observable)


class ForceEstimator:
    """Wrench of one arm per control cycle, low-passed; None where it cannot be told.

    Parameters
    ----------
    chain : ForwardChain
        Nominal geometry of the arm, fingertip included.
    cutoff_hz : float
        Of the first-order low-pass.
    dt_s : float

    Raises
    ------
    ConfigError
        Cut-off not between 0 and half the sampling rate.
    """

    def __init__(self, chain: ForwardChain, cutoff_hz: float, dt_s: float) -> None:
        if not 0.0 < cutoff_hz < 0.5 / dt_s:
            raise ConfigError(f"force filter: cut-off must lie between 0 and {0.5 / dt_s:.4g} Hz, got {cutoff_hz} Hz")
        self._chain = chain
        self._share = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt_s)
        self._state: Floats | None = None

    def reset(self) -> None:
        """Forget the filter's state."""
        self._state = None

    def update(self, q_rad: ArrayLike, external_nm: ArrayLike) -> Floats | None:
        """Filtered wrench (6,) from joint positions (6,) [rad] and external torque (6,) [Nm]."""
        jacobian = self._chain.poses(np.asarray(q_rad, dtype=float)[None])[1]
        estimate = wrench_from_torque(jacobian, np.asarray(external_nm, dtype=float)[None])
        if not estimate.observable[0] or not np.isfinite(estimate.wrench).all():
            self._state = None
            return None
        sample = estimate.wrench[0]
        before = sample if self._state is None else self._state
        state = before + self._share * (sample - before)
        self._state = state
        return state.copy()


def to_centre(w_r_b: ArrayLike, lever_m: ArrayLike) -> Floats:
    """Matrices (..., 6, 6) that turn a wrench at a fingertip, base axes, into one about the part's centre, world axes.

    Parameters
    ----------
    w_r_b : array of shape (3, 3)
        Base in the world.
    lever_m : array of shape (..., 3)
        From the centre to the fingertip, world axes.
    """
    turn, lever = np.asarray(w_r_b, dtype=float), np.asarray(lever_m, dtype=float)
    matrix = np.zeros((*lever.shape[:-1], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = turn
    matrix[..., 3:, :3] = cross_matrix(lever) @ turn
    return matrix


def split(first: ArrayLike, second: ArrayLike) -> tuple[Floats, Floats]:
    """External and internal wrench (..., 6) of both grippers' wrenches about the part's centre, world axes."""
    one, two = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    return one + two, 0.5 * (two - one)


def share_of_part(part_mass_kg: float, acceleration_m_s2: ArrayLike, gravity_m_s2: ArrayLike = GRAVITY_M_S2) -> Floats:
    """Force (..., 3) [N] by which half the part acts on its gripper, `m (g - a)/2`, world axes."""
    return 0.5 * part_mass_kg * (np.asarray(gravity_m_s2, dtype=float) - np.asarray(acceleration_m_s2, dtype=float))
