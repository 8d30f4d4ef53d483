"""Random arms as URDF text, so that independent libraries read the same arm, and what tests ask of an arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
from numpy.typing import ArrayLike


def urdf_of(rng: np.random.Generator, more: str = "", axes: int = 6) -> str:
    """URDF text of a random arm with random inertials; `more` is put inside <robot>."""
    parts, parent = ['<robot name="random">', more, '<link name="base"/>'], "base"
    say = "{:.17g} {:.17g} {:.17g}".format
    for i in range(1, axes + 1):
        xyz, rpy, axis = rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3), rng.normal(size=3)
        com, turn, mass = rng.uniform(-0.2, 0.2, 3), rng.uniform(-3, 3, 3), rng.uniform(1, 20)
        size = rng.uniform(0.1, 0.5, 3)
        xx, yy, zz = mass / 12 * (size @ size - size**2)
        parts.append(
            f'<link name="link_{i}"><inertial><origin xyz="{say(*com)}" rpy="{say(*turn)}"/><mass value="{mass:.17g}"/>'
            f'<inertia ixx="{xx:.17g}" ixy="0" ixz="0" iyy="{yy:.17g}" iyz="0" izz="{zz:.17g}"/></inertial></link>'
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{say(*xyz)}" rpy="{say(*rpy)}"/><axis xyz="{say(*(axis / np.linalg.norm(axis)))}"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="2"/></joint>'
        )
        parent = f"link_{i}"
    return "".join([*parts, "</robot>"])


def peer_of(text: str, gravity_m_s2: tuple[float, ...] = (0.0, 0.0, -9.80665)) -> tuple[Any, Any]:
    """The same arm in pinocchio: model and data."""
    model = pinocchio.buildModelFromXML(text)
    model.gravity.linear = np.array(gravity_m_s2)
    return model, model.createData()


def carrying(model: Any, mass_kg: float, com_m: ArrayLike, inertia_kg_m2: ArrayLike = ((0.0,) * 3,) * 3) -> Any:
    """A copy of a pinocchio model with a body on its last joint; the inertia is about the body's centre."""
    loaded = model.copy()
    body = pinocchio.Inertia(mass_kg, np.array(com_m), np.array(inertia_kg_m2))
    loaded.appendBodyToJoint(loaded.nv, body, pinocchio.SE3.Identity())
    return loaded


def torque_of(model: Any, q: np.ndarray, qd: np.ndarray | None = None, qdd: np.ndarray | None = None) -> np.ndarray:
    """Joint torque (n, axes) [Nm] of a pinocchio model at these states (n, axes); at rest by default."""
    data, still = model.createData(), np.zeros_like(q)
    rows = zip(q, still if qd is None else qd, still if qdd is None else qdd, strict=True)
    return np.array([pinocchio.rnea(model, data, *row) for row in rows])


def sines(
    time_s: np.ndarray, size: ArrayLike, rate_rad_s: np.ndarray, phase_rad: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles, rates and accelerations (n, axes) of sums of sines; size, rate and phase are (terms, axes)."""
    angle = time_s[:, None, None] * rate_rad_s + phase_rad
    wave, slope = np.sin(angle), np.cos(angle)
    return tuple(np.sum(size * part, axis=1) for part in (wave, rate_rad_s * slope, -(rate_rad_s**2) * wave))  # type: ignore[return-value]


def states(seed: int, n: int, axes: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random angles, rates and accelerations (n, axes)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-np.pi, np.pi, (n, axes)), rng.normal(size=(n, axes)), 3 * rng.normal(size=(n, axes))


def link_parameters(robot: Any) -> np.ndarray:
    """[m, m c, I about the link's origin] (10 N,) of the links as drawn."""
    out = []
    for i in range(len(robot.axis)):
        mass, com = robot.mass_kg[i], robot.com_m[i]
        about = robot.inertia_kg_m2[i] + mass * (com @ com * np.eye(3) - np.outer(com, com))
        out += [mass, *(mass * com), *about[np.triu_indices(3)]]
    return np.array(out)
