"""Joint torques that an arm's own motion does not need: instants of the SYNCs, holes, standing, turning round."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.data.visit import ArmSample
from gateway.pair.joint_targets import ExternalTorque, JointFollower
from gateway.pair.pair_cell import load_pair

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "pair" / "cell.toml"
DT_S, LAG_S, ROWS = 0.004, 0.016, 120
SPEED_RAD_S = np.array([0.2, -0.1, 0.15, 0.2, -0.2, 0.3])


@pytest.fixture(scope="module")
def arm():
    return load_pair(EXAMPLE).arms[0]


@pytest.fixture
def external(arm):
    time_s = DT_S * np.arange(ROWS)[:, None]
    return ExternalTorque(arm, JointFollower(arm, arm.start_rad + SPEED_RAD_S * time_s), DT_S, LAG_S)


def sample(arm, index: int, delay_s: float = 0.0, speed_rad_s=SPEED_RAD_S) -> ArmSample:
    """Sample of an arm in free, even motion at a delayed SYNC; it needs gravity and friction torque only."""
    at_s = index * DT_S + delay_s
    q = arm.start_rad + speed_rad_s * (at_s - LAG_S - DT_S)
    still = np.zeros((1, 6))
    rubbing = arm.coulomb_nm * np.sign(speed_rad_s) + arm.viscous_nm_s_rad * speed_rad_s
    torque = arm.model_torque(q[None], speed_rad_s[None], still)[0] + rubbing
    return ArmSample(index, at_s, q, torque, (object(),) * 6)  # type: ignore[arg-type]


def test_delayed_syncs_cause_no_torque_error(arm, external):
    """With the period in place of the instants an acceleration of 10 rad/s2 would be seen, some 500 Nm."""
    delay_s = np.random.default_rng(7).uniform(0.0, 0.0004, ROWS)
    seen = [external.update(index, sample(arm, index, delay_s[index])) for index in range(10, ROWS)]
    assert seen[:2] == [None, None]
    assert max(np.abs(each.external_nm).max() for each in seen[2:]) < 1.0
    assert seen[-1].speed_rad_s == pytest.approx(SPEED_RAD_S)
    assert seen[-1].acceleration_rad_s2 == pytest.approx(np.zeros(6), abs=1e-6)


def test_syncs_that_follow_too_soon_give_no_rate(arm, external):
    for index in range(10, 20):
        assert (external.update(index, sample(arm, index)) is None) == (index < 12)
    assert external.update(20, sample(arm, 20, 0.0039)) is not None
    assert external.update(21, sample(arm, 21)) is None


def test_a_sample_that_is_not_whole_takes_its_neighbours_with_it(arm, external):
    for index in range(10, 20):
        external.update(index, sample(arm, index))
    holed = sample(arm, 20)
    external.update(20, ArmSample(20, holed.time_s, holed.q_rad, holed.joint_torque_nm, (None, *holed.readings[1:])))
    assert [external.update(index, sample(arm, index)) is None for index in (21, 22, 23)] == [True, True, False]


def test_an_arm_at_rest_needs_gravity_torque_alone_with_friction_of_either_sign(arm, external):
    still = np.zeros(6)
    for index in range(60, 64):
        seen = external.update(index, sample(arm, 60, (index - 60) * DT_S, still), 0.0)
    q = np.stack([external.q_rad[62], arm.start_rad])
    there, here = arm.model_torque(q, q * 0.0, q * 0.0)
    row = there - here
    assert seen.turned == pytest.approx(still)
    assert seen.external_nm == pytest.approx(-row, abs=1e-6)


def test_friction_of_a_joint_that_slows_down_keeps_its_sign_until_it_reverses(arm, external):
    for index in range(10, 40):
        external.update(index, sample(arm, index))
    slow = 0.01 * SPEED_RAD_S
    begin = sample(arm, 39).q_rad
    for index in range(40, 44):
        plain = sample(arm, index)
        after = ArmSample(
            index, plain.time_s, begin + slow * (index - 39) * DT_S, plain.joint_torque_nm, plain.readings
        )
        seen = external.update(index, after)
    assert seen.turned == pytest.approx(np.sign(SPEED_RAD_S), abs=1e-3)
