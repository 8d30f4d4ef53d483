"""A workpiece as the difference of two loads of one fit: values, joint covariance, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.diagnose import diagnose
from gateway.errors import ConfigError, InputError
from gateway.estimate import estimate, run
from gateway.identify.knowledge import Knowledge, WeighedLoad
from tests.gateway.estimate.conftest import value_of
from tests.gateway.estimate.test_moving import moving_table

GRIPPER, PART = np.array([6.0, 0.02, -0.01, 0.08]), np.array([4.0, 0.1, 0.03, 0.2])
BOTH = np.append(10.0, (6.0 * GRIPPER[1:] + 4.0 * PART[1:]) / 10.0)
STATED = Knowledge(link_std=0.05, gain_std=(0.03,) * 6, parts={"part": ("both", "gripper")})


def part_of(loads):
    return next(load for load in loads if load.label == "part")


@pytest.fixture(scope="module")
def table(arm, poses, measured):
    return measured(arm, poses, {"none": None, "gripper": GRIPPER, "both": BOTH}, np.random.default_rng(3), 0.02)


@pytest.mark.parametrize("statement", ["estimated", "exact", "weighed"])
def test_the_part_is_the_difference_of_the_first_moments(arm, table, statement):
    known = {
        "estimated": {},
        "exact": {"known": {"gripper": tuple(GRIPPER)}},
        "weighed": {"weighed": {"gripper": WeighedLoad(6.0, 0.02, tuple(GRIPPER[1:]), 0.001)}},
    }[statement]
    loads = estimate(table, arm.robot, replace(STATED, **known)).loads
    value, std = value_of(part_of(loads))
    assert np.all(np.abs(value - PART) < 3.5 * std), (value, std)
    assert np.all(std < [0.4, 0.02, 0.02, 0.02])
    assert sum(part_of(loads).budget.values()) == pytest.approx(1.0)


def test_errors_that_both_loads_share_cancel(arm, table):
    loads = {load.label: load for load in estimate(table, arm.robot, STATED).loads}
    apart = np.hypot(loads["both"].mass_std_kg, loads["gripper"].mass_std_kg)
    assert loads["part"].mass_std_kg < 0.8 * apart
    assert np.abs(loads["part"].common_errors["links"][0]).max() > 0.0


@pytest.mark.slow
def test_diagnose_gives_the_part_too(arm, table):
    assert part_of(diagnose(table, arm.robot, STATED).loads).mass_kg == pytest.approx(4.0, abs=0.3)


def test_inertia_is_about_the_centre_of_the_part(arm, table_of):
    own = np.diag([0.05, 0.08, 0.06])
    centre = BOTH[1:]

    def about_both(body, inertia):
        away = body[1:] - centre
        return inertia + body[0] * (away @ away * np.eye(3) - np.outer(away, away))

    loads = {"none": (None, np.zeros((3, 3))), "gripper": (GRIPPER, own)}
    loads["both"] = (BOTH, about_both(GRIPPER, own) + about_both(PART, 2.0 * own))
    tables = [
        moving_table(arm, table_of, label, load, seed, 0.02, inertia)
        for seed, (label, (load, inertia)) in enumerate(loads.items())
    ]
    part = part_of(estimate(concatenate(tables), arm.robot, replace(STATED, gain_std=(0.001,) * 6)).loads)
    assert part.mass_kg == pytest.approx(4.0, abs=4.0 * part.mass_std_kg)
    known = np.isfinite(part.inertia.value_kg_m2)
    away = (part.inertia.value_kg_m2 - [0.1, 0.16, 0.12, 0, 0, 0])[known]
    assert known.sum() >= 3
    assert np.all(np.abs(away) < 4.0 * part.inertia.std_kg_m2[known])


def test_a_light_part_has_no_centre_and_exchanged_labels_are_refused(arm, table, poses, measured):
    light = {"none": None, "gripper": GRIPPER, "both": GRIPPER * [1.005, 1, 1, 1]}
    rows = measured(arm, poses, light, np.random.default_rng(3), 0.02)
    part = part_of(run(rows, arm.robot, STATED).loads)
    assert (part.com_m, part.unidentifiable) == (None, ("com_x_m", "com_y_m", "com_z_m", "inertia_kg_m2"))
    exchanged = replace(STATED, parts={"part": ("gripper", "both")})
    assert "exchanged" in part_of(estimate(table, arm.robot, exchanged).loads).refused


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"part": ("both", "grip")}, r"the data \(made.csv\) hold none, gripper, both"),
        ({"both": ("both", "gripper")}, "another name"),
        ({"part": ("both", "both")}, "named twice"),
        ({"part": ("both", "none")}, "unloaded arm"),
    ],
)
def test_a_part_that_is_no_difference_of_two_loads_is_refused(arm, table, parts, says):
    for command in (estimate, diagnose):
        with pytest.raises(InputError, match=says):
            command(table, arm.robot, replace(STATED, parts=parts))


def test_other_methods_give_no_part(arm, table):
    with pytest.raises(ConfigError, match="joint"):
        estimate(table, arm.robot, STATED, "difference")
