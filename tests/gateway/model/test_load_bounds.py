"""Loads held against what an arm can carry: slips of units are refused with the likely unit, real loads are not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gateway.cell.config import load_cell, parse_cell
from gateway.errors import ConfigError
from gateway.model.arm_model import arm_robot
from gateway.model.load_bounds import NO_ARM, bounds_of, load_bounds
from gateway.model.robot import robot_from_urdf

EXAMPLES = Path(__file__).parents[3] / "examples"


def cell_of(text, name="small"):
    """The example cell with another text, read as its commands do."""
    loaded = load_cell(EXAMPLES / name / "cell.toml")
    return loaded.model_copy(update={"cell": parse_cell(text, "cell.toml"), "text": text})


def small(old="", new=""):
    text = (EXAMPLES / "small" / "cell.toml").read_text(encoding="utf-8")
    assert old in text
    return cell_of(text.replace(old, new))


def bounds(**changes):
    loaded = small()
    arm = loaded.cell.arm[0].model_copy(update=changes)
    return load_bounds(arm_robot(loaded, arm), arm)


@pytest.mark.parametrize(
    ("mass_kg", "com_m", "says"),
    [
        (5000.0, (0.0, 0.0, 0.09), "grams? that is 5 kg"),
        (51.0, (0.0, 0.0, 0.09), "5 x rated_load_kg of 10 kg"),
        (5.0, (0.0, 0.0, 4.0), "millimetres? that is 0.004 m"),
        (5.0, (110.0, 0.0, 0.0), "millimetres? that is 0.11 m"),
    ],
)
def test_a_load_in_another_unit_is_refused_with_the_likely_one(mass_kg, com_m, says):
    assert says in bounds().violation(mass_kg, com_m)


def test_a_load_that_an_arm_can_hold_is_not():
    assert bounds().violation(49.0, (0.3, 0.2, 0.3)) == ""
    assert bounds().violation(math.nan, ()) == ""
    assert bounds().violation(math.nan, (math.nan,) * 3) == ""


def test_a_violation_has_to_be_significant():
    assert bounds().violation(60.0, (0.0, 0.0, 0.1), 15.0) == ""
    assert bounds().violation(60.0, (0.0, 0.0, 0.1), 5.0)
    assert bounds().violation(0.1, (4.0, 0.0, 0.0), 0.05, (3.9, 1.0, 1.0)) == ""


def test_without_a_rating_mass_and_torque_of_the_arm_count():
    loaded = small()
    robot = arm_robot(loaded, loaded.cell.arm[0])
    unrated = bounds(rated_load_kg=None)
    assert unrated.mass_kg <= robot.mass_kg.sum()
    reach = sum(np.linalg.norm(robot.placement[joint, :3, 3]) for joint in range(1, 6))
    weak = bounds_of(robot, 20.0, None, trusts_masses=False)
    assert weak.mass_kg == pytest.approx(5 * 20.0 / (9.80665 * reach))
    assert bounds_of(robot, trusts_masses=False).mass_kg == NO_ARM.mass_kg


def test_masses_that_exporters_left_out_refuse_no_rated_load():
    text = (EXAMPLES / "small" / "robot.urdf").read_text(encoding="utf-8")
    light = robot_from_urdf(text, "robot.urdf")
    light = type(light)(
        **{name: getattr(light, name) for name in light.__slots__} | {"mass_kg": np.linspace(0.01, 0.012, 6)}
    )
    arm = small().cell.arm[0]
    assert load_bounds(light, arm).violation(10.0, ()) == ""
    assert load_bounds(light, arm.model_copy(update={"rated_load_kg": None})).violation(10.0, ())


def robot_of(old, new):
    loaded = small(old, new)
    return arm_robot(loaded, loaded.cell.arm[0])


RATED = 'rated_load_kg = { value = 10, source = "datasheet p. 1" }'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (RATED, "max_load_kg = 10000", r"max_load_kg: 10000 kg .*grams\? write .* = 10"),
        (RATED, 'rated_load_kg = { value = 10000, source = "datasheet" }', r"rated_load_kg.value: 10000 kg .*grams"),
        (RATED, f"{RATED}\nmax_load_kg = 60", r"max_load_kg: 60 kg is beyond 50 kg \(5 x rated_load_kg of 10 kg\)"),
        (RATED, "max_load_kg = 900", r"max_load_kg: 900 kg is beyond .* grams"),
        (RATED, 'rated_load_kg = { value = 900, source = "datasheet" }', r"rated_load_kg: 900 kg is beyond .* grams"),
    ],
)
def test_a_cell_that_states_such_a_load_is_refused(old, new, says):
    with pytest.raises(ConfigError, match=says):
        robot_of(old, new)


def test_a_torque_that_no_joint_has_is_refused():
    text = (EXAMPLES / "small" / "cell.toml").read_text(encoding="utf-8")
    first = next(line for line in text.splitlines() if line.startswith("torque_limit_nm"))
    with pytest.raises(ConfigError, match=r"torque_limit_nm: 500000 Nm .* mNm\? write torque_limit_nm = 500"):
        parse_cell(text.replace(first, "torque_limit_nm = 500000", 1), "cell.toml")


@pytest.mark.parametrize("name", ["large", "small", "pair"])
def test_the_examples_pass(name):
    loaded = load_cell(EXAMPLES / name / "cell.toml")
    for arm in loaded.cell.arm:
        assert arm_robot(loaded, arm).axes == 6
