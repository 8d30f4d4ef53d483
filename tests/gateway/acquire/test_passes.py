"""Torque of the free motion of a period: against pinocchio, and nothing that the watch adds itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
import pytest

from gateway.acquire.passes import SMOOTH_RAD_S, free_torque_nm
from gateway.cell.config import SourcedNumber
from gateway.feedforward.identified import Known, axis_constants
from tests.data.excitations import swing
from tests.data.moving_arm import GRAVITY, URDF


@pytest.fixture
def motion(workspace):
    return swing(workspace).motion(0.01)


@pytest.fixture
def links_nm(motion):
    """What the links as drawn take."""
    model = pinocchio.buildModelFromXML(URDF)
    model.gravity.linear = GRAVITY
    data = model.createData()
    rows = zip(motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2, strict=True)
    return np.array([pinocchio.rnea(model, data, *row) for row in rows])


def test_links_rotors_and_typed_friction(small_cell, workspace, motion, links_nm):
    typed = {
        name: SourcedNumber(value=value, source="datasheet")
        for name, value in (("coulomb_nm", 4.0), ("viscous_nm_s_rad", 3.0))
    }
    arm = small_cell.cell.arm[0]
    arm = arm.model_copy(update={"axis": tuple(axis.model_copy(update=typed) for axis in arm.axis)})
    rotor = np.array([axis.rotor_inertia_kg_m2.value for axis in arm.axis])
    friction_nm = 4.0 * np.tanh(motion.qd_rad_s / SMOOTH_RAD_S) + 3.0 * motion.qd_rad_s
    found = free_torque_nm(workspace, arm, motion)
    assert found == pytest.approx(links_nm + rotor * motion.qdd_rad_s2 + friction_nm, abs=1e-6)


def test_friction_in_the_monitor_model_is_left_to_it(small_cell, workspace, motion, links_nm):
    arm = small_cell.cell.arm[0]
    typed = axis_constants(arm, None)
    result = replace(
        typed[1],
        rotor_kg_m2=Known(9.0, "r.json", identified=True),
        coulomb_nm=Known(50.0, "r.json", identified=True),
        viscous_nm_s_rad=Known(20.0, "r.json", identified=True),
    )
    found = free_torque_nm(workspace, arm, motion, (typed[0], result, *typed[2:]))
    assert found is not None
    assert found[:, 1] == pytest.approx(links_nm[:, 1] + 9.0 * motion.qdd_rad_s2[:, 1], abs=1e-6)
    assert found[:, 0] == pytest.approx(free_torque_nm(workspace, arm, motion)[:, 0])
