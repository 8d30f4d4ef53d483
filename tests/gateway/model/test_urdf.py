"""Which joints of a URDF are the arm's: branches, fingers, balancers, tracks and grippers, against pinocchio."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pinocchio
import pytest

from gateway.errors import ConfigError
from gateway.model.regressor import regressor
from gateway.model.robot import Robot, robot_from_urdf
from tests.data.arms import link_parameters, states, torque_of, urdf_of

BODY = (
    '<inertial><origin xyz="0.02 0.01 0.05" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.04"/></inertial>'
)


def joint(name: str, parent: str, kind: str, child: str = "", inner: str = "", mass: float = 1.5) -> str:
    """A joint at some place of a link, and the link that it carries."""
    child = child or f"{name}_link"
    return (
        f'<link name="{child}">{BODY.format(mass=mass)}</link><joint name="{name}" type="{kind}">'
        f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0.1 -0.05 0.2" rpy="0.4 -0.2 0.1"/>'
        f'<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="20" velocity="1"/>{inner}</joint>'
    )


def arm(seed: int, *more: str, axes: int = 6) -> str:
    return urdf_of(np.random.default_rng(seed), "".join(more), axes)


def on_a_track(text: str, kind: str = "prismatic") -> str:
    """The same arm, its base carried by another joint."""
    track = '<link name="world"/>' + joint("track", "world", kind, "base", mass=9.0).replace(BODY.format(mass=9.0), "")
    return text.replace('<link name="base"/>', track)


def assert_torque_as_pinocchio(text: str, robot: Robot, seed: int = 5) -> None:
    """Inverse dynamics of what was read, against pinocchio with the same joints free and all others locked at zero."""
    full_model = pinocchio.buildModelFromXML(text)
    # a joint that mimics another is one of its own for pinocchio, unless it is asked otherwise
    locked = [full_model.getJointId(name) for name in full_model.names[1:] if name not in robot.joint_names]
    model = pinocchio.buildReducedModel(full_model, locked, pinocchio.neutral(full_model))
    assert tuple(model.names[1:]) == robot.joint_names
    q, qd, qdd = states(seed, 5, robot.axes)
    rows = np.asarray(regressor(robot, q, qd, qdd, (0.0, 0.0, -9.80665))) @ link_parameters(robot)
    model.gravity.linear = np.array([0.0, 0.0, -9.80665])
    expected = torque_of(model, q, qd, qdd)
    np.testing.assert_allclose(rows, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


MIMIC = '<mimic joint="joint_2" multiplier="-0.4"/>'
CLEAR = {
    "a balancer that mimics an axis": (joint("balancer", "link_1", "revolute", inner=MIMIC),),
    "one sliding finger": (joint("finger", "link_6", "prismatic"),),
    "two sliding fingers on a hand, one mimics the other": (
        joint("hand_joint", "link_6", "fixed", "hand"),
        joint("left", "hand", "prismatic"),
        joint("right", "hand", "prismatic", inner='<mimic joint="left"/>'),
    ),
    "a turning jaw that mimics a sliding one": (
        joint("slide", "link_6", "prismatic"),
        joint("turn", "slide_link", "revolute", inner='<mimic joint="slide"/>'),
    ),
    "a hose that floats": (joint("hose", "link_3", "floating"),),
    "a frame that is fixed": (joint("flange_joint", "link_6", "fixed", "tool0"),),
}


@pytest.mark.parametrize("more", CLEAR.values(), ids=CLEAR.keys())
def test_what_no_drive_turns_is_fixed_at_zero_and_listed_once(more: Sequence[str]):
    text = arm(1, *more)
    robot = robot_from_urdf(text, "r.urdf")
    assert robot.joint_names == tuple(f"joint_{i}" for i in range(1, 7))
    assert_torque_as_pinocchio(text, robot)
    movable = re.findall(r'<joint name="(?!joint_)([^"]*)" type="(?!fixed)', text)
    listed = [remark for remark in robot.remarks if "fixed at zero" in remark]
    assert len(listed) == (1 if movable else 0)
    assert all(f"'{name}'" in listed[0] for name in movable)


@pytest.mark.parametrize("kind", ["prismatic", "floating", "planar"])
def test_an_arm_on_a_track_is_read_with_the_track_at_zero(kind: str):
    text = on_a_track(arm(2), kind)
    robot = robot_from_urdf(text, "r.urdf")
    assert robot.axes == 6
    assert robot.remarks == (f"r.urdf: joints taken as fixed at zero: 'track' ({kind})",)
    if kind == "prismatic":
        assert_torque_as_pinocchio(text, robot)


def test_a_branch_that_turns_is_refused_with_the_tip_to_type_and_read_with_it():
    text = arm(3, joint("rocker", "link_1", "revolute"), joint("rod", "rocker_link", "revolute"))
    with pytest.raises(
        ConfigError, match=r"'rocker' and 'joint_2' both start at link 'link_1'.*--tip link_6"
    ) as caught:
        robot_from_urdf(text, "r.urdf")
    assert 'tip = "link_6"' in str(caught.value)
    robot = robot_from_urdf(text, "r.urdf", "link_6")
    assert_torque_as_pinocchio(text, robot)
    assert "'rocker' (revolute), 'rod' (revolute)" in robot.remarks[0]


GRIPPERS = {
    "beyond a flange": (joint("f", "link_6", "fixed", "tool0"), joint("motor", "tool0", "revolute")),
    "beyond a prefixed flange": (joint("f", "link_6", "fixed", "left_flange"), joint("m", "left_flange", "revolute")),
    "on a hand": (joint("f", "link_6", "fixed", "hand"), joint("fj1", "hand", "revolute", "f1")),
    "by the joint's name": (joint("jaw_joint", "link_6", "revolute", "part"),),
    "by the link's name": (joint("joint_7", "link_6", "continuous", "left_finger"),),
}


@pytest.mark.parametrize("more", GRIPPERS.values(), ids=GRIPPERS.keys())
def test_a_turning_jaw_is_no_seventh_axis_unless_its_link_is_named(more: Sequence[str]):
    text = arm(4, *more)
    with pytest.raises(ConfigError, match=r"axis 7 of the arm.*--tip link_6,"):
        robot_from_urdf(text, "r.urdf")
    robot = robot_from_urdf(text, "r.urdf", "link_6")
    assert robot.axes == 6
    assert_torque_as_pinocchio(text, robot)
    last = re.findall(r'<child link="([^"]*)"', "".join(more))[-1]
    assert robot_from_urdf(text, "r.urdf", last).axes == 7


def test_two_jaws_that_turn_are_a_branch():
    text = arm(4, joint("left", "link_6", "revolute"), joint("right", "link_6", "revolute"))
    with pytest.raises(ConfigError, match="--tip link_6,"):
        robot_from_urdf(text, "r.urdf")
    assert robot_from_urdf(text, "r.urdf", "link_6").axes == 6


def test_the_tip_to_type_is_the_arm_s_where_a_rocker_and_a_jaw_are_in_the_file():
    jaw = (joint("to_hand", "link_6", "fixed", "tool0"), joint("motor", "tool0", "revolute"))
    text = arm(4, joint("rocker", "link_1", "revolute"), *jaw)
    with pytest.raises(ConfigError, match="--tip link_6,"):
        robot_from_urdf(text, "r.urdf")


def test_numbers_that_are_none_are_refused_with_how_they_are_written():
    with pytest.raises(ConfigError, match=r"'3,1' is not a number; write a number such as 3\.1"):
        robot_from_urdf(arm(0).replace('upper="3"', 'upper="3,1"', 1), "r.urdf")


def test_a_tip_in_the_middle_ends_the_arm_there():
    text = arm(5)
    robot = robot_from_urdf(text, "r.urdf", "link_4")
    assert robot.link_names == ("link_1", "link_2", "link_3", "link_4")
    assert_torque_as_pinocchio(text, robot)


def test_a_tip_that_is_a_fixed_frame_ends_at_the_link_before_it():
    text = arm(5, joint("f", "link_6", "fixed", "tool0"), joint("motor", "tool0", "revolute"))
    robot = robot_from_urdf(text, "r.urdf", "tool0")
    assert robot.link_names[-1] == "link_6"
    assert [name for name, _ in robot.frames] == ["tool0"]


def test_a_tip_that_is_not_there_is_refused_with_names_like_it():
    with pytest.raises(ConfigError, match=r"no link 'link6'.*link_6"):
        robot_from_urdf(arm(0), "r.urdf", "link6")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace('name="joint_3" type="revolute"', 'name="joint_3" type="prismatic"'), "prismatic"),
        (lambda text: re.sub(r'(name="joint_3".*?)(</joint>)', rf"\1{MIMIC}\2", text, count=1), "mimics another"),
    ],
)
def test_a_slide_or_a_mimic_between_axes_is_refused_with_the_tip_before_it(change, says):
    with pytest.raises(ConfigError, match=rf"'joint_3' .*{says}.*between the axes of the arm.*--tip link_2"):
        robot_from_urdf(change(arm(0)), "r.urdf")


@pytest.mark.parametrize("kind", ["ball", "", "Revolute"])
def test_a_joint_of_a_type_that_is_none_is_refused(kind: str):
    text = arm(0).replace('name="joint_6" type="revolute"', f'name="joint_6" type="{kind}"')
    with pytest.raises(ConfigError, match=rf"'joint_6' is of type '{kind}'.*revolute"):
        robot_from_urdf(text, "r.urdf")


def test_more_than_eight_axes_are_refused_with_a_tip():
    with pytest.raises(ConfigError, match=r"9 moving joints.*--tip link_8"):
        robot_from_urdf(arm(0, axes=9), "r.urdf")


def test_a_closed_loop_and_a_file_of_many_joints_are_refused_in_time():
    loop = arm(0, '<link name="a"/><link name="b"/>').replace(
        "</robot>",
        '<joint name="x" type="revolute"><parent link="a"/><child link="b"/></joint>'
        '<joint name="y" type="revolute"><parent link="b"/><child link="a"/></joint></robot>',
    )
    assert robot_from_urdf(loop, "r.urdf").axes == 6
    with pytest.raises(ConfigError, match="closed loop"):
        robot_from_urdf(loop, "r.urdf", "b")
    links = "".join(f'<link name="l{i}"/>' for i in range(3001))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(3000)
    )
    with pytest.raises(ConfigError, match="3000 joints"):
        robot_from_urdf(f"<robot>{links}{joints}</robot>", "r.urdf")


def test_collision_geometry_without_a_size_is_left_out_and_named():
    shape = '<link name="link_2"><collision><geometry><box size="0 0 0"/></geometry></collision>'
    robot = robot_from_urdf(arm(0).replace('<link name="link_2">', shape), "r.urdf")
    assert robot.remarks == ("r.urdf: collision geometry left out: link 'link_2': <box> of size 0 0 0",)


def test_frames_fixed_to_the_last_link_are_listed_with_their_poses_in_it():
    text = arm(6, joint("a", "link_6", "fixed", "flange"), joint("b", "flange", "fixed", "tool0"))
    robot = robot_from_urdf(text, "r.urdf")
    model = pinocchio.buildModelFromXML(text)
    assert [name for name, _ in robot.frames] == ["flange", "tool0"]
    for name, pose in robot.frames:
        np.testing.assert_allclose(pose, model.frames[model.getFrameId(name)].placement.homogeneous, atol=1e-12)


def scaled(text: str, lengths: float = 1.0, masses: float = 1.0) -> str:
    """The same arm in other units, as an exporter writes it."""

    def times(factor: float):
        return lambda found: found[1] + " ".join(repr(float(v) * factor) for v in found[2].split()) + '"'

    text = re.sub(r'(xyz=")(?=[^"]*"\s*rpy)([^"]*)"', times(lengths), text)
    return re.sub(r'(<mass value=")([^"]*)"', times(masses), text)


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "in millimetres"), (100.0, "in centimetres or millimetres")])
def test_an_arm_in_another_unit_of_length_is_refused_with_it(factor: float, unit: str):
    with pytest.raises(ConfigError, match=rf"beyond 20 m: its lengths are {unit}; export it in metres"):
        robot_from_urdf(scaled(arm(0), lengths=factor), "r.urdf")


def test_centres_of_mass_in_millimetres_are_refused():
    text = re.sub(r'(<inertial><origin xyz=")([^"]*)"', r'\g<1>100 20 30"', arm(0), count=1)
    with pytest.raises(ConfigError, match="to a centre of mass"):
        robot_from_urdf(text, "r.urdf")


@pytest.mark.parametrize("seed", range(4))
def test_an_arm_in_grams_is_refused_and_one_of_steel_is_not(seed: int):
    with pytest.raises(ConfigError, match="its masses are in grams; export it in kilograms"):
        robot_from_urdf(scaled(arm(seed), masses=1000.0), "r.urdf")
    assert robot_from_urdf(scaled(arm(seed), masses=3.0), "r.urdf").axes == 6


def test_the_published_masses_of_large_and_small_arms_are_kilograms():
    """(axes, reach [m], mass of the moving links [kg]) of a desk arm, a cobot, a foundry arm and a turntable."""
    text = arm(0)
    for reach, mass in ((0.33, 4.5), (1.3, 28.0), (0.58, 20.0), (3.2, 3700.0), (4.7, 8000.0)):
        robot = robot_from_urdf(text, "r.urdf")
        length = reach / float(np.linalg.norm(robot.placement[1:, :3, 3], axis=1).sum())
        assert robot_from_urdf(scaled(text, length, mass / float(robot.mass_kg.sum())), "r.urdf").axes == 6
    table = scaled(arm(0, axes=2), 1e-3, 500.0 / 20.0)
    assert robot_from_urdf(table, "r.urdf").axes == 2
