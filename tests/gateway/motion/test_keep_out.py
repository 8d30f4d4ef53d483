"""Distances to keep-out boxes against brute force, against coal, and all along ways."""

import time
from dataclasses import replace

import coal
import numpy as np
import pytest

from gateway.model.kinematics import link_frames
from gateway.motion.keep_out import PATH_RESOLUTION_M, blocked_at, clearance_m, segment_box_distance

NO_BOX = np.empty((0, 2, 3))


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
    aside = np.linalg.svd((onward - origin)[None])[2][2] * 0.19
    for centre in (origin + share * (onward - origin), origin + share * (onward - origin) + aside):
        if link == 1 and share < 0.3:
            continue  # the shoulder is carried by link 1
        boxed = replace(workspace, boxes_m=cube(centre, 0.1), links=None)
        assert f"link {link + 1} in keep_out box 1" in str([w for w, mask in boxed.violations(q_rad[None]) if mask[0]])
        assert not boxed.feasible(q_rad[None])[0]


def of(cell, **changed):
    from gateway.model.arm_model import arm_robot
    from gateway.motion.workspace import workspace_of

    arm = cell.cell.arm[0].model_copy(update=changed)
    return workspace_of(arm, arm_robot(cell, arm))


def test_touching_is_outside_and_thickness_counts(workspace):
    body = workspace.body
    q_rad = np.zeros((1, 6))
    segment = body.segments_m(link_frames(workspace.robot, q_rad))[0, body.part.index("link 3")]
    top = segment[:, 2].max() + body.radius_m[body.part.index("link 3")]
    alone = replace(
        body,
        part=("link 3",),
        link=np.array([2]),
        **{name: getattr(body, name)[[body.part.index("link 3")]] for name in ("start_m", "end_m", "radius_m")},
        source=("",),
    )
    for lift, clear in ((0.0, True), (-1e-4, False)):
        box = np.array([[[-2, -2, top + lift], [2, 2, top + 1]]])
        assert (clearance_m(workspace.robot, alone, box, q_rad) > 0).all() == clear
    far = np.array([[[-2, -2, top + 0.3], [2, 2, top + 1]]])
    assert clearance_m(workspace.robot, alone, far, q_rad, np.full((1, 1), 9.0)) == pytest.approx(0.3, abs=1e-5)


def test_a_clearance_that_is_enough_is_never_above_the_true_one(workspace):
    """Capsules that begin anywhere in their link; what is not clear by enough is exact."""
    random = np.random.default_rng(8)
    link = np.repeat(np.arange(6), 3)
    start, end = random.uniform(-0.4, 0.4, (2, len(link), 3))
    body = replace(
        workspace.body,
        part=tuple(f"part {number}" for number in range(len(link))),
        link=link,
        start_m=start,
        end_m=end,
        radius_m=random.uniform(0.0, 0.1, len(link)),
        source=("",) * len(link),
    )
    low = random.uniform(-1.0, 1.0, (6, 3))
    boxes = np.stack([low, low + random.uniform(0.05, 0.5, (6, 3))], axis=1)
    q_rad = random.uniform(workspace.lower_rad, workspace.upper_rad, (40, 6))
    segments = body.segments_m(link_frames(workspace.robot, q_rad))
    exact = (
        np.stack(
            [
                segment_box_distance(
                    *segments.reshape(-1, 2, 3).swapaxes(0, 1), *(np.tile(each, (720, 1)) for each in box)
                )
                for box in boxes
            ],
            axis=1,
        ).reshape(40, len(link), 6)
        - body.radius_m[:, None]
    )
    enough = random.uniform(0.0, 0.3, (40, len(link)))
    found = clearance_m(workspace.robot, body, boxes, q_rad, enough)
    free = exact > 0.0
    near = free & (found <= enough[:, :, None])
    assert (found <= np.maximum(exact, 0.0) + 1e-5).all()
    assert near.any()
    assert (found > enough[:, :, None]).any()
    assert found[near] == pytest.approx(exact[near], abs=1e-5)


