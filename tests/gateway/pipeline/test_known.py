"""Known loads as a person states them: with the frame of the centre of gravity, in kg and m."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.cell.config import load_cell
from gateway.errors import ConfigError, InputError
from gateway.identify.knowledge import WeighedLoad
from gateway.model.arm_model import arm_robot
from gateway.model.load_bounds import NO_ARM
from gateway.model.robot import with_flange
from gateway.pipeline.known import KnownLoad, in_last_link, parse_known, unnamed_frame

SMALL = Path(__file__).parents[3] / "examples" / "small" / "cell.toml"


@pytest.fixture(scope="module")
def robot():
    loaded = load_cell(SMALL)
    return arm_robot(loaded, loaded.cell.arm[0])


def known(text):
    return parse_known(text)[1]


def test_numbers_and_frame():
    assert parse_known("tool=12.5,0,-0.1,0.11") == ("tool", KnownLoad(12.5, (0.0, -0.1, 0.11)))
    assert parse_known("tool=12.5,flange=0,-0.1,0.11") == ("tool", KnownLoad(12.5, (0.0, -0.1, 0.11), "flange"))
    assert parse_known("tool = 12.5, link_6 = 0, -0.1, 0.11")[1].frame == "link_6"
    assert parse_known(" tool =1,0,0,0")[0] == "tool"
    assert parse_known("tool=12.5") == ("tool", KnownLoad(12.5))


def test_standard_deviations_follow_the_mass_and_the_centre():
    centre = (0.0, -0.1, 0.11)
    assert known("t=12.5+-0.02") == KnownLoad(12.5, mass_std_kg=0.02)
    assert known("t=12.5+-0.02,0,-0.1,0.11+-0.003") == KnownLoad(12.5, centre, None, 0.02, 0.003)
    assert known("t=12.5 ± 0.02,flange=0,-0.1,0.11") == KnownLoad(12.5, centre, "flange", 0.02)
    assert known("t=12.5+-0,0,-0.1,0.11+-0") == KnownLoad(12.5, centre)
    with pytest.raises(InputError, match="open"):
        known("t=2+-2")
    with pytest.raises(InputError, match=r"write \+-0.003"):
        known("t=2,0,0,0.1+-3")


def test_a_mass_without_a_centre(robot):
    assert in_last_link("a", known("a=2"), robot, NO_ARM) == WeighedLoad(2.0)
    assert unnamed_frame("a", known("a=2"), robot) is None
    with pytest.raises(InputError, match="a load of 0 kg is not allowed"):
        parse_known("a=0")
    with pytest.raises(InputError, match=r"grams\? that is 9 kg"):
        in_last_link("a", known("a=9000"), robot, NO_ARM)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "tool",
        "tool=1,2,3",
        "tool=1,2,3,x",
        "=1,0,0,0",
        "tool=-1,0,0,0",
        "tool=inf,0,0,0",
        "tool=1,=0,0,0",
        "tool=1,flange=0,0",
        "tool=flange=1,0,0,0",
        "tool=1+-",
        "tool=1+--0.1",
        "tool=1,0+-0.1,0,0",
        "tool=1,0,0,0+-x",
        "tool=1+-0.1+-0.2",
    ],
)
def test_known_that_means_nothing(text):
    with pytest.raises(InputError, match="LABEL=MASS,X,Y,Z"):
        parse_known(text)


def test_millimetres_are_refused_with_the_same_in_metres():
    with pytest.raises(InputError, match=r"write tool=5,flange=0,0,0.06"):
        parse_known("tool=5,flange=0,0,60")


def test_a_centre_in_the_flange_is_turned_and_moved_into_the_last_link(robot):
    turned = with_flange(robot, (0.1, 0.0, 0.05), (0.0, np.pi / 2, 0.0))  # z of the flange is x of the last link
    load = in_last_link("w", known("w=5+-0.01,flange=0.01,0.02,0.06+-0.002"), turned, NO_ARM)
    assert (load.mass_kg, load.mass_std_kg, load.com_std_m) == (5.0, 0.01, 0.002)
    assert load.com_m == pytest.approx([0.1 + 0.06, 0.02, 0.05 - 0.01])


@pytest.mark.parametrize("text", ["w=5,0.01,0.02,0.06", "w=5,link_6=0.01,0.02,0.06"])
def test_a_centre_in_the_last_link_stays(robot, text):
    assert in_last_link("w", known(text), robot, NO_ARM) == WeighedLoad(5.0, com_m=(0.01, 0.02, 0.06))


def test_another_frame_is_refused(robot):
    with pytest.raises(InputError, match=r"frame 'tool0' is not known: write link_6= or flange="):
        in_last_link("w", known("w=5,tool0=0,0,0.06"), robot, NO_ARM)


def test_a_flange_that_is_not_known_is_refused():
    with pytest.raises(ConfigError, match="flange_xyz_m and flange_rpy_rad"):
        in_last_link("w", known("w=5,flange=0,0,0.06"), None, NO_ARM)


def test_a_frame_that_was_not_named_is_reported_where_it_matters(robot):
    found = unnamed_frame("w", known("w=5,0,0,0.06"), robot)
    assert found is not None
    assert "taken in link_6" in found.what
    assert unnamed_frame("w", known("w=5,link_6=0,0,0.06"), robot) is None
    assert unnamed_frame("w", known("w=5,flange=0,0,0.06"), robot) is None
    assert unnamed_frame("w", known("w=5,0,0,0.06"), with_flange(robot, (0, 0, 0))) is None
