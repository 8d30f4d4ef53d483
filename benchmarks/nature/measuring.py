"""Rows of a measured table of an arm: equilibrium, friction, reported values, and outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows, rows_of
from sim.offline import PlannedVisit, gravity_columns

Array = NDArray[np.float64]

#: Iterations until angle and torque agree; a gear deflection of 0.02 rad converges to 1e-8 of its torque.
STEPS = 6
#: A gross error, in bands of its axis.
OUTLIER_BANDS = (4.0, 15.0)
#: Patterns of an outlier: from below only, from above only, both equal, both opposite.
OUTLIER_PATTERNS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])


@dataclass(frozen=True, slots=True)
class OutlierVisit:
    """An outlier on one axis: its place among the visits, axis from 1, size in bands of that axis."""

    visit: int
    pose: int
    load: str
    joint: int
    bands: float


@dataclass(frozen=True, slots=True)
class Stops:
    """Random contributions to the rows (n, 6): share of the kinetic level left, scatter in bands, angle, noise."""

    left: Array
    scatter: Array
    angle_rad: Array
    noise_nm: Array


def quiet(arm: NatureArm, rows: TableRows) -> Stops:
    """Return equal stops without noise."""
    nothing = np.zeros_like(rows.q_rad)
    return Stops(nothing + arm.friction.mean_left, nothing, nothing, nothing)


def chance(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> Stops:
    """What chance does to visits that are measured from both sides."""
    visits = len(rows.time_s) // 2
    left, scatter = (part.reshape(-1, 6) for part in arm.friction.stops(visits, rng))
    angle = np.repeat(arm.repeat_rad * rng.standard_normal((visits, 6)), 2, axis=0)
    noise = arm.noise_nm / np.sqrt(arm.samples) * rng.standard_normal(left.shape)
    return Stops(left, scatter, angle, noise)


def equilibrium(arm: NatureArm, rows: TableRows, effects: Sequence[Mechanism], angle_rad: Array) -> tuple[Array, Array]:
    """Torque that the gears transmit (n, 6) [Nm] and true link angles (n, 6) [rad]."""
    gravity, links = arm.gravity_m_s2, arm.links
    load = np.where(rows.loaded[:, None], arm.load, 0.0)
    for effect in effects:
        gravity = gravity if effect.gravity_m_s2 is None else effect.gravity_m_s2
        links = links if effect.links is None else links + effect.links
        load = load if effect.on_load is None else load + rows.loaded[:, None] * effect.on_load(rows)
    tau = np.zeros_like(rows.q_rad)
    q = rows.q_rad + angle_rad
    for _ in range(STEPS if any(e.on_angle is not None for e in effects) else 2):
        # the load keeps the teeth on one flank; an unloaded joint floats in the play
        flank = np.tanh(tau / np.maximum(0.3 * arm.friction.coulomb_nm, 1e-9))
        q = rows.q_rad + angle_rad - 0.5 * arm.backlash_rad * flank
        for effect in effects:
            if effect.on_angle is not None:
                q = q + effect.on_angle(rows, tau)
        columns = gravity_columns(arm.chain, q, gravity)
        tau = columns @ links + np.einsum("nap,np->na", columns[:, :, 20:], load)
        held = tau
        for effect in effects:
            if effect.on_joint is not None:
                tau = tau - effect.on_joint(rows, held)
    return tau, q


def reported_nm(arm: NatureArm, rows: TableRows, effects: Sequence[Mechanism], stops: Stops) -> tuple[Array, Array]:
    """What the drives report (n, 6) [Nm], joint side, and the torque the gears transmit (n, 6)."""
    tau, _ = equilibrium(arm, rows, effects, stops.angle_rad)
    band = arm.friction.band_nm(tau, rows.time_s)
    mean, half = arm.friction.bias_share * band, band
    for effect in effects:
        if effect.on_friction is not None:
            more, half = effect.on_friction(rows, tau, half)
            mean = mean + more
    cold = arm.friction.coulomb_nm * arm.friction.cold(rows.time_s)
    behind = tau + rows.direction[:, None] * half * stops.left + mean + cold * stops.scatter
    seen = (1.0 + arm.gain) * arm.friction.motor_nm(behind, rows.direction) + cogging_nm(arm, rows.q_rad)
    for effect in effects:
        if effect.on_reading is not None:
            seen = effect.on_reading(rows, seen)
    return seen + stops.noise_nm, tau


def cogging_nm(arm: NatureArm, q_rad: Array) -> Array:
    """Torque (n, 6) [Nm] that follows the motor's angle, once and twice a turn."""
    turn = arm.gear_ratio * q_rad
    waves = np.stack([np.sin(turn), np.cos(turn), np.sin(2.0 * turn), np.cos(2.0 * turn)], axis=2)
    return np.einsum("nac,ac->na", waves, arm.cogging_nm)


def draw_outliers(
    arm: NatureArm, visits: Sequence[PlannedVisit], rng: np.random.Generator
) -> tuple[tuple[OutlierVisit, ...], Array]:
    """Visits that go wrong, and what that adds to the rows (2 visits, 6) [Nm]: a cable caught, a brake, a touch."""
    added, found = np.zeros((len(visits), 2, 6)), []
    for number, wrong in enumerate(rng.random(len(visits)) < arm.friction.outlier_share):
        if not wrong:
            continue
        axis = int(rng.integers(6))
        bands = float(rng.uniform(*OUTLIER_BANDS))
        way = OUTLIER_PATTERNS[rng.integers(len(OUTLIER_PATTERNS))] * rng.choice([-1.0, 1.0])
        band = float(arm.friction.band_nm(np.zeros((1, 6)), np.array([visits[number].time_s]))[0, axis])
        added[number, :, axis] = bands * band * way
        found.append(OutlierVisit(number, visits[number].pose, visits[number].load, axis + 1, bands))
    return tuple(found), added.reshape(-1, 6)


def measure(
    arm: NatureArm, visits: Sequence[PlannedVisit], effects: Sequence[Mechanism], rng: np.random.Generator
) -> tuple[dict[str, NDArray[Any]], tuple[OutlierVisit, ...]]:
    """Columns of a measured table as `sim.offline.measure` gives them, and which visits went wrong."""
    rows = rows_of(visits)
    outliers, added = draw_outliers(arm, visits, rng)
    seen, _ = reported_nm(arm, rows, effects, chance(arm, rows, rng))
    step = arm.resolution_nm
    # noise above half a step dithers the rounding of the readings away; below it the mean is rounded
    rough = np.where(arm.noise_nm > 0.5 * step, seen, np.round(seen / step) * step)
    freedom = arm.samples - 1
    spread = arm.noise_nm * np.sqrt(rng.chisquare(freedom, rows.q_rad.shape) / freedom)
    unknown = np.full_like(rows.q_rad, np.nan)
    columns: dict[str, NDArray[Any]] = {
        "load": np.array([visit.load for visit in visits for _ in range(2)]),
        "pose": rows.pose,
        "time_s": rows.time_s,
        "n": np.full(len(rows.time_s), arm.samples),
        "q_rad": rows.q_rad,
        "dir": np.repeat(rows.direction[:, None], 6, axis=1),
        "tau_nm": rough + added,
        "tau_std_nm": np.hypot(spread, step / np.sqrt(12.0)),
        "temp_c": unknown,
        "q2nd_rad": unknown,
    }
    for effect in effects:
        if effect.wired is not None:
            columns = effect.wired(columns)
    return columns, outliers
