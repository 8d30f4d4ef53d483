"""Wrench from torque: what the instants of the SYNCs do to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.data.sample import ArmSample
from gateway.pair.cell import load_pair
from gateway.pair.follow import JointFollower, WrenchFromTorque

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "pair" / "cell.toml"
DT_S, LAG_S, ROWS = 0.004, 0.016, 120
SPEED_RAD_S = np.array([0.2, -0.1, 0.15, 0.2, -0.2, 0.3])


@pytest.fixture(scope="module")
def arm():
    return load_pair(EXAMPLE).arms[0]


@pytest.fixture
def wrench(arm):
    time_s = DT_S * np.arange(ROWS)[:, None]
    follower = JointFollower(arm, arm.start_rad + SPEED_RAD_S * time_s)
    return WrenchFromTorque(arm, follower, DT_S, LAG_S, 15.0)


def sample(arm, index: int, late_s: float) -> ArmSample:
    """Of an arm that moves evenly and freely, at a SYNC that comes late; gravity and friction are all it needs."""
    at_s = index * DT_S + late_s
    q = arm.start_rad + SPEED_RAD_S * (at_s - LAG_S - DT_S)
    still = np.zeros((1, 6))
    rubbing = arm.coulomb_nm * np.sign(SPEED_RAD_S) + arm.viscous_nm_s_rad * SPEED_RAD_S
    torque = arm.model_torque(q[None], SPEED_RAD_S[None], still)[0] + rubbing
    return ArmSample(index, at_s, q, torque, (object(),) * 6)  # type: ignore[arg-type]


def test_late_syncs_feign_no_force(arm, wrench):
    """With the period in place of the instants it is 170 N."""
    late_s = np.random.default_rng(7).uniform(0.0, 0.0004, ROWS)
    sizes = []
    for index in range(10, ROWS):
        wrench.update(index, sample(arm, index, late_s[index]))
        if wrench.wrench is not None:
            sizes.append(np.linalg.norm(wrench.wrench[:3]))
    assert max(sizes) < 2.0


def test_syncs_that_follow_too_soon_tell_nothing(arm, wrench):
    for index in range(10, 20):
        wrench.update(index, sample(arm, index, 0.0))
    before = wrench.wrench.copy()
    wrench.update(20, sample(arm, 20, 0.0039))
    assert not np.array_equal(wrench.wrench, before)
    before = wrench.wrench.copy()
    pushed = sample(arm, 21, 0.0)
    pushed.joint_torque_nm[:] += 1000.0
    wrench.update(21, pushed)
    assert np.array_equal(wrench.wrench, before)
    assert wrench.external_nm is None


def test_a_way_that_begins_to_slow_down_is_expected_to_need_what_it_needed_before(wrench):
    """At a rate a hair below the full one torque and friction's band are those of the full rate."""
    full, slowed = wrench._expected(60, 1.0, SPEED_RAD_S), wrench._expected(60, 1.0 - 1e-9, SPEED_RAD_S)
    assert slowed[0] == pytest.approx(full[0], rel=1e-6, abs=1e-6)
    assert slowed[1] == pytest.approx(full[1], abs=1e-6)


def test_an_arm_that_has_come_to_rest_on_the_way_needs_its_weight_alone_and_may_rub_either_way(arm, wrench):
    known, band = wrench._expected(60, 0.0, np.zeros(6))
    q = arm.start_rad + SPEED_RAD_S * (60 * DT_S - LAG_S - DT_S)
    still = np.zeros((1, 6))
    assert known == pytest.approx(arm.model_torque(q[None], still, still)[0], abs=1e-6)
    assert band == pytest.approx(arm.coulomb_nm)
