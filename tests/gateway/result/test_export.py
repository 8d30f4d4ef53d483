"""Units and frames of every export format, against numbers computed by hand."""

import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from gateway.errors import ConfigError, DataUnusable, InputError
from gateway.result.export import FORMATS, export
from gateway.result.names import EXPORT_FORMATS
from gateway.result.result import from_json

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


def holding(loads):
    """The result that a file with these loads holds."""
    return from_json(json.dumps({"schema": 1, "robot": "small", "loads": loads}))


def result(**changes):
    return holding([LOAD | changes])


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
    root = ElementTree.fromstring(export(result(), "urdf"))
    inertial = root.find("link/inertial")
    assert [float(x) for x in inertial.find("origin").get("xyz").split()] == [0.01, -0.02, 0.08]
    assert float(inertial.find("mass").get("value")) == 12.5
    assert inertial.find("inertia") is None
    links = {link.get("name") for link in root.findall("link")}
    assert {joint.find(end).get("link") for joint in root.findall("joint") for end in ("parent", "child")} <= links
    assert root.find("joint/parent").get("link") == "flange"


def test_urdf_and_json_fall_back_to_link_6_and_say_so():
    load = {key: value for key, value in LOAD.items() if key != "com_flange_m"}
    body = holding([load])
    root = ElementTree.fromstring(export(body, "urdf"))
    assert root.find("joint/parent").get("link") == "link_6"
    assert root.find("link/inertial/origin").get("xyz") == "0.010000 -0.020000 0.180000"
    only = json.loads(export(body, "json"))["loads"][0]
    assert (only["frame"], only["com_m"], only["inertia_kg_m2"]) == ("link_6", LOAD["com_m"], None)


def test_fanuc_is_kilogram_and_centimetre_in_the_faceplate_frame():
    lines = [
        line.split(":", 1)[1].strip() for line in export(result(), "fanuc").splitlines() if re.match(r" +\d+:", line)
    ]
    assert all(line.endswith(" ;") for line in lines)
    lines_ = [line.removesuffix(" ;") for line in lines if line.startswith("$")]
    assert lines_ == [
        "$PLST_GRP1[1].$PAYLOAD=12.500",
        "$PLST_GRP1[1].$PAYLOAD_X=1.000",
        "$PLST_GRP1[1].$PAYLOAD_Y=(-2.000)",
        "$PLST_GRP1[1].$PAYLOAD_Z=8.000",
        "$PLST_GRP1[1].$PAYLOAD_IX=0",
        "$PLST_GRP1[1].$PAYLOAD_IY=0",
        "$PLST_GRP1[1].$PAYLOAD_IZ=0",
    ]
    assert all(len(line.removesuffix(" ;")) <= 33 for line in lines if line.startswith("!"))


