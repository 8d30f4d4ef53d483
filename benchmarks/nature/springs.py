"""Mechanisms that pull on the joints: gas and coil balancers, cables between two clamps, stiffening gears."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import HALL_K, Mechanism, TableRows, on_axis, play

Array = NDArray[np.float64]
Build = Callable[[float], Mechanism]
#: Builds an effect of a size; least and most that is physical, in the unit of the size.
Maker = Callable[[NatureArm, TableRows, np.random.Generator], tuple[Build, tuple[float, float]]]

#: Nitrogen, van der Waals: attraction [Pa m6/mol2], volume of the molecules [m3/mol]; gas constant [J/(mol K)].
ATTRACTION, OWN_VOLUME, GAS = 0.1370, 3.87e-5, 8.314
AIR_PA = 1.013e5
BALANCED = 1


@dataclass(frozen=True, slots=True)
class Linkage:
    """A strut between a point of the column and one of the upper arm.

    `base_m`, `arm_m` distances of its ends from axis 2, `phase_rad` angle between them at q2 = 0.
    """

    base_m: float
    arm_m: float
    phase_rad: float

    def length_m(self, q2_rad: Array) -> Array:
        """Length of the strut."""
        return np.sqrt(
            self.base_m**2 + self.arm_m**2 - 2.0 * self.base_m * self.arm_m * np.cos(q2_rad + self.phase_rad)
        )

    def lever_m(self, q2_rad: Array) -> Array:
        """Change of the length with the angle [m/rad]."""
        return self.base_m * self.arm_m * np.sin(q2_rad + self.phase_rad) / self.length_m(q2_rad)

    def span_m(self, q2_rad: Array) -> tuple[float, float]:
        """Shortest and longest length over given angles."""
        length = self.length_m(q2_rad)
        return float(length.min()), float(length.max())


def draw_linkage(arm: NatureArm, rng: np.random.Generator) -> Linkage:
    """A strut that pulls the upper arm upright: shortest where the arm points up, give or take the mounting."""
    upper = float(np.linalg.norm(arm.chain.placement[2, :3, 3]))
    base = upper * rng.uniform(0.25, 0.6)
    return Linkage(base, base * rng.uniform(0.35, 0.75), float(rng.uniform(-0.25, 0.25)))


def gas_balancer(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A gas strut that presses nitrogen at 60 to 150 bar; it warms up, and its seal drags with the pressure."""
    strut = draw_linkage(arm, rng)
    short, long = strut.span_m(np.linspace(-2.0, 2.0, 81))
    swept = long - short
    dead = swept * rng.uniform(1.5, 4.0)
    filled_pa, warmer_k, warm_s = rng.uniform(60e5, 150e5), rng.uniform(3.0, 25.0), rng.uniform(600.0, 2400.0)
    seal = rng.uniform(0.01, 0.04)
    # amount of gas per piston area at rest, from the ideal law; the real one acts from there on
    per_area = filled_pa * (dead + swept) / (GAS * HALL_K)

    def build(area_m2: float) -> Mechanism:
        def pull(rows: TableRows, tau_nm: Array) -> Array:
            out = strut.length_m(rows.q_rad[:, BALANCED]) - short
            kelvin = HALL_K + warmer_k * (1.0 - np.exp(-rows.time_s / warm_s))
            height = dead + swept - out
            pressure = (
                per_area * GAS * kelvin / (height - per_area * OWN_VOLUME) - ATTRACTION * (per_area / height) ** 2
            )
            force = area_m2 * (pressure - AIR_PA)
            lever = strut.lever_m(rows.q_rad[:, BALANCED])
            drag = seal * force * np.tanh(lever / 0.02) * rows.direction
            return on_axis(BALANCED, -(force + drag) * lever)

        return Mechanism("gas_balancer", (2,), area_m2, on_joint=pull)

    return build, (0.0, 0.01)


def coil_balancer(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A stretched coil with friction in its leaves and eyes: its force lags its length by a few mm."""
    strut = draw_linkage(arm, rng)
    short, long = strut.span_m(np.linspace(-2.0, 2.0, 81))
    free = short * rng.uniform(0.75, 0.98)
    lag_m = (long - short) * rng.uniform(0.005, 0.02)

    def build(stiffness_n_m: float) -> Mechanism:
        def pull(rows: TableRows, tau_nm: Array) -> Array:
            corners = rows.path(lambda q: strut.length_m(q[:, BALANCED]))
            stretch = play(corners, lag_m) - free
            return on_axis(BALANCED, -stiffness_n_m * stretch * strut.lever_m(rows.q_rad[:, BALANCED]))

        return Mechanism("coil_balancer", (2,), stiffness_n_m, on_joint=pull)

    return build, (0.0, 3e5)


def clamped_cable(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """Hoses of the tool between two clamps: they twist, bend beyond some angle, stiffen, and have mutual friction."""
    axis = int(rng.integers(3, 6))
    middle, stiffening_turn = rng.uniform(-0.5, 0.5), rng.uniform(1.5, 3.0)
    stiffens, bends = rng.uniform(0.1, 0.5), rng.uniform(0.1, 0.6)
    phase, lag_rad = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.02, 0.10)

    def build(stiffness_nm_rad: float) -> Mechanism:
        def pull(rows: TableRows, tau_nm: Array) -> Array:
            angle = play(rows.path(lambda q: q[:, axis]), lag_rad) - middle
            twist = angle + stiffens * angle**3 / stiffening_turn**2
            bend = bends * (np.sin(angle + phase) - np.sin(phase))
            return on_axis(axis, -stiffness_nm_rad * (twist + bend))

        return Mechanism("clamped_cable", (axis + 1,), stiffness_nm_rad, on_joint=pull)

    return build, (0.0, 0.3 * float(arm.rated_nm[axis]))


def stiffening_gear(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A gear that winds up under its torque, softly while few teeth bear, two to four times stiffer under load."""
    axis = int(rng.choice([1, 2, 4]))
    knee_nm = float(arm.rated_nm[axis]) * rng.uniform(0.15, 0.4)
    stiffer = rng.uniform(2.0, 4.0)

    def build(compliance_rad_nm: float) -> Mechanism:
        def give(rows: TableRows, tau_nm: Array) -> Array:
            torque = tau_nm[:, axis]
            soft = knee_nm * np.tanh(torque / knee_nm)
            return on_axis(axis, -compliance_rad_nm * (soft + (torque - soft) / stiffer))

        return Mechanism("stiffening_gear", (axis + 1,), compliance_rad_nm, on_angle=give)

    return build, (0.0, 0.04 / float(arm.rated_nm[axis]))


SPRINGS: dict[str, Maker] = {
    "gas_balancer": gas_balancer,
    "coil_balancer": coil_balancer,
    "clamped_cable": clamped_cable,
    "stiffening_gear": stiffening_gear,
}
