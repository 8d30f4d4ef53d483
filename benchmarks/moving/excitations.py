"""Series by chance, scaled up until the first limit is met: what a run is driven with where nothing is designed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.moving_arm import MovingArm
from gateway.excite.excitation import Series
from sim.engine import Engine

Floats = NDArray[np.float64]

HARMONICS = 5
#: Share of the limits that is used.
USED = 0.9
CHECKED = 200
#: Steps by which all joints are scaled down together, and how many there are at most.
SMALLER, STEPS = 0.9, 60


def random_series(
    arm: MovingArm, period_s: float, periods: int, rng: np.random.Generator, harmonics: int = HARMONICS
) -> Series:
    """A series of an arm: joints within their positions and speeds, all together within the torques with the load."""
    chain, axes = arm.chain, len(arm.rated_nm)
    order = np.arange(1, harmonics + 1)
    sine = _without(rng.standard_normal((axes, harmonics)) / order, order)
    cosine = _without(rng.standard_normal((axes, harmonics)) / order, order**2)
    times = np.arange(CHECKED) * period_s / CHECKED
    q, qd, qdd, _ = Series("drawn", np.zeros(axes), cosine, sine, period_s, periods).at(times)
    range_rad = USED * (chain.upper_rad - chain.lower_rad) * rng.uniform(0.4, 1.0, axes)
    scale = np.minimum(range_rad / np.ptp(q, axis=0), USED * chain.velocity_rad_s / np.abs(qd).max(axis=0))
    spare = 0.5 * (USED * (chain.upper_rad - chain.lower_rad) - scale * np.ptp(q, axis=0))
    middle = 0.5 * (chain.upper_rad + chain.lower_rad) + spare * rng.uniform(-1.0, 1.0, axes)
    centre = middle - scale * 0.5 * (q.max(axis=0) + q.min(axis=0))
    with Engine([arm.carrying("tool")], arm.gravity_m_s2) as dynamics:
        for _ in range(STEPS):
            torque = dynamics.torque_nm(centre + scale * q, scale * qd, scale * qdd)
            torque = torque + scale * qdd * arm.rotor_inertia_kg_m2
            if (np.abs(torque).max(axis=0) <= USED * chain.effort_nm).all():
                break
            scale = SMALLER * scale
    size = scale[:, None]
    return Series("drawn", centre, size * cosine, size * sine, period_s, periods)


def _without(values: Floats, direction: NDArray[np.int_]) -> Floats:
    """Values (N, H) without their part along a direction (H,)."""
    unit = direction / np.linalg.norm(direction)
    return values - np.outer(values @ unit, unit)