def test_fanuc_fills_a_schedule_per_load_without_motion():
    body = holding([LOAD, LOAD | {"label": "b;\nL P[1] 100% FINE", "mass_kg": 3.0}])
    text = export(body, "fanuc")
    assert "$PLST_GRP1[2].$PAYLOAD=3.000" in text
    assert "DEFAULT_GROUP = *,*,*,*,*;" in text
    numbers = [int(line.split(":")[0]) for line in text.splitlines() if re.match(r" +\d+:", line)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert not re.search(r"^ +\d+: +[JL] ", text, flags=re.MULTILINE)


def test_yaskawa_is_kilogram_and_millimetre_from_the_mounting_plate():
    text = export(result(), "yaskawa")
    # the format is JSON with comments and bare keys: give it quotes, then read it back
    plain = "\n".join(line for line in text.splitlines() if not line.strip().startswith("//"))
    body = json.loads(re.sub(r"(\w+):", r'"\1":', plain))
    (preset,) = body["presets"]
    assert (body["filetype"], preset["preset"]) == ("presets", "tool")
    assert (preset["weight"], preset["com"], preset["moi"]) == (12.5, [10.0, -20.0, 80.0], [0.0, 0.0, 0.0])
    assert preset["displayNames"] == {"en": "gripper_2"}


@pytest.mark.parametrize("fmt", ["abb", "kuka", "ur", "fanuc", "yaskawa"])
def test_a_controller_needs_the_flange(fmt):
    load = {key: value for key, value in LOAD.items() if key != "com_flange_m"}
    with pytest.raises(ConfigError, match="flange_xyz_m"):
        export(holding([load]), fmt)


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


#: About the centre of gravity, axes of the flange: principal moments 0.3, 0.5 and 0.4 kg m2 about turned axes.
TURN = Rotation.from_euler("ZYX", [25.0, -15.0, 40.0], degrees=True).as_matrix()
TENSOR = TURN @ np.diag([0.3, 0.5, 0.4]) @ TURN.T
SIX = [TENSOR[0, 0], TENSOR[1, 1], TENSOR[2, 2], TENSOR[0, 1], TENSOR[0, 2], TENSOR[1, 2]]
#: In link 6 the numbers are others.
MOVED = {"inertia_kg_m2": [0.9, 0.8, 0.7, 0.01, 0.02, 0.03], "inertia_std_kg_m2": [0.01] * 6}
WITH_INERTIA = MOVED | {"inertia_flange_kg_m2": SIX}


def test_abb_takes_principal_moments_and_a_quaternion_of_their_axes():
    (line,) = [line for line in export(result(**WITH_INERTIA), "abb").splitlines() if line.startswith("PERS")]
    aom, moments = re.search(r"\],\[([^]]*)\],([^]]*)\];", line).groups()
    w, x, y, z = map(float, aom.split(","))
    assert w**2 + x**2 + y**2 + z**2 == pytest.approx(1.0, abs=1e-5)
    axes = Rotation.from_quat([x, y, z, w]).as_matrix()
    assert axes @ np.diag([float(value) for value in moments.split(",")]) @ axes.T == pytest.approx(TENSOR, abs=1e-4)


def test_kuka_takes_principal_moments_and_angles_about_z_y_x():
    text = export(result(**WITH_INERTIA), "kuka")
    lines_ = re.search(r"^LOAD_DATA.*A (\S+),B (\S+),C (\S+)\},J \{X (\S+),Y (\S+),Z (\S+)\}\}$", text, re.MULTILINE)
    a, b, c, *moments = map(float, lines_.groups())
    axes = Rotation.from_euler("ZYX", [a, b, c], degrees=True).as_matrix()
    assert axes @ np.diag(moments) @ axes.T == pytest.approx(TENSOR, abs=1e-4)
    assert "enter J" not in text


def test_ur_and_urdf_and_ros_and_json_take_all_six_moments():
    lines_ = ", ".join(f"{value:.6f}" for value in SIX)
    assert f"[0.01000, -0.02000, 0.08000], [{lines_}])" in export(result(**WITH_INERTIA), "ur")
    inertia = ElementTree.fromstring(export(result(**WITH_INERTIA), "urdf")).find("link/inertial/inertia")
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    assert [float(inertia.get(name)) for name in names] == pytest.approx(SIX, abs=1e-6)
    message = yaml.safe_load(export(result(**WITH_INERTIA), "ros"))["gripper_2"]
    assert [message.pop(name) for name in names] == pytest.approx(SIX, abs=1e-6)
    assert message == {"m": 12.5, "com": {"x": 0.01, "y": -0.02, "z": 0.08}}
    only = json.loads(export(result(**WITH_INERTIA), "json"))["loads"][0]
    assert only["inertia_kg_m2"] == pytest.approx(SIX)
    assert "inertia_note" not in only


def test_in_link_6_the_inertia_is_that_of_link_6():
    load = {key: value for key, value in (LOAD | MOVED).items() if key != "com_flange_m"}
    only = json.loads(export(holding([load]), "json"))["loads"][0]
    assert (only["frame"], only["inertia_kg_m2"]) == ("link_6", MOVED["inertia_kg_m2"])


def test_fanuc_takes_moments_in_kgf_cm_s2_and_says_that_products_are_left_out():
    text = export(result(**WITH_INERTIA), "fanuc")
    lines_ = [float(value) for value in re.findall(r"PAYLOAD_I[XYZ]=(\S+) ;", text)]
    # 1 kgf = 9.80665 N, 1 m = 100 cm
    assert lines_ == pytest.approx([value * 100.0 / 9.80665 for value in SIX[:3]], abs=1e-4)
    assert "inertia without its products" in text
    assert all(len(line) <= 33 for line in re.findall(r"(!.*) ;", text))


def test_yaskawa_takes_moments_about_the_axes_of_the_plate():
    text = export(result(**WITH_INERTIA), "yaskawa")
    lines_ = [float(value) for value in re.search(r"moi: \[(.*)\]", text).group(1).split(",")]
    assert lines_ == pytest.approx(SIX[:3], abs=1e-5)
    most = max(map(abs, SIX[3:]))
    assert f"products of inertia up to {most:.3g} kg m2 left out" in text


@pytest.mark.parametrize("fmt", sorted(FORMATS))
def test_how_well_the_inertia_is_known_is_said(fmt):
    text = export(result(**WITH_INERTIA), fmt)
    assert "not measured" not in text
    # 1.96 standard deviations of 0.01
    assert fmt == "fanuc" or "+- 0.0196 kg m2" in text


@pytest.mark.parametrize("fmt", sorted(FORMATS))
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (WITH_INERTIA | {"inertia_kg_m2": [0.9, None, 0.7, 0, 0, 0]}, "not complete"),
        (MOVED, "not in the frame of the flange"),
        (WITH_INERTIA | {"inertia_flange_kg_m2": [0.1, 0.1, 0.7, 0, 0, 0]}, "not that of a rigid body"),
    ],
)
def test_an_inertia_that_is_not_whole_is_written_as_if_it_was_not_measured_and_said(fmt, changes, words):
    text, without = export(result(**changes), fmt), export(result(), fmt)
    assert words in text or (fmt == "fanuc" and "inertia not known: 0" in text)
    marks = ("PERS", "LOAD_DATA", "  set_target", "$PLST", "      moi", '   "inertia_kg_m2"', "      <!-- add")
    for mark in marks:
        lines = [[line for line in each.splitlines() if line.startswith(mark)] for each in (text, without)]
        assert lines[0] == lines[1]


