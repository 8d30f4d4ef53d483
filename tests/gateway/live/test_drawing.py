"""Bodies as the page draws them: closed, seen from outside, few corners; what is assumed is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.cell.config import LoadedCell, parse_cell
from gateway.live.drawing import DIRECTIONS, shown_arm, shown_body
from gateway.live.wire import ShownBody
from gateway.model.arm_model import arm_robot
from gateway.model.solid import Capsule, Solid, capsule_around, solid_box, solid_capsule
from gateway.motion.workspace import workspace_of

MESH = '<collision><geometry><mesh filename="package://arm/meshes/lost.stl"/></geometry></collision>'


def volume(body: ShownBody) -> float:
    """By the divergence theorem: right only where every face is closed and looks outwards."""
    total = 0.0
    for face in body.faces:
        first = body.points_m[face[0]]
        for second, third in zip(face[1:-1], face[2:], strict=True):
            total += float(np.dot(first, np.cross(body.points_m[second], body.points_m[third]))) / 6.0
    return total


def test_a_box_has_six_faces_and_its_volume():
    pose = np.eye(4)
    pose[:3, 3] = 0.3, -0.2, 0.1
    body = shown_body(2, solid_box(np.array([0.1, 0.2, 0.4]), pose))
    assert len(body.faces) == 6
    assert {len(face) for face in body.faces} == {4}
    assert volume(body) == pytest.approx(0.1 * 0.2 * 0.4)


@pytest.mark.parametrize("length_m", [0.0, 0.5])
def test_a_capsule_is_drawn_a_little_smaller_than_it_is(length_m):
    start = np.array([0.1, 0.0, 0.2])
    body = shown_body(0, solid_capsule(Capsule(start, start + [0.0, length_m, 0.0], 0.1)))
    volume_m3 = np.pi * 0.1**2 * length_m + 4.0 / 3.0 * np.pi * 0.1**3
    assert 0.85 * volume_m3 < volume(body) < volume_m3


def test_a_fine_mesh_is_drawn_with_few_corners():
    points = np.random.default_rng(3).normal(size=(20_000, 3))
    points = 0.2 * points / np.linalg.norm(points, axis=1)[:, None]
    body = shown_body(0, Solid(points, 0.0, capsule_around(points[:50])))
    assert len(body.points_m) <= DIRECTIONS
    assert volume(body) == pytest.approx(4.0 / 3.0 * np.pi * 0.2**3, rel=0.12)


def test_a_flat_body_is_drawn_as_the_capsule_around_it():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    assert volume(shown_body(0, Solid(points, 0.0, capsule_around(points)))) > 0.0


def test_a_missing_mesh_is_reported_and_replaced_by_a_capsule(small_cell, tmp_path):
    """The page is shown all the same; what is drawn in place of the mesh is named."""
    robot = (small_cell.folder / "robot.urdf").read_text(encoding="utf-8")
    marked = robot.replace('<link name="link_3">', f'<link name="link_3">{MESH}', 1)
    assert marked != robot
    (tmp_path / "robot.urdf").write_text(marked, encoding="utf-8")
    loaded = LoadedCell(cell=parse_cell(small_cell.text, "cell.toml"), text=small_cell.text, folder=tmp_path)
    config = loaded.cell.arm[0]
    arm = shown_arm("main", workspace_of(config, arm_robot(loaded, config)))
    (line,) = [each for each in arm.assumed if each.startswith("link 3")]
    assert "lost.stl" in line
    assert any(body.link == 2 for body in arm.bodies)


def test_an_arm_without_known_links_shows_no_model(workspace):
    assert shown_arm("main", workspace).modelled
    assert not shown_arm("main", replace(workspace, links=None)).modelled
