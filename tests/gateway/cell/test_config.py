"""The cell file: complete ones load, and everything else is refused by file and key."""

import copy
import math
import re
import tomllib
from pathlib import Path

import pytest

from gateway.cell.config import Cell, load_cell, parse_cell
from gateway.errors import ConfigError
from gateway.model.arm_model import arm_robot

EXAMPLES = Path(__file__).parents[3] / "examples"
CELLS = sorted(EXAMPLES.glob("*/cell.toml"))


def written(value) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {written(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(written, value)) + "]"
    return repr(value)


def as_toml(cell: dict) -> str:
    return "\n".join(f"{key} = {written(value)}" for key, value in cell.items())


@pytest.fixture
def cell() -> dict:
    return copy.deepcopy(tomllib.loads((EXAMPLES / "small" / "cell.toml").read_text()))


@pytest.mark.parametrize("path", CELLS, ids=lambda path: path.parent.name)
def test_examples_load(path):
    loaded = load_cell(path)
    arm = loaded.cell.arm[0]
    assert arm_robot(loaded, arm).axes == len(arm.axis) == (1 if path.parent.name == "bench" else 6)


def test_an_unchanged_cell_survives_the_conversion_through_toml(cell):
    assert parse_cell(as_toml(cell), "cell.toml") == load_cell(EXAMPLES / "small" / "cell.toml").cell


def at(cell: dict, *keys):
    for key in keys:
        cell = cell[key]
    return cell


HOLD = {"node_id": 7, "object": {"index": 0x60FD}, "mask": 4, "good": 4}
AXIS = ("arm", 0, "axis", 2)


@pytest.mark.parametrize(
    ("place", "key", "value", "message"),
    [
        ((), "colour", "red", "colour: unknown key"),
        ((), "name", "cell\x9b2J", "holds a control character: write printable text"),
        (("arm", 0), "name", "arm\N{RIGHT-TO-LEFT OVERRIDE}", "holds a control character: write printable text"),
        (AXIS, "torque_constant_nm_per_a", None, "torque_constant_nm_per_a is missing"),
        (AXIS, "position_limit_rad", None, "position_limit_rad is missing"),
        (
            AXIS,
            "speed_limit_rad_s",
            None,
            "missing (speed limit of the joint, at most the velocity in the URDF): write",
        ),
        (AXIS, "torque_limit_nm", None, "torque_limit_nm is missing"),
        (AXIS, "gear_efficiency", {"value": 1.2, "source": "x"}, "gear_efficiency must be in"),
        (("arm", 0), "axis", [], "has 0 [[arm.axis]] tables"),
        (("arm", 0), "start_rad", [0.0] * 4, "start_rad has 4 numbers but the arm has 6 [[arm.axis]] tables"),
        (("arm", 0), "coupling", [[1.0, 0.0]], "coupling must be an invertible"),
        (("arm", 0), "link_radius_m", 0.0, "link_radius_m"),
        (("arm", 0), "link_radius_m", [0.1, 0.1], "link_radius_m has 2 numbers but the arm has 6"),
        (("arm", 0), "load_radius_m", -0.1, "load_radius_m"),
        (("arm", 0), "hold_to_run", HOLD | {"good": 5}, "bits outside mask 0x4"),
        (("arm", 0), "hold_to_run", HOLD | {"good": 0}, "the same as a broken wire"),
        (("arm", 0), "hold_to_run", HOLD | {"node_id": 0}, "node_id = 0 must be at least 1: write node_id = 1 to 127"),
        (("arm", 0), "hold_to_run", HOLD | {"object": {"index": 0xFD}}, "object: index = 253 must be at least 4096"),
        (("arm", 0), "hold_to_run", HOLD | {"key": "space"}, "key: unknown key"),
        (("bus", "a"), "allow_real_drive", "perhaps", "allow_real_drive"),
        (("bus", "a"), "sync_period_s", -0.01, "sync_period_s"),
        (("poses",), "count", 1, "count = 1 must be at least 2"),
        (("poses",), "samples", 3, "samples = 3 must be at least 10"),
    ],
)
def test_mistakes_are_named(cell, place, key, value, message):
    table = at(cell, *place)
    if value is None:
        del table[key]
    else:
        table[key] = value
    with pytest.raises(ConfigError) as refused:
        parse_cell(as_toml(cell), "cell.toml")
    assert re.match(r"cell\.toml line \d+(, J\d)?: ", str(refused.value))
    assert message in str(refused.value)
    assert refused.value.exit_code == 3


#: What is as fast as the fastest arms, and what is degrees: joint, key, value, other keys of the axis.
FAST = [
    (3, "speed_limit_rad_s", math.radians(585), {}),
    (6, "speed_limit_rad_s", math.radians(1575), {}),
    (4, "speed_limit_rad_s", 15.0, {}),
    (1, "acceleration_limit_rad_s2", 60.0, {"speed_limit_rad_s": 5.0, "jerk_limit_rad_s3": 2000.0}),
    (1, "jerk_limit_rad_s3", 300.0, {"acceleration_limit_rad_s2": 1.875}),
    (1, "acceleration_limit_rad_s2", 40.0, {"speed_limit_rad_s": 0.02, "jerk_limit_rad_s3": 2000.0}),
    (1, "following_error_limit_rad", 0.5, {}),
]
DEGREES = [
    (1, "speed_limit_rad_s", 15.0, {}, "joints 1 to 3 .*in degrees/s[?] write speed_limit_rad_s = 0.2618"),
    (3, "speed_limit_rad_s", 12.1, {}, "beyond 12 rad/s"),
    (4, "speed_limit_rad_s", 60.0, {}, "beyond 30 rad/s .*write speed_limit_rad_s = 1.047"),
    (6, "acceleration_limit_rad_s2", 86.0, {"speed_limit_rad_s": 1.0}, "full speed in 12 ms.*in degrees/s2[?] .*1.501"),
    (2, "jerk_limit_rad_s3", 573.0, {}, "full acceleration in 4 ms.*in degrees/s3[?] .*10"),
    (2, "jerk_limit_rad_s3", 573.0, {"acceleration_limit_rad_s2": 2.2}, "beyond 550 rad/s3"),
    (5, "following_error_limit_rad", 1.5, {}, "beyond 1 rad .*write following_error_limit_rad = 0.02618"),
]


@pytest.mark.parametrize(("joint", "key", "value", "more", "message"), [*(row + (None,) for row in FAST), *DEGREES])
def test_limits_in_degrees_are_refused_and_those_of_fast_arms_are_not(cell, joint, key, value, more, message):
    cell["arm"][0]["axis"][joint - 1] |= more | {key: value}
    if message is None:
        assert getattr(parse_cell(as_toml(cell), "cell.toml").arm[0].axis[joint - 1], key) == value
        return
    with pytest.raises(ConfigError, match=rf"cell\.toml line \d+, J{joint}: {key}: .*{message}") as refused:
        parse_cell(as_toml(cell), "cell.toml")
    assert len(refused.value.lines) == 1


def test_every_mistake_is_named_at_once(cell):
    del cell["arm"][0]["axis"][0]["gear_ratio"]
    del cell["arm"][0]["axis"][5]["torque_limit_nm"]
    del cell["bus"]["a"]["channel"]
    cell["arm"][0]["axis"][3]["node_id"] = 1
    with pytest.raises(ConfigError) as refused:
        parse_cell(as_toml(cell), "cell.toml")
    names = [line.partition(": ")[2].split(" (")[0] for line in refused.value.lines]
    assert {text.split(": write")[0] for text in names} == {
        "channel is missing",
        "gear_ratio is missing",
        "arm 'main': node id 1 is used for more than one axis",
        "torque_limit_nm is missing",
    }


@pytest.mark.parametrize("axes", [0, 9])
def test_too_few_and_too_many_axes_are_refused(cell, axes):
    cell["arm"][0]["axis"] = [{**cell["arm"][0]["axis"][0], "node_id": number + 1} for number in range(axes)]
    with pytest.raises(ConfigError, match=rf"arm 'main' has {axes} \[\[arm.axis\]\] tables, 1 to 8 are handled"):
        parse_cell(as_toml(cell), "cell.toml")


def test_an_arm_of_a_pair_has_at_least_six_axes():
    path = EXAMPLES / "pair" / "cell.toml"
    pair = tomllib.loads(path.read_text())
    pair["arm"][0]["axis"].pop()
    pair["arm"][0]["start_rad"].pop()
    with pytest.raises(ConfigError, match=r"is the .* of a pair and has 5 axes; .* at least 6 axes"):
        parse_cell(as_toml(pair), "cell.toml")


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({}, True),
        ({"options": {"receive_own_messages": True}}, True),
        ({"sync_period_s": 0.02}, True),
        ({"channel": "can1"}, False),
        ({"options": {"device_id": 7}}, False),
    ],
)
def test_two_tables_of_one_channel_are_refused(cell, changes, refused):
    cell["bus"]["a"] = {"interface": "socketcan", "channel": "can0"}
    cell["bus"]["b"] = cell["bus"]["a"] | changes
    if refused:
        with pytest.raises(
            ValueError, match=r"\[bus.b\] and \[bus.a\] are both socketcan can0: one bus has one master"
        ):
            Cell.model_validate(cell)
    else:
        assert set(Cell.model_validate(cell).bus) == {"a", "b"}


