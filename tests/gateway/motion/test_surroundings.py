"""Surroundings of an arm, stated and assumed: floor, wall, column, the load's size, the arm itself."""

import itertools
from pathlib import Path

import coal
import numpy as np
import pytest

from gateway.acquire.plan import inward_steps
from gateway.acquire.planning import make_plan
from gateway.acquire.route import find_route
from gateway.cell.config import KeepOut, load_cell, parse_cell
from gateway.data.visit import RestPose
from gateway.errors import ConfigError, PlanRefused
from gateway.model.arm_model import arm_robot, robot_from_text, robot_text
from gateway.model.kinematics import flange_frames, link_frames
from gateway.model.robot import reach_m
from gateway.motion.clearance import SOLID
from gateway.motion.surroundings import outward, surroundings_of
from gateway.motion.workspace import workspace_of

NOTHING = {"keep_out": (), "floor_m": None, "column_radius_m": None}


def of(cell, **changed):
    arm = cell.cell.arm[0].model_copy(update={**NOTHING, **changed})
    return workspace_of(arm, arm_robot(cell, arm))


def plane_of(workspace, name: str):
    return next((plane for plane in workspace.space.planes if plane.name == name), None)


@pytest.mark.parametrize("lean", [0.0, 0.4, np.pi / 2, 2.2])
def test_the_floor_is_normal_to_gravity_and_everything_stays_above_it(small_cell, lean):
    """Heights computed here: wrist and load along the direction against gravity, less their thickness."""
    up = np.array([np.sin(lean), 0.0, np.cos(lean)])
    workspace = of(small_cell, gravity_m_s2=tuple(-9.80665 * up))
    floor = plane_of(workspace, "floor")
    assert np.array(floor.normal) == pytest.approx(up)
    assert "assumed" in floor.source
    random = np.random.default_rng(3)
    q_rad = random.uniform(workspace.lower_rad, workspace.upper_rad, (4000, 6))
    free = q_rad[~workspace.space.touching(q_rad)]
    assert len(free) > 40
    wrist = link_frames(workspace.robot, free)[:, 2:, :3, 3] @ up
    radius = 0.05 * reach_m(workspace.robot)
    assert wrist.min() > floor.height_m + radius - 1e-9
    load = flange_frames(workspace.robot, free)
    ball = (load[:, :3, 3] + radius * load[:, :3, 2]) @ up
    assert ball.min() > floor.height_m + radius - 1e-9


def test_a_base_that_leans_is_bolted_to_a_wall(small_cell):
    assert plane_of(of(small_cell), "wall") is None
    assert plane_of(of(small_cell, gravity_m_s2=(4.0, 0.0, -9.0)), "wall") is None
    wall = plane_of(of(small_cell, gravity_m_s2=(9.81, 0.0, 0.0)), "wall")
    assert wall.normal == pytest.approx((0, 0, 1))
    assert wall.height_m == 0.0
    assert plane_of(of(small_cell, gravity_m_s2=(9.81, 0.0, 0.0), wall=False), "wall") is None
    assert plane_of(of(small_cell, wall=True), "wall") is not None


def test_below_an_inverted_base_the_floor_is_a_reach_away(small_cell):
    workspace = of(small_cell, gravity_m_s2=(0.0, 0.0, 9.81))
    assert plane_of(workspace, "floor").height_m == pytest.approx(-reach_m(workspace.robot))
    assert "inverted" in plane_of(workspace, "floor").source


@pytest.mark.parametrize(("stated", "height_m"), [(-0.7, -0.7), (0, 0.0), (0.05, 0.05)])
def test_a_stated_floor_is_where_the_cell_has_it(small_cell, stated, height_m):
    """0 is a height, not "none"."""
    floor = plane_of(of(small_cell, floor_m=float(stated)), "floor")
    assert floor.height_m == height_m
    assert "arm.floor_m" in floor.source
    assert "assumed" not in floor.source


def test_false_is_none_and_zero_is_a_height(small_cell):
    text = small_cell.text
    assert "floor_m = -0.02" in text
    for written, found in (("false", False), ("0", 0.0)):
        arm = parse_cell(text.replace("floor_m = -0.02", f"floor_m = {written}"), "cell.toml").arm[0]
        assert arm.floor_m is found if found is False else (arm.floor_m == 0.0 and arm.floor_m is not False)
    with pytest.raises(ConfigError, match="floor_m is a number in m, or false"):
        parse_cell(text.replace("floor_m = -0.02", "floor_m = true"), "cell.toml")
    assert plane_of(of(small_cell, floor_m=False), "floor") is None


def test_a_low_shoulder_gets_space_above_the_floor(large_cell):
    """Axis 2 of this arm is in the plane of the base's origin."""
    workspace = of(large_cell)
    radius = 0.05 * reach_m(workspace.robot)
    assert plane_of(workspace, "floor").height_m == pytest.approx(-2 * radius)


