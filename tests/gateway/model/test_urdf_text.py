"""From the bytes of a robot file to its elements: encodings, formats of others, and files that are no files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.model.robot import robot_from_urdf
from gateway.model.urdf_text import MOST_BYTES, parse_urdf, read_urdf
from tests.data.arms import urdf_of

NAMED = urdf_of(np.random.default_rng(0)).replace('name="random"', 'name="Gelenkärmchen"')


def stored(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "r.urdf"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("declared", "stored_as"),
    [
        ("", "utf-8"),
        ("", "utf-8-sig"),
        ("UTF-8", "utf-8"),
        ("ISO-8859-1", "iso-8859-1"),
        ("iso-8859-15", "iso-8859-15"),
        ("windows-1252", "cp1252"),
        ("UTF-16", "utf-16"),
    ],
)
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path: Path, declared: str, stored_as: str):
    head = f'<?xml version="1.0" encoding="{declared}"?>' if declared else ""
    robot = robot_from_urdf(read_urdf(stored(tmp_path, (head + NAMED).encode(stored_as))), "r.urdf")
    assert robot.name == "Gelenkärmchen"
    assert robot.axes == 6


def test_bytes_of_another_encoding_are_named_by_line_with_the_declaration_to_write(tmp_path: Path):
    path = stored(tmp_path, ("<!-- first -->\n" + NAMED).encode("iso-8859-1"))
    with pytest.raises(ConfigError, match=r'r\.urdf:2: byte 0xE4 is not utf-8; .*encoding="ISO-8859-1"'):
        read_urdf(path)


@pytest.mark.parametrize("name", ["no-such-code", "punycode", "idna", "hex", "rot13"])
def test_an_encoding_that_is_none_of_text_is_refused(tmp_path: Path, name: str):
    path = stored(tmp_path, f'<?xml version="1.0" encoding="{name}"?><robot/>'.encode())
    with pytest.raises(ConfigError, match=rf"encoding '{name}' is not known; save the file as UTF-8"):
        read_urdf(path)


def test_a_pipe_a_device_a_folder_and_a_huge_file_are_refused_at_once(tmp_path: Path):
    pipe, huge, link = tmp_path / "pipe", tmp_path / "huge", tmp_path / "link"
    os.mkfifo(pipe)
    with huge.open("wb") as stream:
        stream.truncate(MOST_BYTES + 1)
    link.symlink_to("/dev/zero")
    for path, says in ((pipe, "pipe or socket"), (huge, "limit"), (link, "a device"), (tmp_path, "a folder")):
        with pytest.raises(ConfigError, match=says):
            read_urdf(path)
    with pytest.raises(ConfigError, match=r"absent: cannot be read: No such file.*name the URDF"):
        read_urdf(tmp_path / "absent")


def test_prefixes_that_nothing_declares_are_read_as_they_are_written():
    text = NAMED.replace("</robot>", '<gazebo><sensor:camera xyz="1"/></gazebo></robot>')
    assert robot_from_urdf(text, "r.urdf").axes == 6


def test_a_default_namespace_does_not_hide_the_elements():
    text = NAMED.replace("<robot ", '<robot xmlns="http://www.ros.org" ')
    assert robot_from_urdf(text, "r.urdf").axes == 6


XACRO = {
    "a property": (
        lambda text: text.replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ').replace(
            "<link", '<xacro:property name="h" value="0.3"/><link', 1
        )
    ),
    "an expression": lambda text: text.replace('upper="3"', 'upper="${pi}"'),
    "a package": lambda text: text.replace(
        '<link name="base"/>',
        '<link name="base"><visual><geometry><mesh filename="$(find arm)/a.stl"/></geometry></visual></link>',
    ),
    "macros alone": lambda text: '<robot><xacro:macro name="arm" params="prefix"/></robot>',
}


@pytest.mark.parametrize("change", XACRO.values(), ids=XACRO.keys())
@pytest.mark.parametrize(
    ("file", "new"), [("a.urdf.xacro", "a.urdf"), ("a.xacro", "a.urdf"), ("a.urdf", "a.expanded.urdf")]
)
def test_xacro_is_recognised_and_answered_with_the_command(change, file, new):
    with pytest.raises(ConfigError) as caught:
        parse_urdf(change(NAMED), file)
    assert f"this is a xacro file: expand it first: `xacro {file} > {new}`" in str(caught.value)


def test_an_expanded_file_that_still_declares_xacro_is_read():
    text = NAMED.replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ')
    text = text.replace("</robot>", '<gazebo><plugin path="$(find x)/y"/></gazebo></robot>')
    assert robot_from_urdf(text, "r.urdf").axes == 6


@pytest.mark.parametrize(
    ("root", "says"),
    [
        ("mujoco", r"a MuJoCo model \(MJCF\).*convert it first.*convert\('arm\.xml', 'arm\.urdf'\)"),
        ("sdf", r"an SDF file.*convert it first: `rosrun pysdf sdf2urdf\.py arm\.xml arm\.urdf`"),
        ("launch", "a ROS launch file.*name the URDF"),
        ("svg", "a URDF starts with <robot>; name the URDF"),
    ],
)
def test_other_formats_are_recognised_and_answered_with_how_to_convert(root: str, says: str):
    with pytest.raises(ConfigError, match=says):
        parse_urdf(f"<{root}/>", "arm.xml")
