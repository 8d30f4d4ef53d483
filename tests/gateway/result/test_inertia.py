"""Principal axes, angles and quaternions against scipy; which tensors a body can have."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.result.inertia import has_a_body, moments_of, principal_axes, quaternion, tensor_of, zyx_degrees


def turns():
    yield from Rotation.random(40, random_state=5).as_matrix()
    yield np.eye(3)
    for axis in "xyz":
        for angle in (90.0, 180.0, -90.0):
            yield Rotation.from_euler(axis, angle, degrees=True).as_matrix()


def test_angles_and_quaternions_give_the_rotation_back():
    for turn in turns():
        again = Rotation.from_euler("ZYX", zyx_degrees(turn), degrees=True).as_matrix()
        assert again == pytest.approx(turn, abs=1e-9)
        w, x, y, z = quaternion(turn)
        assert w >= 0.0
        assert Rotation.from_quat([x, y, z, w]).as_matrix() == pytest.approx(turn, abs=1e-9)


def test_principal_axes_are_a_rotation_that_gives_the_tensor_back():
    for turn in turns():
        tensor = turn @ np.diag([0.3, 0.5, 0.4]) @ turn.T
        moments, axes = principal_axes(tensor)
        assert sorted(moments) == pytest.approx([0.3, 0.4, 0.5])
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert axes @ np.diag(moments) @ axes.T == pytest.approx(tensor)
        assert tensor_of(moments_of(tensor)) == pytest.approx(tensor)


def test_axes_that_are_principal_already_keep_their_names():
    moments, axes = principal_axes(np.diag([0.5, 0.3, 0.4]))
    assert moments == pytest.approx([0.5, 0.3, 0.4])
    assert axes == pytest.approx(np.eye(3))


@pytest.mark.parametrize(
    ("moments", "body"),
    [((0.3, 0.5, 0.4), True), ((0.2, 0.2, 0.4), True), ((0.1, 0.2, 0.4), False), ((-0.1, 0.5, 0.4), False)],
)
def test_a_body_has_no_negative_moment_and_none_above_the_sum_of_the_others(moments, body):
    turn = Rotation.from_euler("ZYX", [10.0, 20.0, 30.0], degrees=True).as_matrix()
    assert has_a_body(turn @ np.diag(moments) @ turn.T) == body
    assert not has_a_body(np.full((3, 3), np.nan))