def test_the_arm_points_along_axis_1_whichever_direction_that_turns(small_cell):
    arm = small_cell.cell.arm[0]
    text = robot_text(small_cell, arm)
    joint = text.index('<joint name="joint_1"')
    turned = text[:joint] + text[joint:].replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>', 1)
    for each in (text, turned):
        assert outward(robot_from_text(arm, each, "robot.urdf")) == pytest.approx([0, 0, 1])


def test_the_wrist_stays_out_of_an_assumed_column(small_cell):
    workspace = of(small_cell)
    (column,) = (part for part in workspace.space.body.parts if part.name == "column")
    top = float(column.solids[0].points_m[:, 2].max())
    assert top > 0.2
    random = np.random.default_rng(6)
    q_rad = random.uniform(workspace.lower_rad, workspace.upper_rad, (20_000, 6))
    wrist = link_frames(workspace.robot, q_rad)[:, 4, :3, 3]
    inside = (np.hypot(wrist[:, 0], wrist[:, 1]) < 0.1 * reach_m(workspace.robot)) & (wrist[:, 2] < top)
    inside &= wrist[:, 2] > 0.0
    assert inside.any()
    assert workspace.space.touching(q_rad[inside]).all()
    none = of(small_cell, column_radius_m=False)
    assert not any(part.name == "column" for part in none.space.body.parts)
    wide = of(small_cell, column_radius_m=0.3, floor_m=-0.5)
    (column,) = (part for part in wide.space.body.parts if part.name == "column")
    assert column.solids[0].points_m[:, 2].min() == pytest.approx(-0.5)


def test_the_arm_meets_itself_on_a_path_whose_ends_are_free():
    """Seven axes, folded: joint 5 swings a long load from one side of the upper arm to the other, through it."""
    cell = load_cell(Path("tests/cells/seven/cell.toml"))
    workspace = of(cell, floor_m=False, column_radius_m=False, load_size_m=(0.1, 0.1, 0.9))
    start = np.array([0.0, 0.0, 0.0, 1.9, 1.6, -1.9, 0.0])
    end = start * [1, 1, 1, 1, -1, 1, 1]
    assert not workspace.space.touching(np.array([start, end])).any()
    assert workspace.space.touching((start + end)[None] / 2)[0]
    assert not workspace.path_clear(start[None], end[None])[0]
    reason = workspace.why_not_path(np.array([start, end]))
    assert reason.startswith("at [0.000, 0.000, 0.000, 1.900, ")
    assert "load (arm.load_size_m) touches link" in reason
    assert "give arm.link_radius_m" in reason
    legs, unreachable = find_route(workspace, [RestPose(1, tuple(end), "fit")], start, 0.0)
    assert not unreachable
    path = np.vstack([start, *legs[0][1], end])
    assert len(path) > 2
    share = np.linspace(0, 1, 500)[:, None]
    for before, after in itertools.pairwise(path):
        assert not workspace.space.touching(before + share * (after - before)).any()


def test_a_larger_load_is_met_where_a_smaller_one_passes(small_cell):
    """A box under the flange, further away than the small load is long."""
    q_rad = np.array([[0.0, 0.6, 0.6, 0.0, 0.6, 0.0]])
    plain = of(small_cell, floor_m=False, column_radius_m=False)
    flange = flange_frames(plain.robot, q_rad)[0]
    centre = flange[:3, 3] + 0.45 * flange[:3, 2]
    box = [{"min_m": tuple(centre - 0.05), "max_m": tuple(centre + 0.05)}]
    for length, touches in ((0.2, False), (0.5, True)):
        workspace = of(
            small_cell,
            floor_m=False,
            column_radius_m=False,
            load_size_m=(0.1, 0.1, length),
            keep_out=tuple(KeepOut(**each) for each in box),
        )
        assert workspace.space.touching(q_rad)[0] == touches
        if touches:
            assert workspace.why_not(q_rad[0]) == "load in keep_out box 1 (arm.load_size_m)"


def test_refusals_say_what_touches_what_and_what_to_write(small_cell):
    workspace = of(small_cell)
    down = np.array([0.0, 1.8, 0.5, 0.0, 0.0, 0.0])
    words = workspace.why_not(down)
    assert "in the floor (0.000 m, assumed; give arm.floor_m, or false where there is none)" in words
    assert "0.066 m, assumed: 0.05 x reach; give arm.link_radius_m" in words


