"""Wirings determined from small moves; torques are pinocchio's, behind gears with friction, as drives report them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

from gateway.cell.config import load_cell
from gateway.cell.conversion import AxisConversion
from gateway.check.moves import wiring_items
from gateway.check.wiring import Moves, Verdict, judge_wiring
from gateway.model.arm_model import arm_robot

LOADED = load_cell(Path(__file__).parents[3] / "examples" / "small" / "cell.toml")
CONFIG = LOADED.cell.arm[0]
AXES = AxisConversion.from_arm(CONFIG)
LIMIT = np.array([axis.torque_limit_nm for axis in CONFIG.axis])
GRAVITY = np.array(CONFIG.gravity_m_s2)
ROBOT = arm_robot(LOADED, CONFIG)
PIN = pinocchio.buildModelFromUrdf(str(LOADED.path(CONFIG.robot)))
FRICTION_NM = 0.008 * LIMIT
START = np.array([0.2, 0.5, 0.2, 0.6, 0.7, 0.3])


def moves(axes: AxisConversion = AXES, order=None, seed=1) -> Moves:
    """Motor words of the arm at rest there, wired as `axes` and `order` say."""
    data, rng = PIN.createData(), np.random.default_rng(seed)
    asked = [START, *(START + step * np.eye(6)[joint] for joint, step in enumerate((0.15, 0.15, 0.15, 0.3, 0.3, 0.3)))]
    order = np.arange(6) if order is None else np.array(order)
    position, torque = [], []
    for stated in asked:
        motor = AXES.motor_position(stated)
        q = axes.joint_position(motor[order])
        gravity = pinocchio.computeGeneralizedGravity(PIN, data, q)
        sides = []
        for sense in (-1.0, 1.0):
            turn = np.sign(axes.joint_velocity(AXES.motor_velocity(np.full(6, sense))[order]))
            friction = FRICTION_NM * (1.0 + 0.05 * rng.standard_normal(6))
            output = gravity + turn * friction
            motor_side = output / axes.efficiency ** np.sign(output * turn)
            at_node = np.empty(6)
            at_node[order] = axes.motor_torque(motor_side)
            sides.append(at_node)
        position.append([motor, motor])
        torque.append(sides)
    return Moves(np.array(position), np.array(torque))


def changed(**fields) -> AxisConversion:
    from dataclasses import replace

    values = {name: getattr(AXES, name).copy() for name in fields}
    for name, factors in fields.items():
        for joint, factor in factors.items():
            values[name][joint - 1] *= factor
    return replace(AXES, **values)


def judged(found: Moves) -> Verdict:
    known = {"gravity_m_s2": GRAVITY, "torque_limit_nm": LIMIT, "link_std": 0.05, "load_kg": 5.0}
    return judge_wiring(found, ROBOT, AXES, **known)


def named(found) -> list[tuple[str, tuple[int, ...]]]:
    return [(wiring.name, wiring.joints) for wiring in judged(found).found]


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_wrong():
    verdict = judged(moves())
    assert verdict.found == ()
    for joint in (2, 3):
        view = verdict.axes[joint - 1]
        assert view.sign_seen
        assert view.ratio_seen
        assert view.swaps_unseen == ()
        assert abs(view.ratio - 1.0) < 3.0 * view.ratio_std
    assert not verdict.axes[0].sign_seen
    assert [item.severity for item in wiring_items("main", range(1, 7), verdict)][1:3] == ["ok", "ok"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wired", "order", "expected"),
    [
        ({"position_sign": {2: -1}, "torque_sign": {2: -1}}, None, ("reversed", (2,))),
        ({"torque_sign": {3: -1}}, None, ("torque_reversed", (3,))),
        ({"position_sign": {3: -1}}, None, ("position_reversed", (3,))),
        ({}, (0, 2, 1, 3, 4, 5), ("swapped", (2, 3))),
    ],
)
def test_one_mistake_is_named(wired, order, expected):
    assert named(moves(changed(**wired), order)) == [expected]


@pytest.mark.slow
def test_a_gear_ratio_is_named_with_its_factor():
    verdict = judged(moves(changed(ratio={2: 2.0})))
    (wiring,) = verdict.found
    assert (wiring.name, wiring.joints) == ("gear_ratio", (2,))
    assert wiring.factor == pytest.approx(0.5, rel=0.1)


@pytest.mark.slow
def test_friction_alone_determines_the_sense_of_a_wrist_without_gravity():
    verdict = judged(moves(changed(torque_sign={6: -1})))
    (item,) = [item for item in wiring_items("main", range(1, 7), verdict) if item.severity == "fail"]
    assert item.where == "J6 node 6"
    assert "opposite signs" in item.what
