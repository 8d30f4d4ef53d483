"""Effects of drives, motors and gears: sensor offsets, wrong and warm constants, ripple, losses, direction-dependent
drag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows, on_axis
from benchmarks.nature.springs import Build, Maker

Array = NDArray[np.float64]


def offset_sensor(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A current sensor whose zero has moved."""
    axis, sign = int(rng.integers(6)), rng.choice([-1.0, 1.0])

    def build(offset_nm: float) -> Mechanism:
        def read(rows: TableRows, motor_nm: Array) -> Array:
            return motor_nm + on_axis(axis, np.full(len(motor_nm), sign * offset_nm))

        return Mechanism("offset_sensor", (axis + 1,), offset_nm, on_reading=read)

    return build, (0.0, 0.3 * float(arm.rated_nm[axis]))


def wrong_constant(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A motor of another winding than the one in the file: its constant is 10 % off, or more."""
    axis, sign = int(rng.integers(1, 6)), rng.choice([-1.0, 1.0])

    def build(share: float) -> Mechanism:
        def read(rows: TableRows, motor_nm: Array) -> Array:
            return motor_nm - on_axis(axis, motor_nm[:, axis] * (1.0 - 1.0 / (1.0 + sign * share)))

        return Mechanism("wrong_constant", (axis + 1,), share, on_reading=read)

    return build, (0.10, 0.40)


def strong_ripple(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A wave generator that is out of true, or a rotor whose magnets are: once or twice a turn, overtones beside it."""
    axis, order = int(rng.integers(6)), int(rng.integers(1, 3))
    phase, over, grows = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(0.0, 0.3), rng.uniform(0.0, 0.3)

    def build(amplitude_nm: float) -> Mechanism:
        def read(rows: TableRows, motor_nm: Array) -> Array:
            turn = arm.gear_ratio[axis] * rows.q_rad[:, axis]
            wave = np.sin(order * turn + phase[0]) + over * np.sin(2.0 * order * turn + phase[1])
            load = 1.0 + grows * np.abs(motor_nm[:, axis]) / arm.rated_nm[axis]
            return motor_nm + on_axis(axis, amplitude_nm * load * wave)

        return Mechanism("strong_ripple", (axis + 1,), amplitude_nm, on_reading=read)

    return build, (0.0, 0.3 * float(arm.rated_nm[axis]))


def weak_magnets(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """Magnets that weaken while winding and housing warm up in turn: the same torque takes more current."""
    axis = int(rng.integers(1, 6))
    fast_s, slow_s, fast = rng.uniform(60.0, 240.0), rng.uniform(600.0, 3000.0), rng.uniform(0.2, 0.5)
    kelvin = rng.uniform(30.0, 60.0)

    def build(per_k: float) -> Mechanism:
        def read(rows: TableRows, motor_nm: Array) -> Array:
            warm = fast * (1.0 - np.exp(-rows.time_s / fast_s)) + (1.0 - fast) * (1.0 - np.exp(-rows.time_s / slow_s))
            return motor_nm + on_axis(axis, motor_nm[:, axis] * per_k * kelvin * warm)

        return Mechanism("weak_magnets", (axis + 1,), per_k, on_reading=read)

    return build, (0.0, 0.003)


def lossy_gear(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A worn or dry gear: a fifth of what it transmits is lost, more at full torque than in proportion."""
    axis, power = int(rng.integers(1, 6)), rng.uniform(0.9, 1.25)
    rated = float(arm.rated_nm[axis])

    def build(share: float) -> Mechanism:
        def rub(rows: TableRows, tau_nm: Array, band_nm: Array) -> tuple[Array, Array]:
            more = share * rated * (np.abs(tau_nm[:, axis]) / rated) ** power
            return np.zeros_like(band_nm), band_nm + on_axis(axis, more)

        return Mechanism("lossy_gear", (axis + 1,), share, on_friction=rub)

    return build, (0.2, 0.5)


def one_way_drag(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A seal or a brake with more drag in one direction: half a band and more between the directions, less when
    warm.
    """
    axis, sign = int(rng.integers(6)), rng.choice([-1.0, 1.0])

    def build(share: float) -> Mechanism:
        def rub(rows: TableRows, tau_nm: Array, band_nm: Array) -> tuple[Array, Array]:
            return on_axis(axis, sign * share * band_nm[:, axis]), band_nm

        return Mechanism("one_way_drag", (axis + 1,), share, on_friction=rub)

    return build, (0.35, 0.9)


DRIVES: dict[str, Maker] = {
    "offset_sensor": offset_sensor,
    "wrong_constant": wrong_constant,
    "strong_ripple": strong_ripple,
    "weak_magnets": weak_magnets,
    "lossy_gear": lossy_gear,
    "one_way_drag": one_way_drag,
}
