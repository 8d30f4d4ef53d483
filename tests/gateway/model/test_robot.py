"""Reading an arm: against pinocchio's kinematics and inertias, DH against the written-out products, bad files."""

import re
from types import SimpleNamespace

import numpy as np
import pinocchio
import pytest

from gateway.errors import ConfigError
from gateway.model import kinematics
from gateway.model.robot import (
    link_lengths_m,
    reach_m,
    robot_from_dh,
    robot_from_urdf,
    rotation_rpy,
    with_flange,
)
from tests.data.arms import peer_of


def rot(axis, angle):
    pose = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "z": (0, 1)}[axis]
    pose[i, i] = pose[j, j] = c
    pose[i, j], pose[j, i] = -s, s
    return pose


def move(x, z):
    pose = np.eye(4)
    pose[0, 3], pose[2, 3] = x, z
    return pose


@pytest.mark.parametrize("seed", range(5))
def test_link_frames_agree_with_pinocchio(random_urdf, seed):
    text = random_urdf(seed)
    robot = robot_from_urdf(text, "random.urdf")
    model, data = peer_of(text)
    q = np.random.default_rng(seed + 100).uniform(-3, 3, (7, 6))
    frames = kinematics.link_frames(robot, q)
    axes, origins = kinematics.joint_axes_origins(robot, q)
    for row in range(len(q)):
        pinocchio.computeJointJacobians(model, data, q[row])
        for i in range(6):
            np.testing.assert_allclose(frames[row, i], data.oMi[i + 1].homogeneous, atol=1e-12)
            jacobian = pinocchio.getJointJacobian(model, data, i + 1, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(axes[row, i], jacobian[3:, i], atol=1e-12)
            np.testing.assert_allclose(origins[row, i], data.oMi[i + 1].translation, atol=1e-12)


def test_fixed_joints_are_merged_as_pinocchio_merges_them(random_urdf):
    text = random_urdf(3)
    text = re.sub(r'<parent link="base"/>', '<parent link="plinth"/>', text)
    text = re.sub(r'<parent link="link_2"/>', '<parent link="bracket"/>', text)
    extra = (
        '<link name="plinth"><inertial><mass value="9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial></link><joint name="down" type="fixed"><parent link="base"/><child link="plinth"/>'
        '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/></joint>'
        '<link name="bracket"><inertial><origin xyz="0.1 0 0" rpy="0.3 0 0"/><mass value="2"/>'
        '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.04"/></inertial></link>'
        '<joint name="bolt" type="fixed"><parent link="link_2"/><child link="bracket"/>'
        '<origin xyz="0.1 -0.2 0.3" rpy="0.5 0 0.2"/></joint>'
        '<link name="tool0"/><joint name="face" type="fixed"><parent link="link_6"/><child link="tool0"/></joint>'
    )
    text = text.replace("</robot>", extra + "</robot>")
    robot = robot_from_urdf(text, "merged.urdf")
    model, data = peer_of(text)
    q = np.random.default_rng(0).uniform(-3, 3, 6)
    pinocchio.forwardKinematics(model, data, q)
    np.testing.assert_allclose(kinematics.link_frames(robot, q[None])[0, 5], data.oMi[6].homogeneous, atol=1e-12)
    for i in range(6):
        inertia = model.inertias[i + 1]
        np.testing.assert_allclose(robot.mass_kg[i], inertia.mass, rtol=1e-12)
        np.testing.assert_allclose(robot.com_m[i], inertia.lever, atol=1e-12)
        np.testing.assert_allclose(robot.inertia_kg_m2[i], inertia.inertia, atol=1e-12)
    assert robot.link_names == tuple(f"link_{i}" for i in range(1, 7))


def test_modified_dh_is_the_product_of_its_rows(qh165_dh):
    robot = robot_from_dh(qh165_dh, "qh165")
    q = np.array([0.3, -0.5, 0.7, 1.1, -0.4, 2.0])
    pose = np.eye(4)
    for i in range(6):
        pose = pose @ rot("x", qh165_dh.alpha_rad[i]) @ move(qh165_dh.a_m[i], 0)
        pose = pose @ rot("z", q[i] + qh165_dh.theta_offset_rad[i]) @ move(0, qh165_dh.d_m[i])
        np.testing.assert_allclose(kinematics.link_frames(robot, q[None])[0, i], pose, atol=1e-12)
    assert np.isnan(robot.mass_kg).all()


def test_standard_dh_puts_link_6_and_the_axes_where_its_rows_do():
    rng = np.random.default_rng(1)
    table = SimpleNamespace(
        convention="standard",
        alpha_rad=rng.uniform(-2, 2, 6),
        a_m=[*rng.uniform(-1, 1, 5), 0.0],
        d_m=rng.uniform(-1, 1, 6),
        theta_offset_rad=rng.uniform(-2, 2, 6),
    )
    robot = robot_from_dh(table, "standard")
    q = rng.uniform(-3, 3, 6)
    axes, origins = kinematics.joint_axes_origins(robot, q[None])
    pose = np.eye(4)
    for i in range(6):
        np.testing.assert_allclose(axes[0, i], pose[:3, 2], atol=1e-12)
        np.testing.assert_allclose(np.cross(origins[0, i] - pose[:3, 3], pose[:3, 2]), 0, atol=1e-12)
        pose = pose @ rot("z", q[i] + table.theta_offset_rad[i]) @ move(0, table.d_m[i])
        pose = pose @ move(table.a_m[i], 0) @ rot("x", table.alpha_rad[i])
    np.testing.assert_allclose(kinematics.link_frames(robot, q[None])[0, 5], pose, atol=1e-12)


def test_flange_follows_link_6(random_urdf):
    robot = with_flange(robot_from_urdf(random_urdf(0), "r"), (0.0, 0.0, 0.1), (0.0, 0.0, np.pi / 2))
    q = np.zeros((1, 6))
    last = kinematics.link_frames(robot, q)[0, 5]
    flange = kinematics.flange_frames(robot, q)[0]
    np.testing.assert_allclose(flange[:3, 3], last[:3, 3] + 0.1 * last[:3, 2], atol=1e-12)
    np.testing.assert_allclose(flange[:3, 0], last[:3, 1], atol=1e-12)


def test_gravity_directions_and_their_angle(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    q = np.random.default_rng(0).uniform(-3, 3, (4, 6))
    seen = kinematics.gravity_in_last_link(robot, q)
    frames = kinematics.link_frames(robot, q)
    for row in range(4):
        np.testing.assert_allclose(frames[row, 5, :3, :3] @ seen[row], [0, 0, -1], atol=1e-12)
    assert kinematics.largest_angle_rad(np.array([[1.0, 0, 0], [0, 1.0, 0], [1.0, 0, 0]])) == pytest.approx(np.pi / 2)
    assert kinematics.largest_angle_rad(seen[:1]) == pytest.approx(0.0, abs=1e-7)


def test_a_link_without_inertial_is_unknown_and_limits_of_zero_are_not_given(random_urdf):
    text = re.sub(r'(<link name="link_2">)<inertial>.*?</inertial>', r"\1", random_urdf(0))
    text = text.replace('effort="100" velocity="2"', 'effort="0" velocity="0"')
    robot = robot_from_urdf(text, "r")
    assert np.isnan(robot.mass_kg[1])
    assert np.isnan(robot.com_m[1]).all()
    assert np.isfinite(robot.mass_kg[[0, 2, 3, 4, 5]]).all()
    assert np.isnan(robot.effort_nm).all()
    assert np.isnan(robot.velocity_rad_s).all()
    assert (robot.lower_rad == -3).all()


def test_link_lengths_reach_to_the_next_joint_the_centre_of_mass_or_the_flange(random_urdf):
    robot = robot_from_urdf(random_urdf(0), "r")
    lengths = link_lengths_m(robot)
    for i in range(6):
        step = np.linalg.norm(robot.placement[min(i + 1, 5), :3, 3])
        assert lengths[i] == pytest.approx(max(step, np.linalg.norm(robot.com_m[i]), 0.1))
    assert link_lengths_m(with_flange(robot, (0.0, 0.0, 3.0)))[5] == pytest.approx(3.0)
    assert reach_m(robot) == pytest.approx(np.linalg.norm(robot.placement[1:, :3, 3], axis=1).sum())


def test_rotation_of_roll_pitch_yaw_is_the_one_of_pinocchio():
    rpy = np.array([0.3, -0.7, 2.1])
    np.testing.assert_allclose(rotation_rpy(rpy), pinocchio.rpy.rpyToMatrix(rpy), atol=1e-14)


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>'


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text[:-3], "not readable as XML"),
        (lambda text: BOMB, "entity"),
        (lambda text: "<a>" * 500 + "</a>" * 500, "nested"),
        (lambda text: "<sdf/>", "<sdf>"),
        (
            lambda text: text.replace('name="joint_3" type="revolute"', 'name="joint_3" type="prismatic"'),
            "joint 'joint_3' is of type 'prismatic'; only revolute",
        ),
        (
            lambda text: re.sub(r'name="joint_(.)" type="revolute"', r'name="joint_\1" type="fixed"', text),
            "0 moving joints in its chain, 1 to 8",
        ),
        (lambda text: text.replace('<child link="link_3"/>', '<child link="nowhere"/>'), "'nowhere'"),
        (lambda text: text.replace('<child link="link_3"/>', '<child link="link_2"/>'), "child of two joints"),
        (
            lambda text: text.replace('<parent link="link_5"/>', '<parent link="link_4"/>'),
            "both start at link 'link_4'",
        ),
        (lambda text: text.replace('<parent link="base"/>', '<parent link="link_6"/>'), "0 moving joints"),
        (lambda text: text.replace('<link name="base"/>', '<link name="base"/><link name="spare"/>'), "one root link"),
        (lambda text: re.sub(r'<mass value="[^"]*"/>', '<mass value="-1"/>', text, count=1), "negative"),
        (lambda text: re.sub(r'<mass value="[^"]*"/>', '<mass value="nan"/>', text, count=1), "not finite"),
        (lambda text: re.sub(r'<mass value="[^"]*"/>', "<mass/>", text, count=1), "value is missing"),
        (lambda text: re.sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 0"', text, count=1), "zero vector"),
        (lambda text: re.sub(r'<axis xyz="[^"]*"', '<axis xyz="0 one 0"', text, count=1), "'one' is not a number"),
        (lambda text: re.sub(r'<axis xyz="[^"]*"', '<axis xyz="0 1"', text, count=1), "three numbers"),
        (lambda text: text.replace('name="joint_4"', 'name="joint_3"'), "two joints are named"),
    ],
)
def test_a_bad_urdf_is_refused_with_file_and_element(random_urdf, change, says):
    with pytest.raises(ConfigError) as caught:
        robot_from_urdf(change(random_urdf(0)), "cell/bad.urdf")
    assert says in str(caught.value)
    assert str(caught.value).startswith("cell/bad.urdf")


COLUMNS = ("alpha_rad", "a_m", "d_m", "theta_offset_rad")


@pytest.mark.parametrize(
    ("change", "says"),
    [({"convention": "khalil"}, "khalil"), ({"a_m": [0.0] * 5}, "per axis"), ({"d_m": [np.nan] * 6}, "finite"),
     ({key: [] for key in COLUMNS}, "has 0 rows"), ({key: [0.0] * 9 for key in COLUMNS}, "has 9 rows"),
     ({"convention": "standard", "a_m": [0.1] * 6}, "row 6")],
)  # fmt: skip
def test_a_bad_dh_table_is_refused(qh165_dh, change, says):
    with pytest.raises(ConfigError, match=says):
        robot_from_dh(SimpleNamespace(**(vars(qh165_dh) | change)), "bad")
