"""Distances to keep-out boxes against brute force, against coal, and all along paths."""

from dataclasses import replace

import coal
import numpy as np
import pytest

from gateway.model.arm_model import arm_robot
from gateway.model.kinematics import link_frames
from gateway.model.solid import Capsule, solid_capsule
from gateway.motion.body import Body, base_and_link_frames, body_of_parts
from gateway.motion.clearance import PATH_RESOLUTION_M, Space, space_between
from gateway.motion.convex_distance import segment_box_distance, segment_segment_distance
from gateway.motion.workspace import workspace_of
from tests.data.around import NO_BOX, among_boxes


def drawn(random: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """Segments and boxes near each other; some segments along an axis, some without length."""
    start, end = random.uniform(-1, 1, (2, count, 3))
    end[::5, :2] = start[::5, :2]
    end[::7] = start[::7]
    low = random.uniform(-1, 1, (count, 3))
    return start, end, low, low + random.uniform(0.01, 0.8, (count, 3))


def test_distance_is_that_of_the_nearest_of_many_points():
    start, end, low, high = drawn(np.random.default_rng(1), 2000)
    share = np.linspace(0, 1, 2001)[:, None, None]
    points = start + share * (end - start)
    brute = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=2).min(axis=0)
    found = segment_box_distance(start, end, low, high)
    assert (found <= brute + 1e-12).all()
    assert (brute - found <= np.linalg.norm(end - start, axis=1) / 4000 + 1e-12).all()
    assert (found == 0).any()
    assert (found > 0.3).any()


def test_distance_is_that_of_an_independent_library():
    random = np.random.default_rng(2)
    for start, end, low, high in zip(*drawn(random, 300), strict=True):
        length = np.linalg.norm(end - start)
        along = (end - start) / length if length else np.array([0.0, 0, 1])
        across = np.linalg.svd(along[None])[2][1:]
        frame = np.column_stack([across[0], np.cross(along, across[0]), along])
        capsule, box = coal.Capsule(0.05, length), coal.Box(*(high - low))
        middle, centre = coal.Transform3s(frame, (start + end) / 2), coal.Transform3s(np.eye(3), (low + high) / 2)
        oracle = coal.distance(capsule, middle, box, centre, coal.DistanceRequest(), coal.DistanceResult())
        found = segment_box_distance(*(value[None] for value in (start, end, low, high)))[0]
        if oracle > 0:
            assert found - 0.05 == pytest.approx(oracle, abs=1e-5)
        else:
            assert found < 0.05 + 1e-5


def cube(centre: np.ndarray, side_m: float) -> np.ndarray:
    return np.array([[centre - side_m / 2, centre + side_m / 2]])


@pytest.mark.parametrize("link", [1, 2, 3, 5])
@pytest.mark.parametrize("share", [0.1, 0.36, 0.5, 0.63, 0.9])
def test_a_cube_of_100_mm_on_a_link_is_seen(large_cell, link, share):
    """Wherever on the link it is, and beside its middle line too."""
    workspace = of(large_cell)
    q_rad = np.array([0.3, 0.2, 0.1, 0.4, 0.5, 0.0])
    frames = link_frames(workspace.robot, q_rad[None])[0]
    origin = frames[link, :3, 3]
    onward = frames[link + 1, :3, 3] if link < 5 else origin
    offset = np.linalg.svd((onward - origin)[None])[2][2] * 0.19
    for centre in (origin + share * (onward - origin), origin + share * (onward - origin) + offset):
        if link == 1 and share < 0.3:
            continue  # the shoulder is carried by link 1
        boxed = replace(among_boxes(workspace, cube(centre, 0.1)), links=None)
        assert f"link {link + 1} in keep_out box 1" in str([w for w, mask in boxed.violations(q_rad[None]) if mask[0]])
        assert not boxed.feasible(q_rad[None])[0]


def of(cell, **changed):
    arm = cell.cell.arm[0].model_copy(update=changed)
    return workspace_of(arm, arm_robot(cell, arm))


