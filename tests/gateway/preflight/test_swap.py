"""Exchanged drives, detected from what each stores of its own axis; readings from the cell's numbers."""

import math
from itertools import combinations

import pytest

from drives.objects import OBJECTS
from drives.profile_file import load_profile
from drives.values import Identity
from gateway.cell.config import ArmConfig
from gateway.preflight.rules import Axis
from gateway.preflight.swap import SeenDrive, judge_places
from tests.data.axes import axis_table

COUNTS = 65536
GENERIC = load_profile("generic-cia402")
#: Of an axis: gear ratio, position sign, zero offset [rad], range [rad], torque limit [Nm].
AXES = (
    (120, 1, 0.0, (-2.8, 2.8), 420.0),
    (120, -1, 0.02, (-1.5, 1.8), 420.0),
    (100, 1, 0.0, (-1.3, 1.8), 220.0),
    (80, -1, 0.0, (-3.1, 3.1), 70.0),
    (80, 1, -0.015, (-1.9, 1.9), 60.0),
    (50, 1, 0.0, (-5.6, 5.6), 36.0),
)


def arm():
    axes = [
        axis_table(10 + joint, ratio, position_sign=sign, zero_offset_rad=zero)
        | {"position_limit_rad": list(limits), "torque_limit_nm": torque}
        for joint, (ratio, sign, zero, limits, torque) in enumerate(AXES, start=1)
    ]
    return ArmConfig.model_validate({"name": "main", "bus": "a", "robot": "r.urdf", "axis": axes})


def made_for(joint, margin_rad=0.05, **changes):
    """What a drive holds that was set up for a joint: range with a margin, 1.2 times the cell's torque."""
    ratio, sign, zero, limits, torque = AXES[joint - 1]
    ends = [
        sign * ratio * (q - zero) / (2 * math.pi) * COUNTS for q in (limits[0] - margin_rad, limits[1] + margin_rad)
    ]
    values = {
        "encoder_increments": COUNTS,
        "encoder_revolutions": 1,
        "position_limit_min": round(min(ends)),
        "position_limit_max": round(max(ends)),
        "max_torque": 3000,
        "rated_torque": round(1000 * 1.2 * torque / ratio / 3),
        "gear_motor_revolutions": 1,
        "gear_shaft_revolutions": 1,
    }
    return {OBJECTS[name].address: value for name, value in (values | changes).items()}


def identity(vendor_id=2, product_code=7):
    return Identity(1, 0x00020192, vendor_id, product_code, 0x10000, 5, "drive", "1", "2.3")


def seen(readings, profiles=None, identities=None):
    axes = arm().axis
    return [
        SeenDrive(Axis(joint, axes[joint - 1], (profiles or {}).get(joint, GENERIC)), who, values)
        for joint, (values, who) in enumerate(
            zip(readings, identities or [identity()] * len(readings), strict=True), start=1
        )
    ]


def in_order(order, **changes):
    """Readings of drives that were made for these joints, addressed as joints 1 to 6."""
    return [made_for(joint, **changes) for joint in order]


def exchanged(first, second):
    order = [1, 2, 3, 4, 5, 6]
    order[first - 1], order[second - 1] = second, first
    return order


@pytest.mark.parametrize("margin_rad", [0.0, 0.05, 0.15])
@pytest.mark.parametrize(("first", "second"), list(combinations(range(1, 7), 2)))
def test_two_drives_in_each_others_place_are_named_and_no_others(first, second, margin_rad):
    (item,) = judge_places(arm(), seen(in_order(exchanged(first, second), margin_rad=margin_rad)))
    assert item.severity == "fail"
    assert item.where == f"J{first} node {10 + first}"
    assert f"the drives of J{first} and J{second} look swapped (node ids or motor cables)" in item.what
    assert "software limits" in item.what
    assert f"node ids {10 + first} and {10 + second}" in item.advice


def test_two_pairs_at_once():
    items = judge_places(arm(), seen(in_order([2, 1, 3, 6, 5, 4])))
    assert [item.where for item in items] == ["J1 node 11", "J4 node 14"]


