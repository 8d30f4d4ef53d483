"""Mechanisms outside a library of smooth curves: knees, stops, steps, gusts, tethers, liquids, friction jumps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows, on_axis
from benchmarks.nature.springs import Build, Maker
from sim.offline import link_frames

Array = NDArray[np.float64]


def saturated_current(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A current sensor that saturates: above a knee a share of what is added is lost."""
    axis = int(rng.integers(1, 3))
    knee_nm = float(arm.rated_nm[axis]) * rng.uniform(0.25, 0.5)

    def build(lost: float) -> Mechanism:
        def read(rows: TableRows, motor_nm: Array) -> Array:
            torque = motor_nm[:, axis]
            above = np.maximum(np.abs(torque) - knee_nm, 0.0)
            return motor_nm - on_axis(axis, lost * above * np.sign(torque))

        return Mechanism("saturated_current", (axis + 1,), lost, on_reading=read)

    return build, (0.0, 0.9)


def end_stop(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A rubber stop or a bellows that is touched over the last third of the range and pushes back harder and harder."""
    axis, side = int(rng.integers(1, 5)), rng.choice([-1.0, 1.0])
    at_rad = side * float(np.quantile(side * rows.q_rad[:, axis], rng.uniform(0.55, 0.75)))
    power = rng.uniform(1.0, 1.6)

    def build(stiffness: float) -> Mechanism:
        def push(rows: TableRows, tau_nm: Array) -> Array:
            into = np.maximum(side * (rows.q_rad[:, axis] - at_rad), 0.0)
            return on_axis(axis, -side * stiffness * into**power)

        return Mechanism("end_stop", (axis + 1,), stiffness, on_joint=push)

    return build, (0.0, 2.0 * float(arm.rated_nm[axis]))


def detents(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """Magnets or a chain that fall from one sector into the next: a torque that jumps between levels."""
    axis = int(rng.integers(6))
    edges = np.sort(rng.uniform(arm.chain.lower_rad[axis], arm.chain.upper_rad[axis], 7))
    levels = rng.choice([-1.0, 1.0], 8) * rng.uniform(0.5, 1.5, 8)

    def build(torque_nm: float) -> Mechanism:
        def push(rows: TableRows, tau_nm: Array) -> Array:
            return on_axis(axis, torque_nm * levels[np.searchsorted(edges, rows.q_rad[:, axis])])

        return Mechanism("detents", (axis + 1,), torque_nm, on_joint=push)

    return build, (0.0, float(arm.rated_nm[axis]))


def gusts(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """Another machine beside the arm: blasts of a minute every few minutes, along one direction, on the wrist."""
    towards = rng.standard_normal(3)
    towards = towards / np.linalg.norm(towards)
    period_s, length_s, phase_s = rng.uniform(150.0, 420.0), rng.uniform(40.0, 110.0), rng.uniform(0.0, 400.0)
    strength = rng.uniform(0.3, 1.7, 40)

    def build(force_n: float) -> Mechanism:
        def push(rows: TableRows, tau_nm: Array) -> Array:
            since = rows.time_s + phase_s
            number = (since // period_s).astype(int) % len(strength)
            blows = (since % period_s < length_s) * strength[number]
            return force_n * blows[:, None] * pulled(arm, rows.q_rad, np.tile(towards, (len(since), 1)))

        return Mechanism("gusts", (), force_n, on_joint=push)

    return build, (0.0, 20.0 * arm.tool.mass_kg)


def moody_gear(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A gear whose grease drains and returns: its friction jumps between two levels at random times."""
    axis = int(rng.integers(6))
    jumps = np.sort(rng.uniform(float(rows.time_s.min()), float(rows.time_s.max()), 7))

    def build(share: float) -> Mechanism:
        def rub(rows: TableRows, tau_nm: Array, band_nm: Array) -> tuple[Array, Array]:
            high = np.searchsorted(jumps, rows.time_s) % 2
            more = share * high * arm.friction.coulomb_nm[axis]
            return np.zeros_like(band_nm), band_nm + on_axis(axis, more)

        return Mechanism("moody_gear", (axis + 1,), share, on_friction=rub)

    return build, (0.0, 3.0)


def tether(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A hose from the ceiling to the wrist that is slack near by and taut beyond its length."""
    tips = link_frames(arm.chain, rows.q_rad)[:, 5, :3, 3]
    reach = float(np.linalg.norm(tips, axis=1).max())
    anchor = reach * np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(0.8, 1.6)])
    slack_m = float(np.quantile(np.linalg.norm(tips - anchor, axis=1), rng.uniform(0.4, 0.6)))

    def build(stiffness_n_m: float) -> Mechanism:
        def pull(rows: TableRows, tau_nm: Array) -> Array:
            way = anchor - link_frames(arm.chain, rows.q_rad)[:, 5, :3, 3]
            length = np.linalg.norm(way, axis=1)
            force = stiffness_n_m * np.maximum(length - slack_m, 0.0) / length
            return pulled(arm, rows.q_rad, force[:, None] * way)

        return Mechanism("tether", (), stiffness_n_m, on_joint=pull)

    return build, (0.0, 2e4)


def half_full_tank(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A liquid in the tool that runs to the lowest side of its flat tank; its size is the displacement of its
    centre.
    """
    flat = rng.uniform(0.1, 1.0, 3)

    def build(path_m: float) -> Mechanism:
        def moved(rows: TableRows) -> Array:
            down = -link_frames(arm.chain, rows.q_rad)[:, 5, 2, :3]
            out = np.zeros((len(down), 4))
            # a flat tank is full on one side as soon as it leans: the displacement saturates
            out[:, 1:] = arm.tool.mass_kg * path_m * flat * np.tanh(4.0 * down)
            return out

        return Mechanism("half_full_tank", (), path_m, on_load=moved)

    return build, (0.0, 0.3)


def pulled(arm: NatureArm, q_rad: Array, force_n: Array) -> Array:
    """Torque (n, 6) that a force (n, 3) on the origin of the last link exerts on the joints."""
    frames = link_frames(arm.chain, q_rad)
    axes = np.einsum("njab,jb->nja", frames[:, :, :3, :3], arm.chain.axis)
    levers = frames[:, 5:6, :3, 3] - frames[:, :, :3, 3]
    return np.einsum("nja,nja->nj", axes, np.cross(levers, force_n[:, None, :]))


UNMODELLED: dict[str, Maker] = {
    "saturated_current": saturated_current,
    "end_stop": end_stop,
    "detents": detents,
    "gusts": gusts,
    "moody_gear": moody_gear,
    "tether": tether,
    "half_full_tank": half_full_tank,
}
