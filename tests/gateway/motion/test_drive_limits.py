"""Limits of the drives from those of the joints, with numbers computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drives.objects import OBJECTS
from drives.profile_file import load_profile
from gateway.cell.config import ArmConfig
from gateway.cell.conversion import AxisConversion
from gateway.motion.drive_limits import ROUNDING_RAD, motor_ranges_rad, motor_torques_nm, quick_stop_rad_s2
from tests.data.axes import axis_table

PROFILE = load_profile("generic-cia402")
#: Joints 5 and 6: the motor of 6 turns with joint 5 too.
COUPLED = [[float(row == column) for column in range(6)] for row in range(6)]
COUPLED[5][4] = 0.5


def arm(coupling=None, **changes):
    axes = [
        axis_table(joint, position_limit_rad=[-1.0, 2.0]) | (changes if joint == 2 else {}) for joint in range(1, 7)
    ]
    table = {"name": "main", "bus": "a", "robot": "r.urdf", "axis": axes}
    return ArmConfig.model_validate(table | ({} if coupling is None else {"coupling": coupling}))


def test_range_of_the_motor_behind_gear_sign_and_offset():
    turned = arm(position_sign=-1, zero_offset_rad=0.5, gear_ratio={"value": 50, "source": "p. 7"})
    found = motor_ranges_rad(turned)
    assert found[0] == pytest.approx((-100 - 100 * ROUNDING_RAD, 200 + 100 * ROUNDING_RAD))
    # p = -50 (q - 0.5): q = -1 is 75, q = 2 is -75
    assert found[1] == pytest.approx((-75 - 50 * ROUNDING_RAD, 75 + 50 * ROUNDING_RAD))
    assert len(found) == 6


def test_a_motor_that_turns_with_two_joints_has_no_range_of_its_own():
    found = motor_ranges_rad(arm(COUPLED))
    assert found[5] is None
    assert None not in found[:5]


def test_motor_torques_through_gear_and_coupling():
    # tau = A^T f: the torque of joint 5 is f5 + 0.5 f6, of joint 6 f6; so f6 = tau6 and f5 = tau5 - 0.5 tau6
    needed = np.array([100.0, 100.0, 100.0, 100.0, 80.0, 40.0])
    assert motor_torques_nm(AxisConversion.from_arm(arm()), needed) == pytest.approx((1, 1, 1, 1, 0.8, 0.4))
    assert motor_torques_nm(AxisConversion.from_arm(arm(COUPLED)), needed) == pytest.approx((1, 1, 1, 1, 1.0, 0.4))


def ramps(**changes):
    first = {"quick_stop_option": 2, "quick_stop_deceleration": 30_000, "profile_deceleration": 3_000}
    tables = [first | (changes if joint == 2 else {}) for joint in range(1, 7)]
    return [{OBJECTS[name].address: value for name, value in table.items()} for table in tables]


def test_deceleration_of_the_joints_by_the_ramps_as_they_are_set():
    # 30000 x 0.01 rpm per s is 300 rpm/s, 10 pi rad/s2 at the motor
    joint = 10 * math.pi / 100
    assert quick_stop_rad_s2(arm(), [PROFILE] * 6, ramps()) == pytest.approx([joint] * 6)
    slow = quick_stop_rad_s2(arm(), [PROFILE] * 6, ramps(quick_stop_option=1))
    assert slow == pytest.approx([joint, joint / 10, joint, joint, joint, joint])


@pytest.mark.parametrize("changes", [{"quick_stop_option": 3}, {"quick_stop_deceleration": None}])
def test_one_ramp_that_is_not_known_leaves_all_unknown(changes):
    assert quick_stop_rad_s2(arm(), [PROFILE] * 6, ramps(**changes)) is None


def test_a_ramp_in_an_unknown_unit_is_not_known():
    profiles = [*[PROFILE] * 5, load_profile("elmo-gold")]
    assert quick_stop_rad_s2(arm(), profiles, ramps()) is None
