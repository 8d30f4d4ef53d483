"""Gains of the simulated servo loops, and of the numerical coupling between rotors and links, from the mass matrix."""

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
#: A coupling of each axis by itself serves where it carries the largest inertia at this frequency at least [rad/s], ten
#: times the position loop. A light wrist or axes in one line make it softer: then all axes are coupled at once.
STIFF_RAD_S = 70.0
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


class Coupling:
    """Torque between rotors and links.

    Parameters
    ----------
    stiffness, damping : [Nm/rad] and [Nm s/rad], (N,) axis by axis, or (N, N) of all axes at once

    Attributes
    ----------
    stiffness : as given
    at_once : all axes are coupled by one matrix, which is right in the posture that it was made for
    """

    __slots__ = ("_both", "_each", "at_once", "stiffness")

    def __init__(self, stiffness: Array, damping: Array) -> None:
        self.stiffness, self.at_once = stiffness, stiffness.ndim == 2
        self._both = np.hstack([stiffness, damping])
        self._each = [] if self.at_once else list(zip(stiffness.tolist(), damping.tolist(), strict=True))

    def torque(self, wound_rad: list[float], turning_rad_s: list[float]) -> list[float]:
        """Torque on the links [Nm] where the rotors are ahead of them by so much."""
        if self.at_once:
            return (self._both @ np.array(wound_rad + turning_rad_s)).tolist()
        parts = zip(self._each, wound_rad, turning_rad_s, strict=True)
        return [stiff * wound + damp * turning for (stiff, damp), wound, turning in parts]

    def wound_rad(self, torque_nm: list[float]) -> list[float]:
        """How far rotors at rest are ahead of their links under a torque."""
        if self.at_once:
            return np.linalg.solve(self.stiffness, torque_nm).tolist()
        return (np.array(torque_nm) / self.stiffness).tolist()


def coupling(masses: Sequence[Array], rotor_kg_m2: Array) -> Coupling:
    """A coupling whose fastest mode with the links stays stable, axis by axis where that is stiff enough.

    At once: the stiffness is that of the relative inertia of rotors and links, so that all modes have one frequency.

    Parameters
    ----------
    masses : mass matrices (N, N) in several postures, the present one first, motor side of a coupling
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
    heaviest = np.max([np.diag(mass) for mass in masses], axis=0)
    if (frequency * np.sqrt(reduced / heaviest)).min() >= STIFF_RAD_S:
        return Coupling(reduced * frequency**2, 2.0 * COUPLING_DAMPING * reduced * frequency)
    return coupling_at_once(masses[0], rotor_kg_m2)


def coupling_at_once(mass: Array, rotor_kg_m2: Array) -> Coupling:
    """The coupling of all axes by one matrix, for the posture of a mass matrix (N, N)."""
    relative = np.linalg.inv(np.diag(1.0 / rotor_kg_m2) + np.linalg.inv(mass))
    relative = 0.5 * (relative + relative.T)
    frequency = COUPLING_PHASE / TICK_S
    return Coupling(relative * frequency**2, 2.0 * COUPLING_DAMPING * relative * frequency)
