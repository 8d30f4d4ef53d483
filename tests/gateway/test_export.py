"""Units and frames of every export format, against numbers worked out by hand."""

import json
import re
import xml.etree.ElementTree as ElementTree

import pytest

from gateway.errors import ConfigError, DataUnusable
from gateway.export import FORMATS, export

LOAD = {
    "label": "gripper 2",
    "mass_kg": 12.5,
    "mass_std_kg": 0.05,
    "com_m": [0.01, -0.02, 0.18],
    "com_std_m": [0.001, 0.001, 0.002],
    "frame": "link_6",
    "com_flange_m": [0.01, -0.02, 0.08],
    "unidentifiable": [],
}


def result(**changes):
    return {"schema": 1, "robot": "small", "loads": [LOAD | changes]}


def test_abb_is_kilogram_and_millimetre_in_the_wrist_frame():
    line = [line for line in export(result(), "abb").splitlines() if line.startswith("PERS")]
    assert line == ["PERS loaddata gripper_2:=[12.500,[10.00,-20.00,80.00],[1,0,0,0],0,0,0];"]


def test_kuka_is_kilogram_millimetre_and_degrees_in_the_flange_frame():
    text = export(result(), "kuka")
    aggregate = "{M 12.500,CM {X 10.00,Y -20.00,Z 80.00,A 0.0,B 0.0,C 0.0},J {X 0.0,Y 0.0,Z 0.0}}"
    assert f"LOAD_DATA[1]={aggregate}" in text.splitlines()
    assert f"$LOAD={aggregate}" in text


def test_ur_is_kilogram_and_metre_in_the_tool_flange_frame():
    assert "  set_target_payload(12.500, [0.01000, -0.02000, 0.08000])" in export(result(), "ur").splitlines()


def test_urdf_inertial_reads_back():
    root = ElementTree.fromstring(export(result(), "urdf"))  # noqa: S314 - own text
    inertial = root.find("link/inertial")
    assert [float(x) for x in inertial.find("origin").get("xyz").split()] == [0.01, -0.02, 0.08]
    assert float(inertial.find("mass").get("value")) == 12.5
    assert {float(value) for value in inertial.find("inertia").attrib.values()} == {0.0}
    assert root.find("joint/parent").get("link") == "flange"


def test_urdf_and_json_fall_back_to_link_6_and_say_so():
    load = {key: value for key, value in LOAD.items() if key != "com_flange_m"}
    body = {"schema": 1, "robot": "small", "loads": [load]}
    root = ElementTree.fromstring(export(body, "urdf"))  # noqa: S314 - own text
    assert root.find("joint/parent").get("link") == "link_6"
    assert root.find("link/inertial/origin").get("xyz") == "0.010000 -0.020000 0.180000"
    only = json.loads(export(body, "json"))["loads"][0]
    assert (only["frame"], only["com_m"], only["inertia_kg_m2"]) == ("link_6", LOAD["com_m"], None)


@pytest.mark.parametrize("fmt", ["abb", "kuka", "ur"])
def test_a_controller_needs_the_flange(fmt):
    load = {key: value for key, value in LOAD.items() if key != "com_flange_m"}
    with pytest.raises(ConfigError, match="flange_xyz_m"):
        export({"schema": 1, "robot": "small", "loads": [load]}, fmt)


@pytest.mark.parametrize("fmt", sorted(FORMATS))
def test_what_was_not_identified_is_refused(fmt):
    gap = [0.01, None, 0.1]
    with pytest.raises(DataUnusable, match="com along gravity"):
        export(result(com_m=gap, com_flange_m=gap, unidentifiable=["com along gravity"]), fmt)
    with pytest.raises(DataUnusable, match="rows 9 and 10"):
        export(result(mass_kg=None, refused="rows 9 and 10 have the wrong sign"), fmt)


@pytest.mark.parametrize("fmt", sorted(FORMATS))
def test_inertia_is_said_to_be_unknown(fmt):
    assert "inertia not measured" in export(result(), fmt)


@pytest.mark.parametrize("fmt", sorted(FORMATS))
def test_a_label_cannot_leave_its_comment(fmt):
    text = export(result(label="a\nMoveJ p10 -- <b>"), fmt)
    assert not re.search(r"^MoveJ", text, flags=re.MULTILINE)


def test_refused_loads_are_left_out_unless_named():
    body = {"schema": 1, "robot": "r", "loads": [LOAD, LOAD | {"label": "b", "mass_kg": None, "refused": "why"}]}
    assert export(body, "kuka").count("LOAD_DATA[") == 1
    with pytest.raises(DataUnusable, match="why"):
        export(body, "kuka", "b")
    with pytest.raises(ConfigError, match="gripper 2, b"):
        export(body, "kuka", "c")
    with pytest.raises(ConfigError, match="choose one of"):
        export(body, "fanuc")