def test_two_arms_on_one_bus_need_different_nodes(cell):
    second = copy.deepcopy(cell["arm"][0]) | {"name": "left"}
    cell["arm"].append(second)
    with pytest.raises(ConfigError, match="node id 1 is used by two arms"):
        parse_cell(as_toml(cell), "cell.toml")
    for number, axis in enumerate(second["axis"]):
        axis["node_id"] = 11 + number
    assert isinstance(parse_cell(as_toml(cell), "cell.toml"), Cell)


def test_unreadable_files(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_cell(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_cell(tmp_path / "latin.toml")
    (tmp_path / "bad.toml").write_text("name = ")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_cell(tmp_path / "bad.toml")


def test_robot_that_cannot_be_read(cell, tmp_path):
    (tmp_path / "cell.toml").write_text(as_toml(cell))
    loaded = load_cell(tmp_path / "cell.toml")
    with pytest.raises(ConfigError, match=r"robot.urdf: cannot be read"):
        arm_robot(loaded, loaded.cell.arm[0])
    (tmp_path / "robot.urdf").write_text("<robot")
    with pytest.raises(ConfigError, match=r"robot.urdf"):
        arm_robot(loaded, loaded.cell.arm[0])


def test_the_cell_names_the_last_link_of_its_arm(cell, tmp_path):
    jaw = '<link name="l7"/><joint name="j7" type="revolute"><parent link="link_6"/><child link="l7"/></joint></robot>'
    text = (EXAMPLES / "small" / "robot.urdf").read_text(encoding="utf-8").replace("</robot>", jaw)
    (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
    (tmp_path / "cell.toml").write_text(as_toml(cell))
    loaded = load_cell(tmp_path / "cell.toml")
    with pytest.raises(ConfigError, match=r'has 7 axes.*where j7 is not an axis.*tip = "link_6"'):
        arm_robot(loaded, loaded.cell.arm[0])
    cell["arm"][0]["tip"] = "link_6"
    (tmp_path / "cell.toml").write_text(as_toml(cell))
    loaded = load_cell(tmp_path / "cell.toml")
    assert arm_robot(loaded, loaded.cell.arm[0]).axes == 6


def test_a_tip_needs_a_urdf(cell):
    table = {key: [0.0] * 6 for key in ("alpha_rad", "a_m", "d_m", "theta_offset_rad")}
    del cell["arm"][0]["robot"]
    cell["arm"][0] |= {"dh": {"convention": "modified"} | table, "tip": "link_6"}
    with pytest.raises(ConfigError, match="tip names a link of a URDF"):
        parse_cell(as_toml(cell), "cell.toml")


def test_safety_keys_are_read_and_off_by_default(cell):
    plain = parse_cell(as_toml(cell), "cell.toml")
    assert plain.bus["a"].allow_real_drive is False
    assert plain.arm[0].hold_to_run is None
    assert plain.arm[0].link_radius_m is None
    cell["arm"][0] |= {"hold_to_run": HOLD, "link_radius_m": [0.1, 0.09, 0.08, 0.07, 0.06, 0.05], "load_radius_m": 0}
    cell["bus"]["a"]["allow_real_drive"] = True
    read = parse_cell(as_toml(cell), "cell.toml")
    hold = read.arm[0].hold_to_run
    assert (hold.node_id, hold.object.index, hold.object.subindex, hold.mask, hold.good) == (7, 0x60FD, 0, 4, 4)
    assert read.arm[0].link_radius_m == (0.1, 0.09, 0.08, 0.07, 0.06, 0.05)
    assert read.arm[0].load_radius_m == 0
    assert read.bus["a"].allow_real_drive is True


@pytest.mark.parametrize(
    ("source", "stated", "percent"),
    [
        ("measured", None, 1.0),
        ("read from drive, 0x6076", None, 3.0),
        ("Datasheet p. 12", None, 5.0),
        ("assumed", None, 10.0),
        ("catalogue", None, 5.0),
        ("assumed", 0.0, 0.0),
        ("measured", 7.5, 7.5),
    ],
)
def test_a_torque_constant_is_trusted_as_stated_else_as_its_source(cell, source, stated, percent):
    constant = {"value": 1.0, "source": source} | ({} if stated is None else {"std_percent": stated})
    cell["arm"][0]["axis"][0]["torque_constant_nm_per_a"] = constant
    read = Cell.model_validate(cell)
    assert read.arm[0].axis[0].torque_constant_nm_per_a.trust_percent == percent


def test_a_torque_constant_known_to_half_is_refused(cell, tmp_path):
    cell["arm"][0]["axis"][1]["torque_constant_nm_per_a"]["std_percent"] = 50.0
    path = tmp_path / "cell.toml"
    path.write_text(as_toml(cell))
    with pytest.raises(
        ConfigError, match="a torque constant with a standard deviation of 50 % does not determine a mass"
    ):
        load_cell(path)
