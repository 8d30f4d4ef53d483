"""Gains of the simulated servo loops, and of the numerical coupling between rotor and link, from the mass matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import ArmSpec
from sim.servo import TICK_S, ServoGains, ServoLoop

Array = NDArray[np.float64]

#: Highest natural frequency of the numerical coupling times the step; below 2 the step is stable.
COUPLING_PHASE = 0.6
COUPLING_DAMPING = 0.15
#: Bandwidth of the velocity loop on all that the motor turns [rad/s], and the share of it the position loop gets.
SPEED_BANDWIDTH_RAD_S = 200.0
POSITION_SHARE = 0.2
POSITION_GAIN_1_S = 6.0


def servo_loops(arm: ArmSpec, masses: Sequence[Array], rotor_kg_m2: Array) -> list[ServoLoop]:
    """Servo loop of each axis, for the largest inertia its motor turns.

    Parameters
    ----------
    arm : for the limits of the axes
    masses : mass matrices (N, N) in several postures, motor side of a coupling
    rotor_kg_m2 : (N,) at the gear output
    """
    rotor = rotor_kg_m2.tolist()
    inertia = (np.max([np.diag(mass) for mass in masses], axis=0) + rotor).tolist()
    servos = []
    for i, axis in enumerate(arm.axes):
        speed_gain = min(SPEED_BANDWIDTH_RAD_S * inertia[i], 0.3 * rotor[i] / TICK_S)
        bandwidth = speed_gain / inertia[i]
        gains = ServoGains(position_1_s=min(POSITION_SHARE * bandwidth, POSITION_GAIN_1_S), speed_nm_s_rad=speed_gain)
        max_nm = axis.torque_limit_nm / axis.gear_efficiency * 1.25
        servos.append(ServoLoop(gains, max_nm, 3.0 * axis.speed_limit_rad_s))
    return servos


def coupling(masses: Sequence[Array], rotor_kg_m2: Array) -> tuple[Array, Array]:
    """Stiffness (N,) [Nm/rad] and damping (N,) [Nm s/rad] whose fastest mode with the links stays stable.

    Parameters
    ----------
    masses : mass matrices (N, N) in several postures, motor side of a coupling
    rotor_kg_m2 : (N,) at the gear output
    """
    link = np.min([1.0 / np.diag(np.linalg.inv(mass)) for mass in masses], axis=0)
    reduced = 1.0 / (1.0 / rotor_kg_m2 + 1.0 / link)
    shape = np.block([[np.diag(reduced), -np.diag(reduced)], [-np.diag(reduced), np.diag(reduced)]])
    axes, fastest = len(rotor_kg_m2), 0.0
    for mass in masses:
        inverse = np.zeros_like(shape)
        inverse[:axes, :axes], inverse[axes:, axes:] = np.diag(1.0 / rotor_kg_m2), np.linalg.inv(mass)
        fastest = max(fastest, float(np.max(np.linalg.eigvals(inverse @ shape).real)))
    frequency = COUPLING_PHASE / TICK_S / np.sqrt(fastest)
    return reduced * frequency**2, 2.0 * COUPLING_DAMPING * reduced * frequency
