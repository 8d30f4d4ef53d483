"""Torque along a path as a function of the time law, against the law that the drives are fed with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drives.profile_file import load_profile
from gateway.cell.config import load_cell
from gateway.cost.timing import PathTorque, TimeLaw, line_path
from gateway.feedforward.load import assumed_load
from gateway.follow.settings import feed_model
from gateway.identify.stated_effects import stated_terms
from gateway.model.arm_model import arm_robot
from gateway.model.visits import Gears
from gateway.result.result import EffectResult, Result

EXAMPLE = Path(__file__).parents[3] / "examples" / "large" / "cell.toml"
START, END = np.array([0.2, -0.3, 0.4, 0.1, -0.5, 0.3]), np.array([-0.4, 0.5, -0.2, 0.6, 0.4, -0.6])
LAW = TimeLaw(np.array([0.1, 0.35, 0.6, 0.9]), np.array([0.4, 1.2, 1.5, 0.3]), np.array([3.0, 1.0, -2.5, -4.0]))
LOAD = assumed_load("a", 120.0, np.array([0.05, -0.02, 0.25]), "test")


@pytest.fixture(scope="module")
def model():
    loaded = load_cell(EXAMPLE)
    arm = loaded.cell.arm[0]
    result = Result(robot="qh165", friction_band_nm=(40.0, 60.0, 40.0, 15.0, 15.0, 8.0))
    return feed_model(arm, arm_robot(loaded, arm), [load_profile("generic-cia402")] * 6, result)


@pytest.mark.parametrize("coupled", [False, True])
def test_motor_torque_is_that_of_the_feedforward(model, coupled):
    if coupled:
        coupling = np.eye(6)
        coupling[4, 3], coupling[5, 4] = 0.2, -0.1
        axes = tuple(replace(axis, load_friction=0.05, onset_nm=20.0, stribeck_rad_s=0.1) for axis in model.axes)
        model = replace(model, coupling=coupling, axes=axes)
    moved = END - START
    found = PathTorque(line_path(START, END), model, LOAD).motor_nm(LAW)
    law = model.law(LOAD)
    sense = np.sign(model.coupling @ moved).tolist()
    for row, (s, speed, acceleration) in enumerate(zip(LAW.s, LAW.speed, LAW.acceleration, strict=True)):
        state = ((START + s * moved).tolist(), (speed * moved).tolist(), (acceleration * moved).tolist())
        motor = law.offsets(*state, sense)[1]
        expected = [torque * axis.ratio * axis.torque_sign for torque, axis in zip(motor, model.axes, strict=True)]
        # straight lines between 61 postures
        assert found[row] == pytest.approx(expected, rel=2e-3, abs=1.0)


def test_a_balancer_of_the_result_takes_its_torque_off_the_motor(model):
    """Closed form of a coil between base and link 2, from the stated numbers."""
    known = {"stiffness_n_m": 9e4, "free_length_m": 0.3, "phase_rad": 0.2, "lever_ratio": 0.6, "reach_m": 0.728}
    stated = stated_terms([EffectResult("balancer_spring", (2,), known)], Gears.of(None, 6), 6)
    path = line_path(START, END)
    # without losses the motor torque is the rigid one and friction
    axes = tuple(replace(axis, efficiency=1.0) for axis in model.axes)
    lossless = replace(model, axes=axes)
    pulled = PathTorque(path, lossless, LOAD, None, stated).motor_nm(LAW) - PathTorque(path, lossless, LOAD).motor_nm(
        LAW
    )
    angle = START[1] + LAW.s * (END - START)[1] - 0.2
    product = 0.6 * 0.728**2 / 2.0
    length = np.sqrt(0.728**2 - 2.0 * product * np.cos(angle))
    expected = 9e4 * (length - 0.3) * product * np.sin(angle) / length
    assert pulled[:, 1] == pytest.approx(expected, rel=2e-3, abs=1.0)
    assert np.abs(np.delete(pulled, 1, axis=1)).max() == 0.0


def test_acceleration_of_the_load_is_that_of_its_centre_along_the_path(model):
    """Second difference of the centre's place along the motion, over the limit."""
    from gateway.model.kinematics import link_frames

    limit, step = 4.0, 1e-4

    def centre(t: float) -> np.ndarray:
        s = 0.5 + 0.8 * t + 0.5 * 1.5 * t**2
        last = link_frames(model.robot, (START + s * (END - START))[None])[0, -1]
        return last[:3, :3] @ LOAD.com_m + last[:3, 3]

    expected = np.linalg.norm(centre(step) - 2 * centre(0.0) + centre(-step)) / step**2 / limit
    law = TimeLaw(np.array([0.5]), np.array([0.8]), np.array([1.5]))
    found = PathTorque(line_path(START, END), model, LOAD, limit).load_shares(law)
    assert found[0] == pytest.approx(expected, rel=1e-3)
