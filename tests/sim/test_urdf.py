"""URDF: geometry against the published Denavit-Hartenberg rows, bodies against closed forms and pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from sim.urdf import SimBody, UrdfError, combine, principal_axes, read_chain, rotation_rpy, rpy_of, write_chain

ROWS = {
    "large": [
        (0.0, 0.0, 0.0, 0.0),
        (-90.0, 0.4, 0.0, -90.0),
        (0.0, 1.1, 0.0, 0.0),
        (-90.0, 0.23, 1.13456, 0.0),
        (90.0, 0.0, 0.0, 0.0),
        (-90.0, 0.0, 0.244, 0.0),
    ]
}


def modified_dh(alpha_deg: float, a: float, d: float, theta_rad: float) -> np.ndarray:
    """Craig's transform: Rot_x(alpha) Trans_x(a) Rot_z(theta) Trans_z(d)."""
    alpha = np.radians(alpha_deg)
    along_x, along_z = np.eye(4), np.eye(4)
    along_x[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    along_x[0, 3] = a
    along_z[:2, :2] = [[np.cos(theta_rad), -np.sin(theta_rad)], [np.sin(theta_rad), np.cos(theta_rad)]]
    along_z[2, 3] = d
    return along_x @ along_z


def test_the_large_arm_has_the_published_geometry(arm_of):
    rng = np.random.default_rng(0)
    chain = arm_of("large").chain
    for q in rng.uniform(-2, 2, (20, 6)):
        ours, published = np.eye(4), np.eye(4)
        for i, (alpha, a, d, offset) in enumerate(ROWS["large"]):
            turn = np.eye(4)
            turn[:3, :3] = rotation_rpy((0.0, 0.0, q[i]))
            ours = ours @ chain.placement[i] @ turn
            published = published @ modified_dh(alpha, a, d, q[i] + np.radians(offset))
        np.testing.assert_allclose(ours, published, atol=1e-9)


@pytest.mark.parametrize("name", ["large", "small"])
def test_examples_load_in_pinocchio_with_the_same_bodies(name, arm_of):
    chain = arm_of(name).chain
    model = pinocchio.buildModelFromXML(write_chain(chain))
    for body, inertia in zip(chain.bodies, list(model.inertias)[1:], strict=True):
        assert inertia.mass == pytest.approx(body.mass_kg)
        np.testing.assert_allclose(inertia.lever, body.com_m, atol=1e-12)
        np.testing.assert_allclose(inertia.inertia, body.inertia_kg_m2, atol=1e-9)


def test_two_bodies_become_one_as_in_pinocchio():
    first = SimBody(12.0, np.array([0.1, -0.2, 0.05]), np.diag([0.3, 0.2, 0.4]))
    second = SimBody(
        5.0, np.array([-0.1, 0.3, 0.2]), np.array([[0.2, 0.02, 0.0], [0.02, 0.25, 0.01], [0.0, 0.01, 0.3]])
    )
    both = combine(first, second)
    oracle = pinocchio.Inertia(12.0, first.com_m, first.inertia_kg_m2)
    oracle += pinocchio.Inertia(5.0, second.com_m, second.inertia_kg_m2)
    assert both.mass_kg == pytest.approx(oracle.mass)
    np.testing.assert_allclose(both.com_m, oracle.lever, atol=1e-14)
    np.testing.assert_allclose(both.inertia_kg_m2, oracle.inertia, atol=1e-14)


def test_principal_axes_give_the_tensor_back():
    body = SimBody(1.0, np.zeros(3), np.array([[0.5, 0.1, -0.05], [0.1, 0.7, 0.02], [-0.05, 0.02, 0.9]]))
    moments, frame = principal_axes(body)
    axes = frame[:3, :3]
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, body.inertia_kg_m2, atol=1e-12)


