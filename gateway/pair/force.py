"""Wrench on a gripper from joint torques, and its internal part that loads the workpiece (CN104379308 [0063]).

A wrench `[F (3) N; M (3) Nm]` is what the WORKPIECE exerts ON THE GRIPPER, about the fingertip, in the axes of that
robot's base. Joint torque is actuator torque, positive in +q: `tau_motor = tau_model + tau_friction - J^T W`.

Both grippers also carry the part. About the part's centre `h_ext = h_1 + h_2` holds its weight and inertia reaction,
`h_int = (h_2 - h_1)/2` is what squeezes and bends it, and only that is corrected: a hand that nulled the whole wrench
would let go of its share of the weight.

`ForceGuard` stops both arms when the force between them exceeds its limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats, cross_matrix

GRAVITY_M_S2 = (0.0, 0.0, -9.80665)


def dead_band(value: ArrayLike, band: ArrayLike) -> Floats:
    """Apply a dead band (6,) to a value (..., 6); continuous at its edge."""
    values = np.asarray(value, dtype=float)
    return np.sign(values) * np.maximum(np.abs(values) - np.asarray(band), 0.0)


def to_centre(w_r_b: ArrayLike, lever_m: ArrayLike) -> Floats:
    """Return matrices (..., 6, 6) that map a wrench at a fingertip, base axes, to the part's centre, world axes.

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
    """Split both grippers' wrenches into external and internal wrench (..., 6), about the part's centre, world axes."""
    one, two = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    return one + two, 0.5 * (two - one)


def share_of_part(part_mass_kg: float, acceleration_m_s2: ArrayLike, gravity_m_s2: ArrayLike = GRAVITY_M_S2) -> Floats:
    """Return the force (..., 3) [N] of half the part on its gripper, `m (g - a)/2`, world axes."""
    return 0.5 * part_mass_kg * (np.asarray(gravity_m_s2, dtype=float) - np.asarray(acceleration_m_s2, dtype=float))


#: Averaging time of torques of a completed trajectory: one vibration of a gear [s].
AVERAGED_S = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class InternalForce:
    """Internal wrench of the part along a completed trajectory.

    Attributes
    ----------
    wrench : array of shape (M, 6)
        About the part's centre, world axes [N, Nm], at the time when the arms followed command m.
    covariance : array of shape (M, 6, 6)
    pulled : bool
        An external force acted on the arms, on this trajectory and not on the one before.
    """

    wrench: Floats
    covariance: Floats
    pulled: bool = False

    @property
    def size_std_n(self) -> Floats:
        """Return the standard deviation (M,) of the force's magnitude, along its own direction [N]."""
        force = self.wrench[:, :3]
        along = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
        return np.sqrt(np.einsum("ni,nij,nj->n", along, self.covariance[:, :3, :3], along))

    @property
    def std(self) -> Floats:
        """Return the standard deviation (M, 6) of each component."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


#: Share of the threshold that counts as normal, and a rise time from there that no path causes [s].
CALM_SHARE, SUDDEN_S = 0.4, 0.1
#: Drives take over a setpoint about half a period after its SYNC. One delayed by more than this share of a period may
#: miss that: joints jerk, each with the lag of its servo, and what that does to the force is over after so long [s].
DELAYED_SHARE, DELAY_MEMORY_S = 0.4, 0.2
DELAY_TEXT = "a SYNC shortly before was delayed by"


class ForceGuard:
    """Trips when the internal force stays above twice its limit for longer than a given time.

    Parameters
    ----------
    limit_n : float
        Limit of the internal force.
    dt_s : float
    time_s : float
    factor : float
    """

    def __init__(self, limit_n: float, dt_s: float, time_s: float = 0.02, factor: float = 2.0) -> None:
        if not (limit_n > 0.0 and dt_s > 0.0 and time_s >= 0.0 and factor >= 1.0):
            raise ConfigError(f"force guard: limit and cycle must be positive, got {limit_n} N and {dt_s} s")
        self.threshold_n, self.time_s = factor * limit_n, time_s
        self._allowed = int(time_s / dt_s + 1e-9)
        self._above = 0
        self.tripped = False

    def step(self, force_n: float) -> bool:
        """Check the internal force [N] of one cycle; return True from when both arms must stop. NaN stops too."""
        self._above = 0 if force_n <= self.threshold_n else self._above + 1
        self.tripped = self.tripped or self._above > self._allowed
        return self.tripped


def cause_of(force_n: Floats, threshold_n: float, dt_s: float, delay_s: float = 0.0) -> str:
    """Return the probable cause of a force (n,) [N] that has tripped the guard, from its history.

    Parameters
    ----------
    force_n : array of shape (n,)
    threshold_n : of the guard
    dt_s : SYNC period
    delay_s : largest delay of a SYNC of the last `DELAY_MEMORY_S`
    """
    if delay_s > DELAYED_SHARE * dt_s:
        return (
            f"{DELAY_TEXT} {1e3 * delay_s:.1f} ms at a period of {1e3 * dt_s:g} ms, drives may miss a setpoint:"
            " end other work on this computer, give it a real-time scheduler, or raise sync_period_s"
        )
    calm = np.flatnonzero(force_n < CALM_SHARE * threshold_n)
    if not len(calm):
        return "it was present from the start of the trajectory: check the grasp of both arms, then teach again"
    rose_s = (len(force_n) - 1 - calm[-1]) * dt_s
    if rose_s <= SUDDEN_S:
        return (
            f"it rose within {1e3 * rose_s:.0f} ms: the part slipped in a grip or something struck it; check grips and"
            " part, then teach again"
        )
    return f"it grew for {rose_s:.2f} s: teach again or lower the speed"
