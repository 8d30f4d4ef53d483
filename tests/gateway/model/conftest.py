"""Robots for the model tests: random arms as URDF text, so that independent libraries read the same arm."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.rows import Table


def urdf_of(rng: np.random.Generator, before: str = "") -> str:
    """URDF text of a random arm of six axes with random inertials; `before` is put inside <robot>."""
    parts = ['<robot name="random">', before, '<link name="base"/>']
    parent = "base"
    for i in range(1, 7):
        xyz, rpy, axis = rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3), rng.normal(size=3)
        com, turn, mass = rng.uniform(-0.2, 0.2, 3), rng.uniform(-3, 3, 3), rng.uniform(1, 20)
        size = rng.uniform(0.1, 0.5, 3)
        xx, yy, zz = mass / 12 * (size @ size - size**2)
        say = "{:.17g} {:.17g} {:.17g}".format
        parts.append(
            f'<link name="link_{i}"><inertial><origin xyz="{say(*com)}" rpy="{say(*turn)}"/><mass value="{mass:.17g}"/>'
            f'<inertia ixx="{xx:.17g}" ixy="0" ixz="0" iyy="{yy:.17g}" iyz="0" izz="{zz:.17g}"/></inertial></link>'
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{say(*xyz)}" rpy="{say(*rpy)}"/><axis xyz="{say(*(axis / np.linalg.norm(axis)))}"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="2"/></joint>'
        )
        parent = f"link_{i}"
    return "".join([*parts, "</robot>"])


@pytest.fixture
def random_urdf():
    """Factory: seed -> URDF text of a random arm."""
    return lambda seed, before="": urdf_of(np.random.default_rng(seed), before)


@pytest.fixture
def measured_data() -> Path:
    """Folder of the measured runs of real robots."""
    folder = os.environ.get("SERVO_GATEWAY_DATA")
    if not folder:
        pytest.skip("SERVO_GATEWAY_DATA is not set: the measured runs of real robots are not at hand")
    return Path(folder)


@pytest.fixture
def qh165_dh() -> SimpleNamespace:
    """The QH165 paper's Table 1, modified Denavit-Hartenberg."""
    quarter = np.pi / 2
    return SimpleNamespace(
        convention="modified",
        alpha_rad=(0.0, -quarter, 0.0, -quarter, quarter, -quarter),
        a_m=(0.0, 0.400, 1.100, 0.230, 0.0, 0.0),
        d_m=(0.0, 0.0, 0.0, 1.13456, 0.0, 0.244),
        theta_offset_rad=(0.0, -quarter, 0.0, 0.0, 0.0, 0.0),
    )


def make_rest_table(load, pose, direction, tau, **given) -> Table:
    """Rest rows: `direction` and `tau` one number per row for all six axes, or (n, 6)."""
    n = len(load)
    unknown = np.full((n, 6), np.nan)

    def six(values):
        return np.broadcast_to(np.asarray(values, dtype=float).reshape(n, -1), (n, 6)).copy()

    return Table(
        file=("test.csv",) * n,
        line=np.arange(2, n + 2),
        run=np.asarray(given.get("run", ["r"] * n)),
        load=np.asarray(load),
        pose=np.asarray(pose),
        time_s=np.asarray(given.get("time", np.full(n, np.nan)), dtype=float),
        q_rad=np.asarray(given.get("q", np.zeros((n, 6))), dtype=float),
        qd_rad_s=np.zeros((n, 6)),
        qdd_rad_s2=np.zeros((n, 6)),
        moving=np.zeros(n, dtype=bool),
        direction=six(direction).astype(np.int8),
        tau_nm=six(tau),
        tau_std_nm=np.full((n, 6), given.get("std", np.nan)),
        count=np.full(n, given.get("count", 1)),
        q2nd_rad=unknown,
        temperature_c=unknown,
        motor_torque_nm=unknown,
    )


@pytest.fixture
def rest_table():
    """Factory of rest tables."""
    return make_rest_table
