"""Arms of Denavit-Hartenberg rows: the chain is that of the rows, the links are stated, the axes can carry them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gateway.cell.config import DhTable
from gateway.model.kinematics import link_frames
from gateway.model.robot import robot_from_dh
from sim.dh import LINKS_SHARE, chain_of_rows
from sim.urdf import UrdfError, rotation_rpy

ROWS = {
    "alpha_rad": [0.3, -1.1, 0.7, 1.5, -1.4],
    "a_m": [0.1, 0.45, -0.2, 0.07, 0.0],
    "d_m": [0.4, -0.06, 0.12, 0.3, 0.09],
    "theta_offset_rad": [0.2, -1.2, 0.5, 0.1, -0.4],
}
LIMITS = np.array([300.0, 300.0, 150.0, 60.0, 30.0])


def turned(axis, angle):
    """Rotation by Rodrigues' formula."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def last_pose(chain, q):
    pose = np.eye(4)
    for placement, axis, angle in zip(chain.placement, chain.axis, q, strict=True):
        step = np.eye(4)
        step[:3, :3] = turned(axis, angle)
        pose = pose @ placement @ step
    return pose


def elementary(rows, convention, q):
    """The last frame as a product of elementary turns and moves, as the conventions are defined."""
    pose = np.eye(4)
    for alpha, a, d, theta in zip(
        rows["alpha_rad"], rows["a_m"], rows["d_m"], rows["theta_offset_rad"] + q, strict=True
    ):
        screw_x, screw_z = np.eye(4), np.eye(4)
        screw_x[:3, :3], screw_x[0, 3] = rotation_rpy((alpha, 0, 0)), a
        screw_z[:3, :3], screw_z[2, 3] = rotation_rpy((0, 0, theta)), d
        pose = pose @ (screw_x @ screw_z if convention == "modified" else screw_z @ screw_x)
    return pose


@pytest.mark.parametrize("convention", ["modified", "standard"])
def test_the_chain_is_that_of_the_rows_and_the_masters_too(convention):
    chain = chain_of_rows(ROWS | {"convention": convention}, "arm", (0, 0, 0), LIMITS)
    robot = robot_from_dh(DhTable(convention=convention, **ROWS), "arm")
    for q in np.random.default_rng(3).uniform(-3, 3, (20, 5)):
        expected = elementary({key: np.array(value) for key, value in ROWS.items()}, convention, q)
        np.testing.assert_allclose(last_pose(chain, q), expected, atol=1e-12)
        np.testing.assert_allclose(link_frames(robot, q[None])[0, -1], expected, atol=1e-12)


@pytest.mark.parametrize("convention", ["modified", "standard"])
def test_links_reach_from_joint_to_joint_and_are_carried(convention):
    chain = chain_of_rows(ROWS | {"convention": convention}, "arm", (0, 0, 0.1), LIMITS)
    assert all(body is not None and body.mass_kg > 0 for body in chain.bodies)
    for body, step in zip(chain.bodies, chain.placement[1:, :3, 3], strict=False):
        np.testing.assert_allclose(body.com_m, step / 2)
        moments = np.linalg.eigvalsh(body.inertia_kg_m2)
        assert moments[0] > 0
        assert moments[2] < moments[0] + moments[1]
    stretched = [float(np.linalg.norm(step)) for step in (*chain.placement[1:, :3, 3], (0, 0, 0.1))]
    for joint, limit in enumerate(LIMITS):
        middles = np.cumsum(stretched[joint:]) - np.array(stretched[joint:]) / 2
        masses = [body.mass_kg for body in chain.bodies[joint:]]
        assert 9.80665 * middles @ masses <= LINKS_SHARE * limit * (1 + 1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"convention": "other"}, "neither 'modified' nor 'standard'"),
        ({"convention": "standard", "a_m": [0, 0.4, 0.3, 0, 0.1]}, "the last a_m must be 0"),
        ({"d_m": [0, 0, 0, 0, math.nan]}, "rows of finite numbers"),
    ],
)
def test_rows_that_are_no_arm_are_named(change, words):
    with pytest.raises(UrdfError, match=words):
        chain_of_rows({"convention": "modified"} | ROWS | change, "arm", (0, 0, 0), LIMITS)