@pytest.mark.parametrize("fmt", sorted(FORMATS))
def test_a_label_cannot_leave_its_comment(fmt):
    text = export(result(label="a\nMoveJ p10 -- <b>"), fmt)
    assert not re.search(r"^MoveJ", text, flags=re.MULTILINE)


def test_refused_loads_are_left_out_unless_named():
    body = holding([LOAD, LOAD | {"label": "b", "mass_kg": None, "refused": "why"}])
    assert export(body, "kuka").count("LOAD_DATA[") == 1
    with pytest.raises(DataUnusable, match="why"):
        export(body, "kuka", "b")
    with pytest.raises(ConfigError, match="gripper 2, b"):
        export(body, "kuka", "c")
    with pytest.raises(ConfigError, match="choose one of"):
        export(body, "staubli")


def test_the_formats_that_are_offered_are_those_that_are_written():
    assert tuple(FORMATS) == EXPORT_FORMATS


def test_opc40010_is_a_load_type_with_its_units():
    (load,) = json.loads(export(result(**WITH_INERTIA), "opc40010"))["Loads"]
    assert load["TypeDefinition"] == "LoadType"
    assert load["Mass"]["Value"] == 12.5
    # UNECE code KGM, its letters as bytes of one number
    assert load["Mass"]["EngineeringUnits"]["UnitId"] == int.from_bytes(b"KGM", "big")
    frame = load["CenterOfMass"]["Value"]
    assert [frame["CartesianCoordinates"][axis] for axis in "XYZ"] == [0.01, -0.02, 0.08]
    roll, pitch, yaw = np.radians([frame["Orientation"][axis] for axis in "ABC"])
    about = {
        "x": [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]],
        "y": [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]],
        "z": [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]],
    }
    turn = np.array(about["z"]) @ np.array(about["y"]) @ np.array(about["x"])
    principal = np.diag([load["Inertia"]["Value"][axis] for axis in "XYZ"])
    xx, yy, zz, xy, xz, yz = SIX
    assert turn @ principal @ turn.T == pytest.approx(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), abs=1e-9)


def test_opc40010_leaves_out_an_inertia_that_is_not_known():
    (load,) = json.loads(export(result(), "opc40010"))["Loads"]
    assert "Inertia" not in load
    assert set(load["CenterOfMass"]["Value"]["Orientation"].values()) == {0.0}


