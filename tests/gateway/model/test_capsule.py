"""Capsules contain the shapes they stand for, and barely more."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from gateway.model.mesh import MeshError
from gateway.model.robot import LinkShape
from gateway.model.solid import Capsule, capsule_around, capsule_of
from gateway.model.urdf_shapes import Box, Cylinder, Mesh, Sphere

#: A turn of 90 degrees about x and a shift: the shape's z points along -y of the link.
POSE = np.array([[1.0, 0, 0, 0.1], [0, 0, -1, 0.2], [0, 1, 0, 0.3], [0, 0, 0, 1]])


def distance(capsule: Capsule, point: np.ndarray) -> float:
    along = capsule.end_m - capsule.start_m
    length = float(along @ along)
    share = np.clip((point - capsule.start_m) @ along / length, 0.0, 1.0) if length else 0.0
    return float(np.linalg.norm(point - capsule.start_m - share * along))


def in_link(points: np.ndarray) -> np.ndarray:
    return points @ POSE[:3, :3].T + POSE[:3, 3]


def test_sphere_is_its_own_capsule():
    capsule = capsule_of(LinkShape(POSE, Sphere(0.4), True), "r.urdf")
    assert np.array_equal(capsule.start_m, capsule.end_m)
    assert capsule.start_m == pytest.approx([0.1, 0.2, 0.3])
    assert capsule.radius_m == 0.4


def test_cylinder_ends_half_its_length_from_its_middle():
    capsule = capsule_of(LinkShape(POSE, Cylinder(radius_m=0.05, length_m=0.6), True), "r.urdf")
    assert {tuple(np.round(end, 9)) for end in (capsule.start_m, capsule.end_m)} == {(0.1, -0.1, 0.3), (0.1, 0.5, 0.3)}
    assert capsule.radius_m == 0.05


def test_box_is_inside_a_capsule_along_its_longest_side():
    size = (0.2, 0.9, 0.4)
    capsule = capsule_of(LinkShape(POSE, Box(size), True), "r.urdf")
    corners = in_link(np.array(list(itertools.product(*[(-side / 2, side / 2) for side in size]))))
    assert max(distance(capsule, corner) for corner in corners) == pytest.approx(capsule.radius_m)
    assert capsule.radius_m == pytest.approx(np.hypot(0.1, 0.2))
    assert np.linalg.norm(capsule.end_m - capsule.start_m) == pytest.approx(0.9)


def test_mesh_is_inside_its_capsule_where_the_link_has_it(tmp_path: Path):
    points = np.array([[0.0, 0, 0], [2.0, 0, 0], [2.0, 0.2, 0], [0.0, 0.2, 0.1], [1.0, 0.1, -0.1]])
    faces = ["f 1 2 3", "f 1 3 4", "f 1 2 5", "f 2 3 5", "f 3 4 5", "f 4 1 5"]
    lines = [f"v {x} {y} {z}" for x, y, z in points] + faces
    (tmp_path / "body.obj").write_text("\n".join(lines) + "\n")
    body = LinkShape(POSE, Mesh("body.obj", (0.5, 0.5, 0.5)), True)
    capsule = capsule_of(body, str(tmp_path / "robot.urdf"))
    inside = in_link(0.5 * points)
    assert max(distance(capsule, point) for point in inside) <= capsule.radius_m * (1 + 1e-9)
    assert capsule.radius_m < 0.12
    with pytest.raises(MeshError):
        capsule_of(LinkShape(POSE, Mesh("gone.obj", (1.0, 1.0, 1.0)), True), str(tmp_path / "robot.urdf"))


@pytest.mark.parametrize("seed", range(12))
def test_a_capsule_goes_with_its_points_wherever_they_are(seed: int):
    """Which of the axes is taken depends on the points alone, not on where the link's frame is."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 3)) * rng.uniform(0.2, 1.0, 3)
    shift = 10.0 * rng.normal(size=3)
    here, there = capsule_around(points), capsule_around(points + shift)
    assert there.radius_m == pytest.approx(here.radius_m)
    ends = {tuple(np.round(end, 6)) for end in (here.start_m, here.end_m)}
    assert {tuple(np.round(end - shift, 6)) for end in (there.start_m, there.end_m)} == ends


def test_a_capsule_about_points_far_from_the_origin_is_barely_larger_than_they_need():
    """A three-cornered bar: the circle about an equilateral triangle of side a has the radius a / sqrt 3."""
    angle = np.deg2rad([90.0, 210.0, 330.0])
    corners = 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [2.0, -3.0]
    points = np.array([[x, y, z] for x, y in corners for z in np.linspace(0.0, 1.0, 11)])
    capsule = capsule_around(points)
    assert max(distance(capsule, point) for point in points) <= capsule.radius_m * (1 + 1e-9)
    assert capsule.radius_m == pytest.approx(0.1, rel=0.03)
