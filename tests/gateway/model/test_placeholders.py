"""Values filled in by an exporter are distinguished from stated ones; soft limits of a URDF narrow the hard ones."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gateway.model.placeholders import model_remarks
from gateway.model.robot import Robot, robot_from_urdf
from tests.data.arms import urdf_of


def robot_of(text: str) -> Robot:
    return robot_from_urdf(text, "r.urdf")


def stated() -> str:
    """An arm whose efforts differ."""
    efforts = iter((180, 170, 90, 40, 30, 18))
    return re.sub(r'effort="100"', lambda _: f'effort="{next(efforts)}"', urdf_of(np.random.default_rng(0)))


def test_a_stated_model_holds_no_placeholder():
    assert list(model_remarks(robot_of(stated()))) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: re.sub(r'effort="\d+"', 'effort="1000"', text), "same effort of 1000 Nm on every axis"),
        (lambda text: re.sub(r'effort="180"', 'effort="1e10"', text), r"effort of 1e\+10 Nm"),
        (lambda text: re.sub(r'<mass value="[^"]*"', '<mass value="1"', text), "same mass of 1 kg for every link"),
        (
            lambda text: re.sub(r'ixx="[^"]*"', 'ixx="900"', text, count=1),
            r"inertia of link_1 is not possible for a body.*correct it",
        ),
        (
            lambda text: re.sub(r'iyy="[^"]*"', 'iyy="-0.1"', text, count=1),
            "inertia of link_1 is not possible for a body",
        ),
        (lambda text: re.sub(r'(i[xyz]{2})="[^"]*"', r'\1="0"', text), "inertia of link_1, link_2, link_3"),
        (
            lambda text: re.sub(r'(i(?:xx|yy|zz))="[^"]*"', r'\1="900"', text, count=3),
            "inertia of link_1 is not that of a link of this mass and size",
        ),
    ],
)
def test_a_placeholder_is_named_with_what_to_do(change, says):
    (only,) = model_remarks(robot_of(change(stated())))
    assert re.search(says, only)
    assert only.startswith("r.urdf: a placeholder: ")
    assert "; " in only


@pytest.mark.parametrize(
    ("soft", "limits"),
    [
        ('soft_lower_limit="-2.5" soft_upper_limit="2"', (-2.5, 2.0)),
        ('soft_lower_limit="-4" soft_upper_limit="2"', (-3.0, 2.0)),
        ('soft_upper_limit="1"', (-3.0, 1.0)),
        ('soft_lower_limit="0" soft_upper_limit="0"', (-3.0, 3.0)),
        ('k_velocity="10"', (-3.0, 3.0)),
    ],
)
def test_soft_limits_narrow_the_range_where_they_are_one(soft: str, limits: tuple[float, float]):
    text = stated().replace("</joint>", f"<safety_controller {soft}/></joint>", 1)
    robot = robot_of(text)
    assert (robot.lower_rad[0], robot.upper_rad[0]) == limits
    assert robot.upper_rad[1] == 3.0
