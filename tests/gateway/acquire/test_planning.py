"""Chosen poses carry information, plans keep their limits, and a plan that breaks one is refused."""

import itertools
from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from gateway.acquire import plan as steps_of_a_plan
from gateway.acquire.plan import MoveTo, Plan, PoseVisit, check_plan, plan_from, plan_poses, step_durations
from gateway.acquire.planning import expectation, make_plan, plan_of_poses, visit_settings
from gateway.acquire.poses import DISTANCE_RAD, RestPose, choose_poses, feasible_postures, read_poses
from gateway.acquire.route import find_route
from gateway.errors import InputError, PlanRefused
from gateway.estimate.recommendation import payload_information
from gateway.model.arm_model import robot_text
from gateway.model.kinematics import flange_frames
from gateway.motion.assumed import assumed_noise_nm
from gateway.motion.joint_path import path_points
from gateway.motion.trajectory import straight
from tests.data.arms import carrying, peer_of, torque_of
from tests.data.around import among_boxes


def load_information(workspace, q_rad: np.ndarray, noise_nm: np.ndarray) -> np.ndarray:
    return payload_information(workspace.robot, q_rad, noise_nm, workspace.gravity_m_s2)


REQUEST = {"count": 8, "validation": 3, "approach_offset_rad": 0.03, "seed": 1}


@pytest.fixture(scope="module")
def poses(workspace) -> tuple[RestPose, ...]:
    return choose_poses(workspace, **REQUEST, noise_nm=assumed_noise_nm(workspace))


@pytest.fixture(scope="module")
def plan(small_cell) -> Plan:
    return make_plan(small_cell, n_poses=6, seed=1)


def load_rows(small_cell, q_rad: np.ndarray) -> np.ndarray:
    """Columns [m, h] of link 6 by pinocchio's regressor."""
    arm, zero = small_cell.cell.arm[0], np.zeros(6)
    model, data = peer_of(robot_text(small_cell, arm), tuple(arm.gravity_m_s2))
    return np.array([pinocchio.computeJointTorqueRegressor(model, data, q, zero, zero)[:, 50:54] for q in q_rad])


def test_information_is_that_of_an_independent_regressor(small_cell, workspace, poses):
    noise_nm = assumed_noise_nm(workspace)
    q_rad = np.array([pose.q_rad for pose in poses])
    rows = load_rows(small_cell, q_rad) / noise_nm[:, None]
    expected = np.einsum("nij,nik->njk", rows, rows) / 2
    assert load_information(workspace, q_rad, noise_nm) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_expected_std_is_the_cramer_rao_bound(small_cell, workspace, poses):
    """Weighted least squares on simulated differences scatters as promised."""
    noise_nm = assumed_noise_nm(workspace)
    promise = expectation(workspace, poses, noise_nm, "test", np.zeros(6))
    q_rad = np.array([pose.q_rad for pose in poses])
    rows = (load_rows(small_cell, q_rad) / noise_nm[:, None]).reshape(-1, 4)
    mass_kg, com_m = promise.reference_load_kg, workspace.points_m[0]
    truth = mass_kg * np.append(1.0, com_m)
    random = np.random.default_rng(2)
    noise = np.sqrt(2.0) * random.normal(size=(4000, len(rows)))
    found = np.linalg.lstsq(rows, (rows @ truth + noise).T, rcond=None)[0].T
    assert found[:, 0].std() == pytest.approx(promise.mass_std_kg, rel=0.05)
    assert (found[:, 1:] / found[:, :1]).std(axis=0) == pytest.approx(promise.com_std_m, rel=0.05)


def test_what_is_expected_holds_the_torque_constants(small_cell, workspace, poses):
    """Generalised least squares, each axis with one drawn error of its constant at all poses."""
    noise_nm, gain_std = assumed_noise_nm(workspace), np.array([0.03, 0.05, 0.02, 0.1, 0.05, 0.01])
    promise = expectation(workspace, poses, noise_nm, "test", gain_std)
    rows = load_rows(small_cell, np.array([pose.q_rad for pose in poses]))
    load = promise.reference_load_kg * np.append(1.0, workspace.points_m[0])
    joint, x = np.tile(np.arange(6), len(rows)), rows.reshape(-1, 4)
    shared = (x @ load) * (joint[:, None] == np.arange(6)).T
    covariance = np.diag(2 * noise_nm[joint] ** 2) + (shared.T * gain_std**2) @ shared
    found = np.linalg.inv(x.T @ np.linalg.solve(covariance, x))
    assert promise.mass_std_kg == pytest.approx(np.sqrt(found[0, 0]), rel=1e-6)
    turn = np.column_stack([-workspace.points_m[0], np.eye(3)]) / promise.reference_load_kg
    assert promise.com_std_m == pytest.approx(np.sqrt(np.diag(turn @ found @ turn.T)), rel=1e-6)
    exact = expectation(workspace, poses, noise_nm, "test", np.zeros(6))
    assert promise.mass_std_kg > 2 * exact.mass_std_kg