WITH_COMMENTS = sorted(set(EXPORT_FORMATS) - {"json", "fanuc"})


def from_flange(source):
    """The result of a cell whose flange comes from there."""
    body = {"schema": 1, "robot": "small", "loads": [LOAD], "data": {"flange_source": source}}
    return from_json(json.dumps(body))


@pytest.mark.parametrize("fmt", WITH_COMMENTS)
def test_an_export_says_where_its_frame_comes_from(fmt):
    assert "URDF, its flange frame" in export(from_flange("URDF, its flange frame"), fmt)


@pytest.mark.parametrize("fmt", sorted(EXPORT_FORMATS))
def test_an_export_says_that_its_frame_is_assumed(fmt):
    assumed, stated = (export(from_flange(source), fmt) for source in ("assumed: not turned", "cell file"))
    assert "assumed" in assumed.lower()
    assert "assumed" not in stated.lower()


@pytest.mark.parametrize("fmt", sorted(EXPORT_FORMATS))
def test_every_export_names_the_frame(fmt):
    assert re.search("flange|faceplate|mounting plate|tool0", export(result(), fmt))


def test_a_load_that_no_arm_carries_is_not_exported():
    with pytest.raises(DataUnusable, match=r"5679 kg is beyond 3000 kg .*grams\? that is 5\.679 kg"):
        export(result(mass_kg=5679.0), "kuka")


EQUAL_WHEN_PRINTED = {
    "separators": ["tool-1", "tool_1", "tool 1"],
    "cut": ["gripper_with_the_long_fingers_a", "gripper_with_the_long_fingers_b"],
    "letters": ["größe", "grüße", "gr\N{GREEK SMALL LETTER ALPHA}\N{GREEK SMALL LETTER BETA}e"],
    "case": ["Tool", "tool"],
    "digits": ["1", "load_1"],
    "screen": ["gripper_of_line_1", "gripper_of_line_2"],
}
#: Name of a load in the file of each format; controller languages do not distinguish upper and lower case.
NAMED = {
    "abb": r"PERS loaddata (\w+):=",
    "ur": r"def (\w+)\(\):",
    "ros": r'^"(\w+)":$',
    "urdf": r'<link name="(load_\w+)"',
    "yaskawa": r'id: "(\S+)"',
    "fanuc": r"^ *\d+:  !(?!loads of|kg,|select|inertia|\d)(.*) ;",
}


@pytest.mark.parametrize("labels", EQUAL_WHEN_PRINTED.values(), ids=EQUAL_WHEN_PRINTED)
@pytest.mark.parametrize("fmt", NAMED)
def test_loads_have_different_names_in_the_file_of_a_controller(fmt, labels):
    body = holding([LOAD | {"label": label, "mass_kg": 3.0 + 4 * index} for index, label in enumerate(labels)])
    text = export(body, fmt)
    names = [name.strip().lower() for name in re.findall(NAMED[fmt], text, re.MULTILINE)]
    assert len(names) == len(set(names)) == len(labels), names
    for label, name in zip(labels, names, strict=True):  # alone in a file of its own: the same name
        alone = re.findall(NAMED[fmt], export(body, fmt, label), re.MULTILINE)
        assert [each.strip().lower() for each in alone] == [name]
    screens = re.findall(r'displayNames: \{ en: "(.*)" \}', text)
    assert len({name.lower() for name in screens}) == len(screens)
    assert all(len(name) <= 16 for name in screens)


@pytest.mark.parametrize("fmt", EXPORT_FORMATS)
def test_two_loads_of_one_label_are_not_exported(fmt):
    body = holding([LOAD, LOAD | {"mass_kg": 3.0}])
    with pytest.raises((DataUnusable, InputError), match="gripper 2"):
        export(body, fmt)


@pytest.mark.parametrize("fmt", EXPORT_FORMATS)
def test_labels_that_are_equal_once_they_are_printable_are_not_exported(fmt):
    body = holding([LOAD | {"label": "tool\x1ba"}, LOAD | {"label": "tool a", "mass_kg": 3.0}])
    with pytest.raises(DataUnusable, match="get equal names"):
        export(body, fmt)