def test_neighbours_and_what_always_touches_are_left_out_and_named(small_cell):
    space = of(small_cell).space
    body, pairs = space.body, space.pairs
    between = pairs.kind == SOLID
    apart = body.link[pairs.first[between]] - body.link[pairs.other[between]]
    names = np.array([part.name for part in body.parts])[body.part]
    assert (apart[names[pairs.first[between]] != "load"] >= 2).all()
    assert "link 6 and link 4" in space.unchecked
    assert not any("floor" in words or "box" in words for words in space.unchecked)


CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def test_distances_of_shapes_are_those_of_an_independent_library(small_cell):
    """Boxes, cylinders and the base of a URDF: never farther apart than coal has them, and no closer than they are."""
    arm = small_cell.cell.arm[0].model_copy(update={**NOTHING, "floor_m": False, "column_radius_m": False})
    text = robot_text(small_cell, arm)
    shapes = {
        "base_link": '<cylinder radius="0.15" length="0.3"/>',
        "link_3": '<box size="0.15 0.2 0.3"/>',
        "link_5": '<cylinder radius="0.05" length="0.1"/>',
        "link_6": '<box size="0.1 0.12 0.08"/>',
    }
    for name, shape in shapes.items():
        head = f'<link name="{name}">'
        text = text.replace(head, f"{head}<collision><geometry>{shape}</geometry></collision>")
    robot = robot_from_text(arm, text, "robot.urdf")
    space = workspace_of(arm, robot).space
    known = {
        "base": coal.Cylinder(0.15, 0.3),
        "link 3": coal.Box(0.15, 0.2, 0.3),
        "link 5": coal.Cylinder(0.05, 0.1),
        "link 6": coal.Box(0.1, 0.12, 0.08),
    }
    q_rad = np.random.default_rng(4).uniform(robot.lower_rad, robot.upper_rad, (300, 6))
    frames = np.concatenate([np.tile(np.eye(4), (300, 1, 1, 1)), link_frames(robot, q_rad)], axis=1)
    seen = 0
    for pair in range(len(space.pairs.kind)):
        rows = (space.pairs.first[pair], space.pairs.other[pair])
        parts = [space.body.parts[space.body.part[row]] for row in rows]
        if any(part.name not in known for part in parts):
            continue
        gaps = space.gaps_m(q_rad, np.arange(300), np.full(300, pair), np.full(300, np.inf))
        for row in range(300):
            placed = []
            for part in parts:
                frame = frames[row, part.link + 1]
                placed += [known[part.name], coal.Transform3s(frame[:3, :3], frame[:3, 3])]
            true = coal.distance(*placed, coal.DistanceRequest(), coal.DistanceResult())
            assert gaps[row] <= max(true, 0.0) + 1e-5
            if gaps[row] <= 0.0:
                assert true < 0.01 * 0.15  # a prism around a cylinder is wider by 0.9 % at its edges
            seen += true > 0
    assert seen > 500


def test_an_arm_inside_an_assumed_body_is_refused_with_what_to_write(small_cell):
    with pytest.raises(PlanRefused, match=r"is at .*in the floor .*give arm.floor_m.*move it clear by hand"):
        inward_steps(of(small_cell), np.array([0.0, 1.8, 0.5, 0.0, 0.0, 0.0]), "main")


def test_the_base_of_the_urdf_blocks_the_path(small_cell):
    arm = small_cell.cell.arm[0].model_copy(update=NOTHING)
    shape = '<link name="base_link"><collision><geometry><box size="1 1 0.2"/></geometry></collision>'
    text = robot_text(small_cell, arm).replace('<link name="base_link">', shape)
    _, _, fixed_parts = surroundings_of(arm, robot_from_text(arm, text, "robot.urdf"))
    assert [part.name for part in fixed_parts] == ["base"]
    assert fixed_parts[0].solids[0].points_m == pytest.approx(CORNERS * [1, 1, 0.2])


def test_an_example_without_boxes_is_planned_clear_of_floor_and_column(small_cell):
    """The middle of the wrist, all along the planned path: heights and distances to axis 1 computed here."""
    arm = small_cell.cell.arm[0].model_copy(update=NOTHING)
    cell = small_cell.model_copy(update={"cell": small_cell.cell.model_copy(update={"arm": (arm,)})})
    robot = arm_robot(cell, arm)
    corners = make_plan(cell, n_poses=4).corners_rad
    share = np.linspace(0, 1, 200)[:, None]
    path = np.vstack([a + share * (b - a) for a, b in itertools.pairwise(corners)])
    wrist = link_frames(robot, path)[:, 4, :3, 3]
    thick = 0.05 * reach_m(robot)
    assert wrist[:, 2].min() > thick
    low = wrist[:, 2] < 0.26  # the shoulder is at 0.4 m, the column ends two radii below it
    assert (np.hypot(wrist[low, 0], wrist[low, 1]) > 0.1 * reach_m(robot) + thick - 1e-9).all()