def test_chosen_poses_beat_random_ones(workspace, poses):
    noise_nm = assumed_noise_nm(workspace)
    fit = np.array([pose.q_rad for pose in poses if pose.purpose == "fit"])
    chosen = np.linalg.slogdet(load_information(workspace, fit, noise_nm).sum(axis=0))[1]
    candidates = feasible_postures(workspace, 11, 0.03, np.random.default_rng(9))
    for start in range(0, 400, 8):
        other = load_information(workspace, candidates[start : start + 8], noise_nm).sum(axis=0)
        assert np.linalg.slogdet(other)[1] < chosen


def test_a_small_choice_is_close_to_the_best_of_all(workspace):
    """Exhaustive search over all pairs of the same candidates, without the distance and the weight on the links."""
    candidates = feasible_postures(workspace, 11, 0.03, np.random.default_rng(1))
    noise_nm = assumed_noise_nm(workspace)
    information = load_information(workspace, candidates[:150], noise_nm)
    best = max(np.linalg.slogdet(information[a] + information[b])[1] for a, b in itertools.combinations(range(150), 2))
    two = choose_poses(workspace, 2, 0, 0.03, 1, noise_nm)
    chosen = load_information(workspace, np.array([pose.q_rad for pose in two]), noise_nm).sum(axis=0)
    assert np.linalg.slogdet(chosen)[1] > best - 0.5


def test_poses_are_feasible_apart_and_reproducible(workspace, poses):
    q_rad = np.array([pose.q_rad for pose in poses])
    assert [pose.number for pose in poses] == list(range(1, 12))
    assert [pose.purpose for pose in poses] == ["fit"] * 8 + ["validation"] * 3
    for offset in (-0.03, 0.0, 0.03):
        assert workspace.feasible(q_rad + offset).all()
    assert workspace.feasible(q_rad, torque_share=workspace.rest_share).all()
    for a, b in itertools.combinations(q_rad, 2):
        assert np.abs(a - b).max() >= DISTANCE_RAD * 0.999
    noise_nm = assumed_noise_nm(workspace)
    assert choose_poses(workspace, **REQUEST, noise_nm=noise_nm) == poses
    assert choose_poses(workspace, **(REQUEST | {"seed": 2}), noise_nm=noise_nm) != poses


def test_too_little_space_is_refused_with_the_reason(workspace):
    shut = among_boxes(workspace, np.array([[[-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]]]))
    with pytest.raises(PlanRefused, match="0 of .* random postures are feasible.*100% link . in keep_out box 1"):
        choose_poses(shut, **REQUEST, noise_nm=assumed_noise_nm(workspace))


@pytest.mark.slow
def test_plan_of_the_examples(small_cell, large_cell):
    for cell in (small_cell, large_cell):
        plan = make_plan(cell)
        assert len(plan.visits) == 2 * (cell.cell.poses.count + cell.cell.poses.validation)
        visit_s = plan.duration_s / len(plan.poses)
        assert 5.0 < visit_s < 11.0
        assert plan.expectation is not None
        # constants known to 3 to 5 % of an axis, several axes
        assert 0.01 < plan.expectation.mass_std_kg / plan.expectation.reference_load_kg < 0.05


def test_both_sides_of_every_pose_are_approached_slowly(plan, small_cell, workspace):
    approached = [step for step in plan.steps if isinstance(step, PoseVisit)]
    assert {(step.pose, step.direction) for step in approached} == {(p.number, d) for p in plan.poses for d in (-1, 1)}
    for number, step in enumerate(plan.steps):
        if isinstance(step, PoseVisit):
            before = plan.steps[number - 1]
            assert isinstance(before, MoveTo)
            motion = np.array(step.q_rad) - np.array(before.q_rad)
            assert motion == pytest.approx(np.full(6, 0.03 * step.direction))
    durations = step_durations(plan, workspace)
    assert len(durations) == len(plan.steps) + 2 * len(approached)
    assert durations[-1] == small_cell.cell.poses.samples * plan.settings.period_s


def test_plan_from_the_middle_leaves_out_what_is_done(plan, workspace):
    start = np.array(plan.poses[2].q_rad)
    done = [(1, -1), (1, 1), (2, -1)]
    going_on = plan_from(plan, workspace, start, done)
    check_plan(going_on, workspace)
    assert set(going_on.visits) == set(plan.visits) - set(done)
    assert going_on.start_rad == pytest.approx(start)


