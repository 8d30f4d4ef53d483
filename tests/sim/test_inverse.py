"""Inverse dynamics of the simulator against closed forms and against pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from sim.draw import GRAVITY, arm_geometry
from sim.inverse import InverseDynamics
from sim.urdf import SimBody, SimChain, UrdfError, write_chain

G = 9.80665


def pendulum(mass_kg: float, length_m: float, inertia_kg_m2: float) -> SimChain:
    """One joint about y; at angle 0 the rod is along x."""
    body = SimBody(mass_kg, np.array([length_m, 0.0, 0.0]), inertia_kg_m2 * np.eye(3))
    one = np.ones(1)
    return SimChain("pendulum", np.eye(4)[None], np.array([[0.0, 1.0, 0.0]]), (body,), -one, one, one, one)


def test_a_pendulum_needs_its_weight_and_its_inertia():
    mass, length, inertia = 3.0, 0.4, 0.05
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.normal(size=(3, 20, 1))
    with InverseDynamics(pendulum(mass, length, inertia), GRAVITY) as dynamics:
        torque = dynamics.torque_nm(q, qd, qdd)
    expected = -mass * G * length * np.cos(q) + (inertia + mass * length**2) * qdd
    np.testing.assert_allclose(torque, expected, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_arm_with_a_skew_load_needs_what_pinocchio_says(seed):
    rng = np.random.default_rng(seed)
    chain = arm_geometry(60.0, rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    last = SimBody(20.0, rng.normal(size=3) * 0.2, turn @ np.diag([0.3, 0.5, 0.6]) @ turn.T)
    chain = replace(chain, bodies=(*chain.bodies[:-1], last))
    q, qd, qdd = rng.normal(size=(3, 10, 6))
    with InverseDynamics(chain, GRAVITY) as dynamics:
        torque = dynamics.torque_nm(q, qd, qdd)
    model = pinocchio.buildModelFromXML(write_chain(chain))
    model.gravity.linear = GRAVITY
    data = model.createData()
    expected = [pinocchio.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(torque, expected, atol=1e-7 * np.abs(expected).max())


def test_a_link_without_inertial_is_refused():
    with pytest.raises(UrdfError, match="link_1 has no inertial"):
        InverseDynamics(replace(pendulum(1.0, 0.1, 0.1), bodies=(None,)), GRAVITY)