def test_no_point_of_the_arm_moves_farther_than_its_levers_say(workspace):
    random = np.random.default_rng(4)
    q_rad = random.uniform(workspace.lower_rad, workspace.upper_rad, (4000, 6))
    step = 1e-4 * random.normal(size=q_rad.shape)
    body, levers = workspace.body, workspace.body.levers_m(workspace.robot)
    before, after = (body.segments_m(link_frames(workspace.robot, q)) for q in (q_rad, q_rad + step))
    moved = np.linalg.norm(after - before, axis=3).max(axis=2)
    allowed = np.abs(step) @ levers.T
    assert (moved <= allowed * (1 + 1e-3)).all()
    assert (moved / allowed).max() > 0.8
    assert (levers[body.part.index("link 3"), 3:] == 0).all()


def test_a_thin_plate_between_two_postures_blocks_the_way(workspace):
    """5 mm of plate, thin links: postures 0.05 rad apart pass it by."""
    start, end = np.array([-0.5, 1.0, 0, 0, 0, 0]), np.array([0.5, 1.0, 0, 0, 0, 0])
    thin = replace(workspace.body, radius_m=np.zeros(len(workspace.body.link)))
    plate = np.array([[[0.9, 0.0105, 0.0], [1.4, 0.0155, 1.4]]])
    free = replace(workspace, body=thin, links=None, boxes_m=plate)
    sampled = start + np.linspace(0, 1, 41)[:, None] * (end - start)
    assert free.feasible(sampled).all()
    assert not free.path_clear(start[None], end[None])[0]
    assert "keep_out box 1" in free.why_not_path(np.array([start, end]))
    refusal = free.refused_on(sampled)
    assert 19 < refusal.row < 22
    assert free.path_clear(start[None], np.array([[-0.1, 1.0, 0, 0, 0, 0]]))[0]


def test_ways_are_clear_exactly_where_fine_sampling_is(workspace):
    """Against 4000 samples a way; a way closer than the resolution may be refused."""
    random = np.random.default_rng(5)
    boxes = np.array([[[0.3, 0.2, 0.0], [0.4, 0.5, 0.9]], [[-0.6, -0.4, 0.5], [-0.4, 0.0, 0.8]]])
    start, end = random.uniform(workspace.lower_rad, workspace.upper_rad, (2, 150, 6))
    found = blocked_at(workspace.robot, workspace.body, boxes, start, end)
    share = np.linspace(0, 1, 4001)[:, None]
    for row in range(len(start)):
        way = start[row] + share * (end[row] - start[row])
        nearest = clearance_m(workspace.robot, workspace.body, boxes, way).min()
        if np.isnan(found[row]):
            assert nearest > 0
        else:
            assert nearest <= PATH_RESOLUTION_M
            at = start[row] + found[row] * (end[row] - start[row])
            assert clearance_m(workspace.robot, workspace.body, boxes, at[None]).min() <= PATH_RESOLUTION_M
    assert 20 < np.isnan(found).sum() < 130


def test_nothing_to_meet_is_clear(workspace):
    assert np.isnan(blocked_at(workspace.robot, workspace.body, NO_BOX, np.zeros((3, 6)), np.ones((3, 6)))).all()
    assert blocked_at(workspace.robot, workspace.body, NO_BOX, np.empty((0, 6)), np.empty((0, 6))).shape == (0,)


def test_an_arm_that_stands_is_judged_where_it_stands(workspace):
    q_rad = np.zeros((1, 6))
    free = np.array([[[5.0, 5, 5], [6, 6, 6]]])
    assert np.isnan(blocked_at(workspace.robot, workspace.body, free, q_rad, q_rad))[0]
    everywhere = np.array([[[-5.0, -5, -5], [6, 6, 6]]])
    assert blocked_at(workspace.robot, workspace.body, everywhere, q_rad, q_rad)[0] == 0


def test_many_ways_take_little_time(workspace):
    """A plan over 28 poses checks some 760 ways; a tenth of a second on an idle machine."""
    random = np.random.default_rng(6)
    start, end = random.uniform(workspace.lower_rad, workspace.upper_rad, (2, 760, 6))
    begun = time.process_time()
    blocked_at(workspace.robot, workspace.body, workspace.boxes_m, start, end)
    assert time.process_time() - begun < 2.0