def test_a_start_out_of_bounds_is_refused(plan, workspace):
    start = np.array(workspace.upper_rad) + 0.5
    with pytest.raises(PlanRefused, match=r"arm 'main' is at .*joint 1 is 0.500 rad outside"):
        plan_from(plan, workspace, start)
    boxed = among_boxes(workspace, np.array([[[-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]]]))
    with pytest.raises(PlanRefused, match=r"arm 'main' is at .*keep_out box 1.*; move it clear"):
        plan_from(plan, boxed, np.zeros(6))


def outside(plan, workspace) -> np.ndarray:
    start = np.array(plan.poses[0].q_rad)
    start[3] = workspace.upper_rad[3] + 0.2
    return start


def test_an_arm_outside_its_range_begins_with_a_slow_motion_inwards(plan, workspace):
    start = outside(plan, workspace)
    going = plan_from(plan, workspace, start)
    check_plan(going, workspace)
    first, *others = going.steps
    assert first.is_inwards
    assert not any(step.is_inwards for step in others if isinstance(step, MoveTo))
    assert workspace.why_not(np.array(first.q_rad)) is None
    moved = np.array(first.q_rad) - start
    assert moved[3] < -0.2
    assert moved[[0, 1, 2, 4, 5]].tolist() == [0.0] * 5
    least_s = 0.2 / min(0.1 * workspace.speed_rad_s[3], 0.05)
    assert least_s < step_durations(going, workspace)[0] < 2 * least_s


def test_a_motion_inwards_that_is_none_is_refused(plan, workspace):
    going = plan_from(plan, workspace, outside(plan, workspace))
    inwards, *others = going.steps
    assert inwards.is_inwards
    for steps in (
        (*others, inwards),
        (replace(inwards, q_rad=plan.poses[1].q_rad), *others),
        (MoveTo(inwards.q_rad), *others),
    ):
        with pytest.raises(PlanRefused, match="must be the straight motion|joint 4 outside"):
            check_plan(replace(going, steps=steps), workspace)
    with pytest.raises(PlanRefused, match="must be the straight motion"):
        check_plan(replace(going, start_rad=None), workspace)


@pytest.mark.parametrize(
    "name",
    ["speed_rad_s", "acceleration_rad_s2", "jerk_rad_s3", "torque_nm", "following_error_rad", "upper_rad"],
)
def test_a_missing_limit_refuses(plan, workspace, name):
    values = getattr(workspace, name).copy()
    values[3] = np.inf if name == "upper_rad" else np.nan
    with pytest.raises(PlanRefused, match="joint 4: .* is missing in the cell file; nothing will move"):
        check_plan(plan, replace(workspace, **{name: values}))


def test_moves_stay_below_the_torque_limits_with_the_heaviest_load(small_cell, plan, workspace):
    """Torque by pinocchio, of an arm whose limits are just enough to hold the load along the path."""
    load = replace(workspace, max_load=np.array([10.0, 0.0, 0.0, 1.2]))
    held = load.holding_torque(np.vstack([path_points(*pair) for pair in itertools.pairwise(plan.corners_rad)]))
    weak = replace(load, torque_nm=np.maximum(held.max(axis=0) / 0.9, 20.0))
    model, largest = carrying(peer_of(robot_text(small_cell, small_cell.cell.arm[0]))[0], 10.0, (0.0, 0.0, 0.12)), []
    for at, step in itertools.pairwise(plan.steps):
        limits = steps_of_a_plan.motion_limits(step, np.array(at.q_rad), weak, plan.settings)
        motion = straight(np.array(at.q_rad), np.array(step.q_rad), limits, plan.settings.period_s)
        torque = torque_of(model, motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2)
        largest.append(np.abs(torque / weak.efficiency / weak.torque_nm).max())
    assert 0.85 < max(largest) < 0.95


def changed(plan: Plan, number: int, step) -> Plan:
    steps = list(plan.steps)
    steps[number] = step
    return replace(plan, steps=tuple(steps))


def test_broken_plans_are_refused(plan, workspace):
    approach = next(i for i, step in enumerate(plan.steps) if isinstance(step, PoseVisit))
    step = plan.steps[approach]
    cases = [
        (changed(plan, approach, replace(step, direction=1)), "must approach pose"),
        (changed(plan, approach - 1, MoveTo((0.0, 0.0, 9.0, 0.0, 0.0, 0.0))), "joint 3 outside"),
        (changed(plan, approach - 1, MoveTo((0.0, 0.0, float("nan"), 0.0, 0.0, 0.0))), "6 finite joint angles"),
        (replace(plan, settings=replace(plan.settings, approach_speed_rad_s=0.0)), "approach speed is 0"),
        (replace(plan, steps=plan.steps[approach:]), "without a move before it"),
    ]
    check_plan(plan, workspace)
    for broken, words in cases:
        with pytest.raises(PlanRefused, match=words):
            check_plan(broken, workspace)


