"""Impedance between hand and workpiece, `M x'' + D x' + K x = h`, as a correction per control cycle.

Discretised implicitly, which is stable for any cycle time by itself. The loop around it may oscillate. The hand moves
with the delay `T` (servo, buses, force filter, half a cycle), and the chain of gears and part responds with its
stiffness. With the crossover at `K_tot/D` the loop oscillates below `D = (2/pi) K_tot T`; in several directions the
largest eigenvalue of `D^-1 K_tot` counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats, cross_matrix

#: A configuration below this distance to oscillation is refused; 1.5 is wise, 2 better.
LEAST_MARGIN = 1.0


@dataclass(frozen=True, slots=True)
class Gains:
    """Impedance parameters, each equal along x, y, z: translational and rotational value.

    `damping` [N s/m, Nm s/rad], `stiffness` [N/m, Nm/rad], `inertia` [kg, kg m2]. Stiffness 0 is pure integral action:
    the correction continues until the force is zero.
    """

    damping: tuple[float, float]
    stiffness: tuple[float, float] = (0.0, 0.0)
    inertia: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, pair in (("damping", self.damping), ("stiffness", self.stiffness), ("inertia", self.inertia)):
            if len(pair) != 2 or not all(math.isfinite(value) and value >= 0.0 for value in pair):
                raise ConfigError(f"impedance: {name} needs two finite numbers, not negative, got {pair}")
        if min(self.damping) <= 0.0:
            raise ConfigError(f"impedance: damping must be positive, got {self.damping}")

    def doubled(self) -> Gains:
        """Return twice damping, stiffness and inertia, for two arms that both close the same gap."""
        twice = [(2.0 * pair[0], 2.0 * pair[1]) for pair in (self.damping, self.stiffness, self.inertia)]
        return Gains(*twice)


class Admittance:
    """Correction (6,) [m, rad] of one hand per control cycle.

    Parameters
    ----------
    gains : Gains
    dt_s : float
    """

    def __init__(self, gains: Gains, dt_s: float) -> None:
        if not dt_s > 0.0:
            raise ConfigError(f"impedance: the control cycle must be positive, got {dt_s} s")
        damping, stiffness, inertia = (
            np.repeat(np.asarray(pair, dtype=float), 3) for pair in (gains.damping, gains.stiffness, gains.inertia)
        )
        self._dt_s = dt_s
        self._stiffness, self._inertia = stiffness, inertia
        self._scale = 1.0 / (inertia + dt_s * damping + dt_s**2 * stiffness)
        self._massless = not inertia.any()
        self._keep, self._gain = dt_s * damping * self._scale, dt_s**2 * self._scale
        self.reset()

    def reset(self) -> None:
        """Reset the correction to zero, at rest."""
        self._x = np.zeros(6)
        self._v = np.zeros(6)

    @property
    def correction(self) -> Floats:
        """Return the present correction (6,) [m, rad]."""
        return self._x.copy()

    def step(self, wrench: ArrayLike) -> Floats:
        """Advance by one cycle under a wrench (6,) [N, Nm] and return the correction (6,) [m, rad]."""
        if self._massless:
            self._x = self._keep * self._x + self._gain * np.asarray(wrench)
            return self._x
        push = self._dt_s * (np.asarray(wrench) - self._stiffness * self._x)
        self._v = (self._inertia * self._v + push) * self._scale
        self._x = self._x + self._dt_s * self._v
        return self._x


def mobility(gains: Gains, levers_m: Sequence[ArrayLike]) -> Floats:
    """Return the velocity (6, 6) of gap closure at fingertip 2 per wrench there, of all yielding hands together.

    Parameters
    ----------
    gains : Gains
        Of each hand.
    levers_m : sequence of arrays of shape (3,)
        From the fingertip of each yielding hand to fingertip 2: a hand that turns sweeps the far end of the part along
        with it, so a yielding master needs far more damping against turning than a yielding slave.
    """
    total = np.zeros((6, 6))
    for lever in levers_m:
        sweep = np.eye(6)
        sweep[:3, 3:] = -cross_matrix(lever)
        total += (sweep / np.repeat(gains.damping, 3)) @ sweep.T
    return total


def stability_margin(
    gains: Gains, chain_stiffness: ArrayLike, loop_time_s: float, levers_m: Sequence[ArrayLike] = (np.zeros(3),)
) -> float:
    """Return the ratio of the damping to the value at which the loop starts to oscillate.

    Parameters
    ----------
    gains : Gains
    chain_stiffness : array of shape (6, 6)
        Of gears and workpiece between the hands, `[N/m; Nm/rad]`, about fingertip 2.
    loop_time_s : float
        Servo lag + bus delay + force filter + half a cycle.
    levers_m : sequence of arrays of shape (3,)
        As in `mobility`; the slave alone unless given.
    """
    stiffness = np.asarray(chain_stiffness, dtype=float)
    closing = mobility(gains, levers_m) @ (0.5 * (stiffness + stiffness.T))
    crossover = float(np.abs(np.linalg.eigvals(closing)).max())
    inertia_s = max(mass / damping for mass, damping in zip(gains.inertia, gains.damping, strict=True))
    return (math.pi / 2.0) / (crossover * (loop_time_s + inertia_s))


def refuse_unstable(
    gains: Gains, chain_stiffness: ArrayLike, loop_time_s: float, levers_m: Sequence[ArrayLike] = (np.zeros(3),)
) -> float:
    """Return the stability margin of a configuration; refuse an unstable one.

    Raises
    ------
    ConfigError
        Margin below 1; says what damping would do.
    """
    margin = stability_margin(gains, chain_stiffness, loop_time_s, levers_m)
    if not margin >= LEAST_MARGIN:
        needed = tuple(value * 2.0 / margin for value in gains.damping)
        raise ConfigError(
            f"impedance: damping {gains.damping[0]:.4g} N s/m, {gains.damping[1]:.4g} Nm s/rad is {margin:.2f} times"
            f" the limit of oscillation at a loop time of {1e3 * loop_time_s:.0f} ms, at least {LEAST_MARGIN} is"
            f" needed; use about {needed[0]:.3g} N s/m, {needed[1]:.3g} Nm s/rad"
        )
    return margin


def lag_of_correction_s(gains: Gains, chain_stiffness: ArrayLike, loop_time_s: float) -> float:
    """Return the delay of a correction after the force that caused it: `D/K_tot + T` [s], by the mean force
    stiffness.
    """
    stiffness = np.asarray(chain_stiffness, dtype=float)
    return gains.damping[0] / float(np.trace(stiffness[:3, :3]) / 3.0) + loop_time_s
