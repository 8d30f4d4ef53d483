"""Observed fields of a SYNC: all of the requested arm, NaN where a drive did not respond."""

import numpy as np

from drives.values import DriveReading
from gateway.data.blackbox import part
from gateway.live.wire import SHOWN
from gateway.motion.observer import FIELDS, Observed, fill
from tests.data.observed import observed


def test_every_word_is_at_its_place():
    one = observed(1, np.zeros(6))
    readings = tuple(
        DriveReading(axis + 1, 1, 0x1230 + axis, 100 + axis, 200 + axis, None, None, 0.0, 0.0, None, 0.5 * axis)
        for axis in range(6)
    )
    sample = type(one.samples[0])(1, 0.01, np.arange(6.0), 10.0 + np.arange(6.0), readings)
    seen = Observed((sample,), (20.0 + np.arange(6.0),), (30.0 + np.arange(6.0),))
    row = np.full(1 + 6 * len(FIELDS) + 1, -1.0)
    assert fill(row, 1, seen, 0, tuple(FIELDS)) == len(row) - 1
    starts = dict(zip(FIELDS, row[1:-1].reshape(-1, 6).tolist(), strict=True))
    assert (row[0], row[-1]) == (-1.0, -1.0)
    assert starts["q_rad"] == [0, 1, 2, 3, 4, 5]
    assert starts["joint_torque_nm"][0] == 10.0
    assert starts["target_rad"][0] == 20.0
    assert starts["modelled_torque_nm"][0] == 30.0
    assert starts["statusword"] == [0x1230 + axis for axis in range(6)]
    assert starts["position_count"][5] == 105
    assert starts["torque_permille"][5] == 205
    assert starts["motor_current_a"][3] == 1.5


def test_the_arm_that_is_asked_for_and_nan_where_a_drive_did_not_respond():
    first, second = observed(1, np.zeros(6)), observed(1, np.ones(6), unresponsive=2)
    both = Observed(
        (*first.samples, *second.samples),
        (*first.targets_rad, *second.targets_rad),
        (*first.modelled_nm, *second.modelled_nm),
    )
    row = np.zeros(12)
    assert fill(row, 0, both, 1, ("q_rad", "statusword")) == 12
    assert np.array_equal(np.isnan(row), [axis % 6 == 2 for axis in range(12)])
    assert row[0] == 1.0


def test_what_page_and_black_box_hold_is_of_these():
    assert set(SHOWN) <= set(FIELDS)
    assert [name for name, _ in part.FIELDS] == list(FIELDS)
