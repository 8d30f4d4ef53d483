"""Inverse dynamics of the simulator against pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from benchmarks.blind.drawn_arm import arm_geometry
from sim.draw import GRAVITY
from sim.engine import Engine
from sim.urdf import SimBody, UrdfError, write_chain


@pytest.mark.parametrize("seed", [1, 2])
def test_an_arm_with_a_skew_load_needs_what_pinocchio_says(seed):
    rng = np.random.default_rng(seed)
    chain = arm_geometry(60.0, rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    last = SimBody(20.0, rng.normal(size=3) * 0.2, turn @ np.diag([0.3, 0.5, 0.6]) @ turn.T)
    chain = replace(chain, bodies=(*chain.bodies[:-1], last))
    q, qd, qdd = rng.normal(size=(3, 10, 6))
    with Engine([chain], GRAVITY) as dynamics:
        torque = dynamics.torque_nm(q, qd, qdd)
    model = pinocchio.buildModelFromXML(write_chain(chain))
    model.gravity.linear = GRAVITY
    data = model.createData()
    expected = [pinocchio.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(torque, expected, atol=1e-7 * np.abs(expected).max())


def test_a_link_without_inertial_is_refused():
    with pytest.raises(UrdfError, match="link_1 has no inertial"):
        Engine([replace(arm_geometry(60.0, np.random.default_rng(1)), bodies=(None,) * 6)], GRAVITY)
