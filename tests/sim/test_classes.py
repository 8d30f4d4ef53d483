"""Arms of other makes hold still and follow: light wrists, axes in one line, links without mass, foundry and desk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

from sim.cellfile import read_cell
from sim.nominal import plant_of
from sim.physics import ArmWorld
from tests.data.arm_classes import CLASSES, ArmClass, urdf_of_class, write_class
from tests.support.rigs.worlds import moved

BUS = 'interface = "virtual"\nchannel = "x"\nsync_period_s = 0.01\npacing = "lockstep"'
#: Peak to peak at rest; following error at 0.4 rad/s, of which the position loop takes 13 mrad.
HUNTING_RAD, LAG_RAD = 5e-5, 0.025


@pytest.mark.parametrize("kind", CLASSES.values(), ids=CLASSES.keys())
def test_every_class_follows_holds_still_and_carries_its_weight(kind: ArmClass, tmp_path: Path):
    (arm,) = read_cell(write_class(kind, tmp_path, BUS)).arms
    world = ArmWorld(arm, plant_of(arm), 1)
    try:
        for axis in world.axes:
            axis.release()
        q = np.array([0.5, 0.7, -0.6, 0.8, 0.4, -0.7, 0.3])[: len(kind.axes)]
        assert (moved(world, q, 4.0) < LAG_RAD).all()
        world.advance(1500)
        seen = []
        for _ in range(30):
            world.advance(10)
            seen.append([axis.position_rad for axis in world.axes])
        assert np.ptp(np.array(seen), axis=0).max() < HUNTING_RAD
        model = pinocchio.buildModelFromXML(urdf_of_class(kind))
        at_rest = np.zeros(len(q))
        expected = pinocchio.rnea(model, model.createData(), world.q_rad, at_rest, at_rest)
        np.testing.assert_allclose(world.joint_torque_nm(), expected, atol=1e-3 * np.abs(expected).max())
    finally:
        world.close()