def box_between(workspace, start: np.ndarray, end: np.ndarray):
    """A box of 10 cm where the flange would pass halfway."""
    middle = flange_frames(workspace.robot, (start + end)[None] / 2)[0, :3, 3]
    return replace(among_boxes(workspace, np.array([[middle - 0.05, middle + 0.05]])), links=None)


def test_a_blocked_path_goes_over_a_point_in_between(workspace):
    start, end = np.zeros(6), np.array([1.2, 0.3, 0.2, 0.0, 0.4, 0.0])
    blocked = box_between(workspace, start, end + 0.03)
    ((_, (via,)),), unreachable = find_route(blocked, [RestPose(1, tuple(end), "fit")], start, 0.03)
    assert not unreachable
    for a, b in ((start, np.array(via)), (np.array(via), end + 0.03)):
        assert blocked.feasible(path_points(a, b)).all()


def test_a_pose_that_nothing_leads_to_is_named(workspace, small_cell):
    cage = replace(workspace, lower_rad=np.full(6, -0.1), upper_rad=np.full(6, 0.1), links=None)
    out = RestPose(4, (0.5,) * 6, "fit")
    assert find_route(cage, [out], np.zeros(6), 0.03) == ([], (out,))
    with pytest.raises(PlanRefused, match="pose 4: joint 1 outside"):
        plan_of_poses(small_cell, small_cell.cell.arm[0], cage, [RestPose(1, (0.0,) * 6, "fit"), out])


def test_travel_is_shorter_than_in_the_order_of_choice(workspace, poses):
    legs, _ = find_route(workspace, poses, np.zeros(6), 0.03)
    assert {pose.number for pose, _ in legs} == {pose.number for pose in poses}

    def travel(order: list[RestPose]) -> float:
        points = np.vstack([np.zeros(6), [pose.q_rad for pose in order]])
        return workspace.travel_time(points[:-1], points[1:]).sum()

    assert travel([pose for pose, _ in legs]) < 0.8 * travel(list(poses))


def test_one_pose_is_refused(small_cell):
    with pytest.raises(PlanRefused, match="one pose cannot identify a load"):
        make_plan(small_cell, n_poses=1)


def test_poses_that_give_rank_three_are_refused(workspace):
    """Only joint 1 differs: gravity keeps its direction in the flange."""
    turned = [RestPose(i, (0.3 * i, 0.2, 0.1, 0.0, 0.4, 0.0), "fit") for i in range(1, 6)]
    with pytest.raises(PlanRefused, match="do not determine mass and centre of gravity"):
        expectation(workspace, turned, assumed_noise_nm(workspace), "test", np.zeros(6))


def write_poses(path, rows: list[list], header="pose,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_validation") -> None:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")


def test_poses_from_a_file(tmp_path, small_cell, workspace, poses):
    write_poses(tmp_path / "p.csv", [[p.number, *p.q_rad, int(p.purpose == "validation")] for p in poses])
    assert read_poses(tmp_path / "p.csv", 6) == poses
    plan = plan_of_poses(small_cell, small_cell.cell.arm[0], workspace, read_poses(tmp_path / "p.csv", 6))
    assert plan.poses == poses


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        ([[1, 0, 0, 0, 0, 0]], "pose,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad", "column 'q6_rad' is missing"),
        ([[1] + [0] * 7, [1] + [1] * 7], None, ":3: pose: 1 must be an unused integer"),
        ([[1.5] + [0] * 7], None, ":2: pose: 1.5 must be an unused integer"),
        ([[1] + [0] * 6 + [2]], None, ":2: x_validation: 2.0 must be 0 or 1"),
    ],
)
def test_bad_pose_files(tmp_path, rows, header, message):
    write_poses(tmp_path / "p.csv", rows, *([header] if header else []))
    with pytest.raises(InputError, match=message):
        read_poses(tmp_path / "p.csv", 6)


def test_settings_come_from_the_cell(small_cell):
    settings = visit_settings(small_cell, small_cell.cell.arm[0])
    assert settings.period_s == small_cell.cell.bus["a"].sync_period_s
    assert settings.samples == small_cell.cell.poses.samples


def test_a_visit_of_the_large_arm_takes_five_to_six_seconds(large_cell):
    """Both approaches of one pose, without the transfer to it."""
    plan = make_plan(large_cell)
    short = plan_poses("main", _workspace(large_cell), plan.poses[:1], plan.settings)[0]
    assert 4.5 < short.duration_s < 6.0


def _workspace(cell):
    from gateway.model.arm_model import arm_robot
    from gateway.motion.workspace import workspace_of

    return workspace_of(cell.cell.arm[0], arm_robot(cell, cell.cell.arm[0]))
