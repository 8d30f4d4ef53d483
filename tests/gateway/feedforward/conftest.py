"""Arms for the tests: random ones as URDF text, so that independent libraries read the same arm; the example cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.config import load_cell
from gateway.model.robot import robot_from_urdf

EXAMPLES = Path(__file__).parents[3] / "examples"


def urdf_of(rng: np.random.Generator, load: str = "") -> str:
    """URDF text of a random arm of six axes; `load` is the text of an <inertial> fixed to link 6."""
    parts, parent = ['<robot name="random"><link name="base"/>'], "base"
    say = "{:.17g} {:.17g} {:.17g}".format
    for i in range(1, 7):
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
    if load:
        parts.append(
            f'<link name="load">{load}</link><joint name="load_joint" type="fixed"><parent link="link_6"/>'
            '<child link="load"/><origin xyz="0 0 0" rpy="0 0 0"/></joint>'
        )
    return "".join([*parts, "</robot>"])


@pytest.fixture
def random_urdf():
    """Factory: seed, load -> URDF text of a random arm."""
    return lambda seed, load="": urdf_of(np.random.default_rng(seed), load)


@pytest.fixture
def large():
    """The large example cell, loaded."""
    return load_cell(EXAMPLES / "large" / "cell.toml")


@pytest.fixture
def qh165():
    """Its robot."""
    return robot_from_urdf((EXAMPLES / "large" / "robot.urdf").read_text(), "robot.urdf")
