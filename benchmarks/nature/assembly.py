"""How an arm is mounted, aligned, loaded and dressed: tilt, zeros, extra mass, a load that slips, gears that couple."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows, on_axis
from benchmarks.nature.springs import Build, Maker

Array = NDArray[np.float64]


def tilted_base(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A floor that is not level."""
    towards = rng.uniform(0.0, 2.0 * np.pi)
    size = float(np.linalg.norm(arm.gravity_m_s2))

    def build(angle_rad: float) -> Mechanism:
        side = np.sin(angle_rad) * np.array([np.cos(towards), np.sin(towards), 0.0])
        return Mechanism(
            "tilted_base", (), angle_rad, gravity_m_s2=size * (side - np.array([0.0, 0.0, np.cos(angle_rad)]))
        )

    return build, (0.0, 0.1)


def shifted_zero(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """An axis that was zeroed beside its mark, after its motor was changed."""
    axis, sign = int(rng.integers(1, 5)), rng.choice([-1.0, 1.0])

    def build(offset_rad: float) -> Mechanism:
        def angle(rows: TableRows, tau_nm: Array) -> Array:
            return on_axis(axis, np.full(len(rows.time_s), sign * offset_rad))

        return Mechanism("shifted_zero", (axis + 1,), offset_rad, on_angle=angle)

    return build, (0.0, 0.12)


def dressed_link(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """Valves, a feeder or a dress pack bolted on the outside of a link: a mass that no drawing has."""
    link = int(rng.integers(1, 4))
    length = max(float(np.linalg.norm(arm.chain.placement[link + 1, :3, 3])), 0.1)
    body = arm.chain.bodies[link]
    along = body.com_m / np.linalg.norm(body.com_m) if body is not None else np.array([0.0, 0.0, 1.0])
    at_m = length * (rng.uniform(0.1, 1.0) * along + rng.uniform(-0.35, 0.35, 3))

    def build(mass_kg: float) -> Mechanism:
        links = np.zeros(24)
        links[4 * link : 4 * link + 4] = mass_kg * np.append(1.0, at_m)
        return Mechanism("dressed_link", (link + 1,), mass_kg, links=links)

    return build, (0.0, arm.tool.mass_kg)


def slipping_load(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A part that slips in its gripper, in one or two jerks well inside the loaded visits."""
    loaded = np.sort(rows.time_s[rows.loaded])
    begin, end = np.quantile(loaded, [0.3, 0.7])
    first = rng.uniform(begin, end)
    second, part = first + rng.uniform(20.0, 60.0), rng.uniform(0.6, 1.0)
    way = rng.standard_normal(3)
    way = way / np.linalg.norm(way)

    def build(shift_m: float) -> Mechanism:
        def moved(rows: TableRows) -> Array:
            share = part * (rows.time_s > first) + (1.0 - part) * (rows.time_s > second)
            out = np.zeros((len(share), 4))
            out[:, 1:] = arm.tool.mass_kg * shift_m * share[:, None] * way
            return out

        return Mechanism("slipping_load", (), shift_m, on_load=moved)

    return build, (0.0, 0.25)


def geared_wrist(arm: NatureArm, rows: TableRows, rng: np.random.Generator) -> tuple[Build, tuple[float, float]]:
    """A hollow wrist whose last gear is carried by axis 5: motor 5 carries a share of the torque of motor 6."""
    sign = rng.choice([-1.0, 1.0])

    def build(ratio: float) -> Mechanism:
        def coupled(rows: TableRows, motor_nm: Array) -> Array:
            return motor_nm + on_axis(4, sign * ratio * motor_nm[:, 5])

        return Mechanism("geared_wrist", (5, 6), ratio, on_reading=coupled)

    return build, (0.0, 1.5)


ASSEMBLY: dict[str, Maker] = {
    "tilted_base": tilted_base,
    "shifted_zero": shifted_zero,
    "dressed_link": dressed_link,
    "slipping_load": slipping_load,
    "geared_wrist": geared_wrist,
}
