"""How thick an arm is: collision geometry, meshes, stated and assumed radii; every shape is inside its capsules."""

import struct

import numpy as np
import pytest

from gateway.model.arm_model import arm_robot, robot_from_text, robot_text
from gateway.model.mesh import MeshError, find_mesh, read_vertices
from gateway.model.robot import reach_m
from gateway.model.solid import capsule_around
from gateway.motion.body import body_of_parts, moving_parts
from gateway.motion.workspace import workspace_of

SHIFTED = '<origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/>'


def arm_of(cell, **changed):
    return cell.cell.arm[0].model_copy(update=changed)


def with_shape(cell, link: int, shape: str, place: str = SHIFTED) -> str:
    text = robot_text(cell, cell.cell.arm[0])
    collision = f"<collision>{place}<geometry>{shape}</geometry></collision>"
    head = f'<link name="link_{link}">'
    assert head in text
    return text.replace(head, head + collision)


def outside_by(capsules: list, points: np.ndarray) -> float:
    """How far the farthest of the points is outside all capsules [m]."""
    gap = np.full(len(points), np.inf)
    for start, end, radius in capsules:
        segment = end - start
        share = np.clip((points - start) @ segment / max(segment @ segment, 1e-30), 0, 1)
        gap = np.minimum(gap, np.linalg.norm(points - start - share[:, None] * segment, axis=1) - radius)
    return float(gap.max())


def body_of(arm, robot):
    return body_of_parts(moving_parts(arm, robot))


def source_of(body, name: str) -> str:
    return next(part.source for part in body.parts if part.name == name)


def capsules_of(body, name: str) -> list:
    rows = [row for row, part in enumerate(body.part) if body.parts[part].name == name]
    return [(body.start_m[row], body.end_m[row], body.radius_m[row]) for row in rows]