def every_gap(space: Space, q_rad: np.ndarray, enough_m: float = 0.0) -> np.ndarray:
    """Distances (n, p) of all pairs."""
    count = len(space.pairs.kind)
    posture, pair = np.repeat(np.arange(len(q_rad)), count), np.tile(np.arange(count), len(q_rad))
    return space.gaps_m(q_rad, posture, pair, np.full(len(pair), enough_m)).reshape(len(q_rad), count)


def test_touching_is_outside_and_thickness_counts(workspace):
    body = workspace.space.body
    q_rad = np.zeros((1, 6))
    (part,) = (part for part in body.parts if part.name == "link 3")
    segment = link_frames(workspace.robot, q_rad)[0, 2, :3, :3] @ body_of_parts([part]).end_m[0]
    origin = link_frames(workspace.robot, q_rad)[0, 2, :3, 3]
    top = max(origin[2], (origin + segment)[2]) + part.solids[0].radius_m
    alone = replace(workspace.space, body=body_of_parts([part]))
    limits = (workspace.lower_rad, workspace.upper_rad)
    for lift, clear in ((0.0, True), (-1e-4, False)):
        box = np.array([[[-2, -2, top + lift], [2, 2, top + 1]]])
        assert space_between(workspace.robot, alone.body, box, (), limits).touching(q_rad)[0] != clear
    far = np.array([[[-2, -2, top + 0.3], [2, 2, top + 1]]])
    space = space_between(workspace.robot, alone.body, far, (), limits)
    assert every_gap(space, q_rad, 9.0) == pytest.approx(0.3, abs=1e-5)


@pytest.mark.slow
def test_distance_of_segments_is_that_of_the_nearest_of_many_points():
    random = np.random.default_rng(3)
    first, other = random.uniform(-1, 1, (2, 500, 2, 3))
    other[::5, 1] = other[::5, 0] + 0.7 * (first[::5, 1] - first[::5, 0])  # level with each other
    first[::7, 1], other[::11, 1] = first[::7, 0], other[::11, 0]
    share = np.linspace(0, 1, 301)
    found = segment_segment_distance(first, other)
    for row in range(len(first)):
        one = first[row, 0] + share[:, None] * (first[row, 1] - first[row, 0])
        two = other[row, 0] + share[:, None] * (other[row, 1] - other[row, 0])
        brute = np.linalg.norm(one[:, None] - two, axis=2).min()
        assert found[row] <= brute + 1e-12
        assert brute - found[row] < 0.012


def strange_body(random: np.random.Generator) -> Body:
    """Three capsules a link, anywhere in it, on the body's own parts."""
    return [
        Capsule(random.uniform(-0.4, 0.4, 3), random.uniform(-0.4, 0.4, 3), float(random.uniform(0.01, 0.1)))
        for _ in range(3)
    ]


def test_a_clearance_that_is_enough_is_never_above_the_true_one(workspace):
    """Capsules that begin anywhere in their link; what is not clear by enough is exact."""
    random = np.random.default_rng(8)
    moving = [part for part in workspace.space.body.parts if part.name.startswith("link")]
    body = body_of_parts(
        [replace(part, solids=tuple(solid_capsule(each) for each in strange_body(random))) for part in moving]
    )
    low = random.uniform(-1.0, 1.0, (6, 3))
    boxes = np.stack([low, low + random.uniform(0.05, 0.5, (6, 3))], axis=1)
    space = space_between(workspace.robot, body, boxes, (), (workspace.lower_rad, workspace.upper_rad))
    q_rad = random.uniform(workspace.lower_rad, workspace.upper_rad, (40, 6))
    exact, found = every_gap(space, q_rad, np.inf), every_gap(space, q_rad, 0.2)
    near = found <= 0.2
    assert (found <= exact + 1e-12).all()
    assert near.any()
    assert not near.all()
    assert found[near] == pytest.approx(exact[near], abs=1e-12)
    segments = body.segments_m(base_and_link_frames(workspace.robot, q_rad))
    boxed = space.pairs.kind == 1
    for column in np.flatnonzero(boxed)[::7]:
        ends = segments[:, space.pairs.first[column]]
        box = np.tile(boxes[space.pairs.other[column]], (40, 1, 1))
        oracle = segment_box_distance(ends[:, 0], ends[:, 1], box[:, 0], box[:, 1])
        oracle -= body.radius_m[space.pairs.first[column]]
        assert exact[:, column] == pytest.approx(oracle, abs=1e-5)