@pytest.mark.parametrize("margin_rad", [0.0, 0.05, 1.0])
def test_drives_in_their_own_place_are_not_named(margin_rad):
    assert judge_places(arm(), seen(in_order(range(1, 7), margin_rad=margin_rad))) == []


@pytest.mark.parametrize("joint", range(1, 7))
@pytest.mark.parametrize("like", range(1, 7))
def test_one_drive_alone_with_the_limits_of_another_axis_is_no_swap(joint, like):
    readings = in_order(range(1, 7))
    readings[joint - 1] = made_for(like)
    assert judge_places(arm(), seen(readings)) == []


@pytest.mark.parametrize("end", ["position_limit_min", "position_limit_max"])
@pytest.mark.parametrize("factor", [0.0, 0.5, 0.9, 2.0])
def test_one_limit_off_alone_is_no_swap(end, factor):
    for joint in range(1, 7):
        readings = in_order(range(1, 7))
        address = OBJECTS[end].address
        readings[joint - 1] = readings[joint - 1] | {address: round(factor * readings[joint - 1][address])}
        assert judge_places(arm(), seen(readings)) == []


def test_three_drives_in_a_ring_are_no_pair():
    assert judge_places(arm(), seen(in_order([2, 3, 1, 4, 5, 6]))) == []


def test_limits_that_look_swapped_against_torques_that_do_not_are_left_to_their_own_rules():
    readings = in_order(range(1, 7))
    for one, other in ((1, 6), (6, 1)):
        strange = made_for(other)
        ends = [OBJECTS[name].address for name in ("position_limit_min", "position_limit_max")]
        readings[one - 1] = readings[one - 1] | {end: strange[end] for end in ends}
    assert judge_places(arm(), seen(readings)) == []


def test_without_software_limits_the_torque_limits_warn():
    readings = [values | made_none() for values in in_order(exchanged(2, 5))]
    (item,) = judge_places(arm(), seen(readings))
    assert item.severity == "warn"
    assert "J2 and J5 look swapped" in item.what
    assert "torque limit" in item.what
    assert "--move" in item.advice


def made_none():
    return {OBJECTS[name].address: 0 for name in ("position_limit_min", "position_limit_max")}


@pytest.mark.parametrize("factor", [0.3, 0.5, 2.0, 5.0])
def test_one_rated_torque_off_alone_is_no_swap(factor):
    address = OBJECTS["rated_torque"].address
    for joint in range(1, 7):
        readings = [values | made_none() for values in in_order(range(1, 7))]
        readings[joint - 1][address] = round(factor * readings[joint - 1][address])
        assert judge_places(arm(), seen(readings)) == []


def test_models_in_each_others_place():
    profiles = {2: load_profile("kollmorgen-akd-x00606"), 3: load_profile("elmo-gold")}
    makers = {2: identity(0x6A, 7), 3: identity(0x9A, 7)}
    right = [makers.get(joint, identity(9)) for joint in range(1, 7)]
    plain = [values | made_none() for values in in_order(range(1, 7), rated_torque=None)]
    assert judge_places(arm(), seen(plain, profiles, right)) == []
    wrong = [right[0], right[2], right[1], *right[3:]]
    (item,) = judge_places(arm(), seen(plain, profiles, wrong))
    assert "J2 and J3 look swapped" in item.what
    assert item.what.endswith("by its model")
    alone = [right[0], identity(9), *right[2:]]
    assert judge_places(arm(), seen(plain, profiles, alone)) == []


def test_gears_of_their_own_in_each_others_place():
    readings = [values | made_none() for values in in_order(range(1, 7), rated_torque=None)]
    address = OBJECTS["gear_motor_revolutions"].address
    for joint, ratio in ((1, 100), (3, 120)):
        readings[joint - 1][address] = ratio
    (item,) = judge_places(arm(), seen(readings))
    assert "J1 and J3 look swapped" in item.what
    readings[0][address] = 1
    assert judge_places(arm(), seen(readings)) == []
