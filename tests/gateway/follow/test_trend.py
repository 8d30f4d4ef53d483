"""The trend on torque that was made up here: pinocchio's inverse dynamics, gears and friction by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

from drives.profile_file import load_profile
from gateway.cell.config import load_cell
from gateway.feedforward.load import assumed_load
from gateway.follow.settings import feed_model
from gateway.follow.track import Track
from gateway.follow.trend import load_trend
from gateway.model.arm_model import arm_robot
from gateway.result.result import Result

LARGE = Path(__file__).parents[3] / "examples" / "large"
PERIOD_S = 0.01
MASS, COM = 70.0, np.array([0.05, -0.02, 0.22])
COULOMB, VISCOUS = np.array([80.0, 100.0, 60.0, 20.0, 15.0, 10.0]), 30.0


@pytest.fixture(scope="module")
def model():
    loaded = load_cell(LARGE / "cell.toml")
    arm = loaded.cell.arm[0]
    return feed_model(arm, arm_robot(loaded, arm), [load_profile("generic-cia402")] * 6, Result(robot="qh165"))


@pytest.fixture(scope="module")
def motion():
    time_s = PERIOD_S * np.arange(1200)
    rates = np.array([0.6, 0.9, 0.7, 1.1, 0.8, 1.3])
    size = np.array([0.4, 0.4, 0.4, 0.6, 0.6, 0.7])
    q = size * np.sin(rates * time_s[:, None]) + np.array([0.0, 0.2, 0.1, 0.3, 0.4, 0.2])
    return q, size * rates * np.cos(rates * time_s[:, None]), -size * rates**2 * np.sin(rates * time_s[:, None])


@pytest.fixture(scope="module")
def measured(model, motion):
    """Motor torque (n, 6) that arm and load really take."""
    robot = pinocchio.buildModelFromXML((LARGE / "robot.urdf").read_text())
    last = robot.getJointId("joint_6")
    inertia = assumed_load("x", MASS, COM, "").inertia_kg_m2
    robot.appendBodyToJoint(last, pinocchio.Inertia(MASS, COM, inertia), pinocchio.SE3.Identity())
    robot.gravity.linear = np.array([0.0, 0.0, -9.80665])
    data = robot.createData()
    torque = np.array([pinocchio.rnea(robot, data, *row) for row in zip(*motion, strict=True)])
    _, rate, gain = motion
    output = torque + COULOMB * np.sign(rate) + VISCOUS * rate
    efficiency = np.array([axis.efficiency for axis in model.axes])
    rotor = np.array([axis.rotor_kg_m2 for axis in model.axes])
    ratio = np.array([axis.ratio for axis in model.axes])
    motor = np.where(output * rate > 0, output / efficiency, output * efficiency) + rotor * gain
    return (motor + 5.0 * np.random.default_rng(0).normal(size=motor.shape)) / ratio


def track(motion, torque):
    q = motion[0]
    nothing = np.zeros_like(q)
    return Track("identified", PERIOD_S, q, q, torque, nothing, nothing, np.zeros(len(q)))


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_the_trend_is_what_the_load_was_entered_wrong_by(model, motion, measured, factor):
    fed = assumed_load("a", MASS, COM, "test").scaled(factor)
    trend = load_trend(track(motion, measured), model, fed)
    assert trend.values.scale == pytest.approx(1 / factor - 1, abs=max(0.02, 3 * trend.values.scale_std))
    assert trend.values.scale_std < 0.02
    assert trend.values.mass_kg == pytest.approx(MASS, abs=max(2.0, 3 * trend.values.mass_std_kg))
    assert trend.values.com_m[:2] == pytest.approx(COM[:2], abs=0.01)


def test_a_shifted_centre_of_gravity_is_distinguished_from_a_wrong_mass(model, motion, measured):
    fed = assumed_load("a", MASS, COM + np.array([0.06, 0.0, 0.0]), "test")
    trend = load_trend(track(motion, measured), model, fed)
    assert trend.values.com_m[0] == pytest.approx(COM[0], abs=0.01)
    assert trend.values.mass_kg == pytest.approx(MASS, abs=max(2.0, 3 * trend.values.mass_std_kg))


def test_a_path_that_barely_moves_determines_nothing(model, motion, measured):
    still = tuple(part[:150] for part in motion)
    q = np.repeat(still[0][:1], 150, axis=0)
    assert load_trend(track((q, still[1], still[2]), measured[:150]), model, assumed_load("a", MASS, COM, "")) is None


def test_axes_that_do_not_move_leave_directions_open(model, motion, measured):
    """Axis 1 alone under vertical gravity gives no information on the load."""
    q = motion[0].copy()
    q[:, 1:] = q[0, 1:]
    fed = assumed_load("a", MASS, COM, "")
    trend = load_trend(track((q, *motion[1:]), np.tile(measured[:1], (len(q), 1))), model, fed)
    assert trend is None or not np.isfinite(trend.values.mass_kg) or trend.values.mass_std_kg > 10.0
