"""Random arms as URDF text, so that independent libraries read the same arm, and what tests ask of an arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]


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


def body_on_link_6(inertial: str) -> str:
    """URDF text of a body fixed to link 6, from the text of its <inertial>."""
    return (
        f'<link name="load">{inertial}</link><joint name="load_joint" type="fixed"><parent link="link_6"/>'
        '<child link="load"/><origin xyz="0 0 0" rpy="0 0 0"/></joint>'
    )


def peer_of(text: str, gravity_m_s2: tuple[float, ...] = (0.0, 0.0, -9.80665)) -> tuple[Any, Any]:
    """The same arm in pinocchio: model and data."""
    model = pinocchio.buildModelFromXML(text)
    model.gravity.linear = np.array(gravity_m_s2)
    return model, model.createData()


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