def test_no_point_of_the_arm_moves_farther_than_its_levers_say(workspace):
    random = np.random.default_rng(4)
    q_rad = random.uniform(workspace.lower_rad, workspace.upper_rad, (4000, 6))
    step = 1e-4 * random.normal(size=q_rad.shape)
    body, robot = workspace.space.body, workspace.robot
    moving = body.link >= 0
    levers = body.levers_m(robot)[moving]
    before, after = (body.segments_m(base_and_link_frames(robot, q))[:, moving] for q in (q_rad, q_rad + step))
    moved = np.linalg.norm(after - before, axis=3).max(axis=2)
    allowed = np.abs(step) @ levers.T
    assert (moved <= allowed * (1 + 1e-3)).all()
    assert (moved / allowed).max() > 0.8
    assert (levers[body.link[moving] == 2, 3:] == 0).all()


def test_a_thin_plate_between_two_postures_blocks_the_path(workspace):
    """5 mm of plate, thin links: postures 0.05 rad apart pass it by."""
    start, end = np.array([-0.5, 1.0, 0, 0, 0, 0]), np.array([0.5, 1.0, 0, 0, 0, 0])
    plate = np.array([[[0.9, 0.0105, 0.0], [1.4, 0.0155, 1.4]]])
    free = replace(among_boxes(workspace, plate, radius_m=0.0), links=None)
    sampled = start + np.linspace(0, 1, 41)[:, None] * (end - start)
    assert free.feasible(sampled).all()
    assert not free.path_clear(start[None], end[None])[0]
    assert "keep_out box 1" in free.why_not_path(np.array([start, end]))
    refusal = free.refused_on(sampled)
    assert 19 < refusal.row < 22
    assert free.path_clear(start[None], np.array([[-0.1, 1.0, 0, 0, 0, 0]]))[0]


def test_paths_are_clear_exactly_where_fine_sampling_is(workspace):
    """Against 1000 samples of each path, with boxes, floor, column and the arm itself; a closer path may be refused."""
    random = np.random.default_rng(5)
    boxes = np.array([[[0.3, 0.2, 0.0], [0.4, 0.5, 0.9]], [[-0.6, -0.4, 0.5], [-0.4, 0.0, 0.8]]])
    own = workspace.space
    space = space_between(own.robot, own.body, boxes, own.planes, (workspace.lower_rad, workspace.upper_rad))
    start, end = random.uniform(workspace.lower_rad, workspace.upper_rad, (2, 150, 6))
    found = space.blocked_at(start, end)
    share = np.linspace(0, 1, 1001)[:, None]
    for row in range(len(start)):
        samples = start[row] + share * (end[row] - start[row])
        if np.isnan(found[row]):
            assert not space.touching(samples).any()
        else:
            at = start[row] + found[row] * (end[row] - start[row])
            assert every_gap(space, at[None], 1.0).min() <= PATH_RESOLUTION_M
    assert 20 < np.isnan(found).sum() < 130


def test_nothing_to_meet_is_clear(workspace):
    free = among_boxes(workspace, NO_BOX).space
    assert np.isnan(free.blocked_at(np.zeros((3, 6)), np.ones((3, 6)))).all()
    assert free.blocked_at(np.empty((0, 6)), np.empty((0, 6))).shape == (0,)


def test_an_arm_at_rest_is_judged_where_it_is(workspace):
    q_rad = np.zeros((1, 6))
    free = among_boxes(workspace, np.array([[[5.0, 5, 5], [6, 6, 6]]])).space
    assert np.isnan(free.blocked_at(q_rad, q_rad))[0]
    everywhere = among_boxes(workspace, np.array([[[-5.0, -5, -5], [6, 6, 6]]])).space
    assert everywhere.blocked_at(q_rad, q_rad)[0] == 0