@pytest.mark.parametrize("rpy", [(0.1, -0.4, 2.0), (0.3, np.pi / 2, 0.2), (-0.3, -np.pi / 2, 0.0)])
def test_roll_pitch_yaw_and_back(rpy):
    rotation = rotation_rpy(rpy)
    np.testing.assert_allclose(rotation_rpy(rpy_of(rotation)), rotation, atol=1e-9)


def test_a_chain_survives_writing_and_reading(arm_of):
    chain = arm_of("small").chain
    again = read_chain(write_chain(chain), "again")
    np.testing.assert_allclose(again.placement, chain.placement, atol=1e-9)
    np.testing.assert_allclose(again.upper_rad, chain.upper_rad)
    np.testing.assert_allclose([b.mass_kg for b in again.bodies], [b.mass_kg for b in chain.bodies])


def test_a_body_on_a_fixed_joint_belongs_to_the_link_that_carries_it(arm_of):
    text = write_chain(arm_of("small").chain)
    flange = """
      <link name="flange"><inertial><origin xyz="0 0 0.01"/><mass value="0.5"/>
        <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="f" type="fixed"><parent link="link_6"/><child link="flange"/><origin xyz="0 0 0.1"/></joint>
    </robot>"""
    chain = read_chain(text.replace("</robot>", flange), "with flange")
    before, after = arm_of("small").chain.bodies[5], chain.bodies[5]
    assert after.mass_kg == pytest.approx(before.mass_kg + 0.5)
    expected = (before.mass_kg * before.com_m + 0.5 * np.array([0, 0, 0.11])) / after.mass_kg
    np.testing.assert_allclose(after.com_m, expected, atol=1e-12)


MORE = """
  <link name="cylinder"><inertial><origin xyz="0 0 0.1"/><mass value="3"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="balancer" type="revolute"><parent link="link_1"/><child link="cylinder"/><axis xyz="0 1 0"/>
    <mimic joint="joint_2" multiplier="-0.4"/></joint>
  <link name="left"/><joint name="slide" type="prismatic"><parent link="link_6"/><child link="left"/></joint>
  <sensor:camera/>
</robot>"""
JAW = '<link name="jaw"/><joint name="j7" type="revolute"><parent link="link_6"/><child link="jaw"/></joint></robot>'


def test_what_no_servo_drives_is_at_zero_and_the_tip_ends_the_arm(arm_of):
    plain = write_chain(arm_of("small").chain)
    chain = read_chain(plain.replace("</robot>", MORE), "more")
    assert len(chain.axis) == 6
    assert chain.bodies[0].mass_kg == pytest.approx(arm_of("small").chain.bodies[0].mass_kg + 3.0)
    assert len(read_chain(plain.replace("</robot>", JAW), "jaw").axis) == 7
    assert len(read_chain(plain.replace("</robot>", JAW), "jaw", "link_6").axis) == 6
    with pytest.raises(UrdfError, match="no link 'link6'"):
        read_chain(plain, "plain", "link6")


def test_a_file_in_the_encoding_it_declares_is_read(arm_of):
    text = write_chain(arm_of("small").chain, "Gelenkärmchen").replace("?>", ' encoding="ISO-8859-1"?>', 1)
    assert len(read_chain(text.encode("iso-8859-1"), "latin").axis) == 6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "not readable as XML"),
        ("<robot name='r'><link name='a'/></robot>", "0 revolute joints"),
        ("<robot name='r'/>", "0 links have no parent"),
    ],
)
def test_useless_descriptions_are_refused(text, words):
    with pytest.raises(UrdfError, match=words):
        read_chain(text, "r.urdf")


def test_a_body_that_cannot_exist_is_refused(arm_of):
    chain = arm_of("small").chain
    impossible = SimBody(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.9]))
    broken = type(chain)(
        **{n: getattr(chain, n) for n in chain.__slots__} | {"bodies": (impossible, *chain.bodies[1:])}
    )
    with pytest.raises(UrdfError, match="not a rigid body"):
        write_chain(broken)