def placed(points: np.ndarray) -> np.ndarray:
    """Points of the shape's frame in the link, by a rotation computed here: Rz Ry Rx."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (0.4, -0.5, 0.6))
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return points @ (rz @ ry @ rx).T + [0.1, 0.2, 0.3]


def ball(count: int = 3000) -> np.ndarray:
    points = np.random.default_rng(1).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def rim(radius: float, length: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 400)
    circle = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(400, length / 2)])
    return np.vstack([circle, circle * [1, 1, -1]])


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2


@pytest.mark.parametrize(
    ("shape", "surface", "radius_m"),
    [
        ('<sphere radius="0.2"/>', 0.2 * ball(), 0.2),
        ('<cylinder radius="0.1" length="0.6"/>', rim(0.1, 0.6), 0.1),
        ('<box size="0.1 0.5 0.2"/>', CORNERS * [0.1, 0.5, 0.2], np.hypot(0.1, 0.2) / 2),
        ('<box size="0.3 0.2 0.7"/>', CORNERS * [0.3, 0.2, 0.7], np.hypot(0.3, 0.2) / 2),
    ],
)
def test_shapes_lie_inside_their_capsules(small_cell, shape, surface, radius_m):
    arm = arm_of(small_cell)
    body = body_of(arm, robot_from_text(arm, with_shape(small_cell, 4, shape), "robot.urdf"))
    capsules = capsules_of(body, "link 4")
    assert len(capsules) == 1
    assert outside_by(capsules, placed(surface)) < 1e-9
    assert capsules[0][2] == pytest.approx(radius_m)
    assert source_of(body, "link 4") == "collision geometry of the URDF"
    assert "assumed" in source_of(body, "link 3")


def test_what_is_fixed_to_a_link_moves_with_it(small_cell):
    """A tool of its own link: its shape counts to link 6, which itself has none and stays assumed."""
    arm = arm_of(small_cell)
    tool = (
        '<link name="tool"><collision><geometry><sphere radius="0.07"/></geometry></collision></link>'
        '<joint name="mount" type="fixed"><parent link="link_6"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>'
    )
    text = robot_text(small_cell, arm).replace("</robot>", tool + "</robot>")
    body = body_of(arm, robot_from_text(arm, text, "robot.urdf"))
    capsules = capsules_of(body, "link 6")
    assert len(capsules) == 2
    assert capsules[0][0] == pytest.approx([0, 0, 0.4])
    assert capsules[0][2] == 0.07
    assert "assumed" in source_of(body, "link 6")


def binary_stl(triangles: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *map(float, corners.ravel()), 0) for corners in triangles)
    return b"solid but binary all the same".ljust(80) + struct.pack("<I", len(triangles)) + rows


def text_stl(triangles: np.ndarray) -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"  vertex {x} {y} {z}\n" for x, y, z in corners) + "endloop\n"
        for corners in triangles
    )
    return f"solid part\n{facets}endsolid\n".encode()


def obj(triangles: np.ndarray) -> bytes:
    rows = [f"v {x} {y} {z}" for x, y, z in triangles.reshape(-1, 3)]
    return ("# part\n" + "\n".join(rows) + "\nvn 0 0 1\nf 1 2 3\n").encode()


TRIANGLES = np.random.default_rng(3).normal(size=(60, 3, 3)).astype(np.float32) * [100, 30, 20]


@pytest.mark.parametrize(("name", "write"), [("a.stl", binary_stl), ("b.STL", text_stl), ("c.obj", obj)])
def test_meshes_are_read_and_lie_inside_their_capsules(small_cell, tmp_path, name, write):
    """In mm, scaled by the URDF; the capsule is not much wider than the mesh."""
    (tmp_path / name).write_bytes(write(TRIANGLES))
    text = with_shape(small_cell, 4, f'<mesh filename="{name}" scale="0.001 0.001 0.001"/>')
    arm = arm_of(small_cell)
    body = body_of(arm, robot_from_text(arm, text, str(tmp_path / "robot.urdf")))
    points = TRIANGLES.reshape(-1, 3) * 0.001
    capsules = capsules_of(body, "link 4")
    assert outside_by(capsules, placed(points)) < 1e-6
    across = np.linalg.norm(points[:, 1:], axis=1).max()
    assert capsules[0][2] < 1.25 * across
    assert source_of(body, "link 4") == "collision geometry of the URDF"


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("none.stl", None, "none.stl cannot be read"),
        ("part.dae", b"<COLLADA/>", "part.dae is not an STL or OBJ file"),
        ("cut.stl", binary_stl(TRIANGLES)[:-7], "cut.stl has no vertices"),
        ("bad.obj", b"v 1 2 three\n", "bad.obj has a vertex that is not three numbers"),
        ("two.obj", b"v 1 2\nv 1 2 3\n", "two.obj has a vertex that is not three numbers"),
        ("nan.obj", b"v 1 2 nan\n", "nan.obj has no vertices, or vertices that are not numbers"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_not_guessed(small_cell, tmp_path, name, data, words):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(MeshError, match=words):
        read_vertices(tmp_path / name)
    text = with_shape(small_cell, 4, f'<mesh filename="{name}"/>')
    arm = arm_of(small_cell, link_radius_m=0.08)
    body = body_of(arm, robot_from_text(arm, text, str(tmp_path / "robot.urdf")))
    assert [radius for _, _, radius in capsules_of(body, "link 4")] == [0.08]
    assert source_of(body, "link 4").startswith(f"0.08 m, arm.link_radius_m ({words[:8]}")


def test_meshes_of_a_package_are_found_above_the_urdf(tmp_path):
    (tmp_path / "arm" / "urdf").mkdir(parents=True)
    (tmp_path / "arm" / "meshes").mkdir()
    mesh = tmp_path / "arm" / "meshes" / "a.stl"
    mesh.write_bytes(binary_stl(TRIANGLES))
    urdf = str(tmp_path / "arm" / "urdf" / "robot.urdf")
    assert find_mesh("package://arm/meshes/a.stl", urdf) == mesh
    assert find_mesh(f"file://{mesh}", urdf) == mesh
    assert find_mesh("../meshes/a.stl", urdf).resolve() == mesh


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.eye(3)[:2], np.eye(3), CORNERS * [1, 1, 0]])
def test_few_and_flat_points_have_a_capsule(points):
    capsule = capsule_around(points)
    assert outside_by([(capsule.start_m, capsule.end_m, capsule.radius_m)], points) < 1e-9


def test_an_unknown_shape_leaves_the_stated_radius(small_cell):
    arm = arm_of(small_cell)
    body = body_of(arm, robot_from_text(arm, with_shape(small_cell, 4, "<torus/>"), "robot.urdf"))
    assert "assumed" in source_of(body, "link 4")
    assert "<torus> is not known" in source_of(body, "link 4")


@pytest.mark.parametrize("shape", ['<sphere radius="0"/>', '<box size="1 -1 1"/>', '<cylinder radius="1"/>'])
def test_a_shape_without_its_size_leaves_an_assumed_radius_and_is_named(small_cell, shape):
    arm = arm_of(small_cell)
    robot = robot_from_text(arm, with_shape(small_cell, 4, shape), "robot.urdf")
    assert "collision geometry left out: link 'link_4': <" in robot.remarks[0]
    source = source_of(body_of(arm, robot), "link 4")
    assert source.startswith(f"{0.05 * reach_m(robot):.3f} m, assumed")
    assert "has no size" in source


def test_stated_radii_go_from_joint_to_joint(small_cell):
    arm = arm_of(small_cell, link_radius_m=(0.2, 0.11, 0.1, 0.09, 0.08, 0.07))
    robot = arm_robot(small_cell, arm)
    body = body_of(arm, robot)
    assert [part.name for part in body.parts] == [*(f"link {number}" for number in range(1, 7)), "load"]
    assert body.radius_m.tolist() == [0.2, 0.11, 0.1, 0.09, 0.08, 0.07, 0.07]
    for link in range(2, 5):
        ((start, end, _),) = capsules_of(body, f"link {link + 1}")
        assert start.tolist() == [0, 0, 0]
        assert end == pytest.approx(robot.placement[link + 1, :3, 3])
    ((start, end, _),) = capsules_of(body, "link 2")
    assert np.linalg.norm(start) == pytest.approx(0.11)
    assert end == pytest.approx(robot.placement[2, :3, 3])
    assert capsules_of(body, "link 6")[0][1] == pytest.approx(robot.flange[:3, 3])


def test_what_is_assumed_is_said(small_cell):
    arm = arm_of(small_cell, floor_m=None, column_radius_m=None)
    workspace = workspace_of(arm, arm_robot(small_cell, arm))
    body = workspace.space.body
    radius_m = 0.05 * reach_m(workspace.robot)
    assert source_of(body, "link 1").startswith("0.066 m, assumed: 0.05 x reach; give arm.link_radius_m")
    assert capsules_of(body, "link 1")[0][2] == pytest.approx(radius_m)
    assert source_of(body, "load") == "a ball of 0.132 m on the flange, assumed; give arm.load_size_m"
    assert (
        source_of(body, "column") == "radius 0.132 m, assumed; give arm.column_radius_m, or false where there is none"
    )
    assert [plane.source for plane in workspace.space.planes] == [
        "0.000 m, assumed; give arm.floor_m, or false where there is none"
    ]
    ((start, end, thick),) = capsules_of(body, "load")
    flange = workspace.robot.flange
    assert start == pytest.approx(flange[:3, 3] + radius_m * flange[:3, 2])
    assert (end == start).all()
    assert thick == pytest.approx(radius_m)


def test_a_load_has_points_and_thickness(small_cell):
    points = ((0.3, 0.0, 0.2), (-0.3, 0.0, 0.2))
    robot = arm_robot(small_cell, small_cell.cell.arm[0])
    for stated, radius in ((0.0, 0.0), (0.04, 0.04), (None, 0.05 * reach_m(robot))):
        body = body_of(arm_of(small_cell, load_points_m=points, load_radius_m=stated), robot)
        capsules = capsules_of(body, "load")
        assert [tuple(end) for _, end, _ in capsules] == list(points)
        for start, _, thick in capsules:
            assert start == pytest.approx(robot.flange[:3, 3])
            assert thick == pytest.approx(radius)
