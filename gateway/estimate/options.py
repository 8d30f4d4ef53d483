"""Inputs of an estimate besides the measured data."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.identify.links import parse_inertials
from gateway.identify.rest.problem import Knowledge


@dataclass(frozen=True, slots=True)
class Coefficient:
    """Inputs of the coefficient method: joint (from 1), lever column [m], gear, rated motor torque [Nm]."""

    joint: int
    lever: str
    gear_ratio: float
    gear_efficiency: float
    rated_torque_nm: float | None = None


@dataclass(frozen=True, slots=True)
class EstimateOptions(Knowledge):
    """What is known besides the measured rows, and how to estimate.

    Attributes
    ----------
    inertials, gravity_m_s2, known, masses, bare, gain_std, measured_gain, change : as of `Knowledge`
    efficiency : gear efficiency of every axis, or one for all
        1 if the torque is already that at the gear output.
    coupling : (N, N) how gear outputs act on the joints, as of `Gears`; None = one to one
    coefficient : Coefficient or None
        Needed by that method alone.
    hull_radius_m : float or None
        A centre of mass further from the last link is reported; 0.4 of the arm's length if not given.
    pose_choice : (k, N) poses that may be recommended; None = any within the robot's joint limits
    """

    inertials: str = "ignore"
    efficiency: tuple[float, ...] = (1.0,)
    coupling: NDArray[np.float64] | None = field(default=None, compare=False)
    coefficient: Coefficient | None = None
    hull_radius_m: float | None = None
    pose_choice: NDArray[np.float64] | None = field(default=None, compare=False)

    @property
    def trust(self) -> float:
        """Relative standard deviation of the link inertials: 0 = exact, infinite = ignored."""
        return parse_inertials(self.inertials)
