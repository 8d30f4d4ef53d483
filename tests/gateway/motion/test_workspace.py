"""Limits, boxes and torque shares, against points and torques computed by pinocchio."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from gateway.cell.config import AxisConfig, KeepOut
from gateway.errors import ConfigError, PlanRefused
from gateway.model.arm_model import arm_named, arm_robot, robot_text
from gateway.model.kinematics import flange_frames, link_frames
from gateway.motion.body import base_and_link_frames
from gateway.motion.joint_path import path_points
from gateway.motion.workspace import INWARD_MARGIN_RAD, TORQUE_SHARE, workspace_of
from tests.data.around import NO_BOX, among_boxes
from tests.data.axes import axis_table


@pytest.fixture(scope="module")
def postures(workspace) -> np.ndarray:
    return np.random.default_rng(3).uniform(workspace.lower_rad, workspace.upper_rad, (60, 6))


@pytest.fixture(scope="module")
def model(small_cell):
    return pinocchio.buildModelFromXML(robot_text(small_cell, small_cell.cell.arm[0]))


def test_joint_limits_and_margin(workspace):
    middle = (workspace.lower_rad + workspace.upper_rad) / 2
    q_rad = np.tile(middle, (3, 1))
    q_rad[1, 3] = workspace.upper_rad[3] + 1e-6
    q_rad[2, 3] = workspace.upper_rad[3] - 0.01
    joint_4 = workspace.violations(q_rad)[3]
    assert joint_4[1].tolist() == [False, True, False]
    assert workspace.violations(q_rad, margin_rad=0.02)[3][1].tolist() == [False, True, True]
    assert "joint 4 outside" in workspace.why_not(q_rad[1])


def flange_m(workspace, q_rad: np.ndarray) -> np.ndarray:
    return flange_frames(workspace.robot, q_rad)[:, :3, 3]


def test_capsules_stand_where_the_model_has_its_links(workspace, model, postures):
    body = workspace.space.body
    segments = body.segments_m(base_and_link_frames(workspace.robot, postures))
    names = [body.parts[part].name for part in body.part]
    data = model.createData()
    for row, q_rad in enumerate(postures):
        pinocchio.forwardKinematics(model, data, q_rad)
        joints = np.array([data.oMi[joint].translation for joint in range(1, 7)])
        for part, link in (("link 3", 2), ("link 4", 3), ("link 5", 4)):
            found = segments[row, names.index(part)]
            assert found == pytest.approx(joints[link : link + 2], abs=1e-9)
        ball = data.oMi[6].act(workspace.points_m[0] + [0, 0, body.radius_m[-1]])
        assert segments[row, -1] == pytest.approx(np.array([ball, ball]), abs=1e-9)


def test_boxes_keep_links_out(workspace, postures):
    end = flange_m(workspace, postures[:1])[0]
    boxed = among_boxes(workspace, np.array([[end - 0.01, end + 0.01]]))
    inside = {words for words, mask in boxed.violations(postures[:1]) if mask[0]}
    assert any(words.startswith("link 6 in keep_out box 1 (0.066 m, assumed") for words in inside)
    assert any(words.startswith("load in keep_out box 1") for words in inside)
    assert not any(words.startswith("link 2") for words in inside)


def test_holding_torque_is_gravity_over_efficiency(workspace, model, postures):
    data = model.createData()
    gravity = np.array([np.abs(pinocchio.computeGeneralizedGravity(model, data, q)) for q in postures])
    torque = workspace.holding_torque(postures)
    scale = np.linalg.norm(workspace.gravity_m_s2) / 9.81
    assert torque == pytest.approx(gravity * scale / workspace.efficiency, rel=1e-6, abs=1e-9)


def test_heaviest_load_counts(workspace, postures):
    load = replace(workspace, max_load=10.0 * np.array([1.0, 0.0, 0.0, 0.2]))
    assert (load.holding_torque(postures)[:, 1] >= workspace.holding_torque(postures)[:, 1]).all()
    assert load.holding_torque(postures)[:, 1].max() > 1.2 * workspace.holding_torque(postures)[:, 1].max()
    assert load.rest_share > workspace.rest_share
    tight = replace(workspace, torque_nm=workspace.torque_nm * 0.1)
    assert "holding torque of joint" in tight.why_not(postures[0] * 0, TORQUE_SHARE)


def test_unknown_links_leave_torque_unchecked(small_cell):
    arm = small_cell.cell.arm[0].model_copy(update={"inertials": "ignore"})
    unknown = workspace_of(arm, arm_robot(small_cell, arm))
    assert unknown.links is None
    assert unknown.holding_torque(np.zeros((1, 6))) is None
    assert not any("torque" in words for words, _ in unknown.violations(np.zeros((1, 6))))


def test_path_between_feasible_postures_may_be_blocked(workspace, postures):
    start, end = postures[0], postures[1]
    middle = flange_m(workspace, (start + end)[None] / 2)[0]
    free = replace(among_boxes(workspace, NO_BOX), links=None)
    assert free.path_clear(start[None], end[None]).tolist() == [True]
    blocked = among_boxes(free, np.array([[middle - 0.02, middle + 0.02]]))
    assert blocked.feasible(np.array([start, end])).all()
    assert blocked.path_clear(start[None], end[None]).tolist() == [False]


def test_path_points_are_close_and_reach_both_ends():
    points = path_points(np.zeros(6), np.array([1.0, 0, 0, 0, 0, -0.2]))
    assert points[0].tolist() == [0.0] * 6
    assert points[-1].tolist() == [1.0, 0, 0, 0, 0, -0.2]
    assert np.abs(np.diff(points, axis=0)).max() <= 0.05 + 1e-12


def test_limits_of_cell_and_robot_are_joined(small_cell):
    arm = small_cell.cell.arm[0]
    robot = replace(arm_robot(small_cell, arm), upper_rad=np.full(6, 0.5))
    assert workspace_of(arm, robot).upper_rad.tolist() == [0.5] * 6
    with pytest.raises(ConfigError, match=r"axis 1: .* do not overlap"):
        workspace_of(arm, replace(robot, upper_rad=np.full(6, -3.0), lower_rad=np.full(6, -4.0)))


@pytest.mark.parametrize("stated", [np.nan, 0.8, 12.0, -1.0])
def test_a_speed_limit_up_to_the_velocity_of_the_robot_is_taken(small_cell, stated):
    arm = small_cell.cell.arm[0]
    robot = replace(arm_robot(small_cell, arm), velocity_rad_s=np.array([stated, 12.0, np.nan, 1.2, 1.2, 1.5]))
    assert workspace_of(arm, robot).speed_rad_s.tolist() == [0.8, 0.8, 0.8, 1.2, 1.2, 1.5]
    slower = replace(robot, velocity_rad_s=np.array([stated, 12.0, np.nan, 1.1, 1.2, 1.5]))
    with pytest.raises(
        ConfigError, match=r"axis 4: speed_limit_rad_s 1\.2 is above the velocity 1\.1 rad/s .*lower it"
    ):
        workspace_of(arm, slower)


def test_rates_without_a_limit_follow_from_the_speed_limit():
    axis = AxisConfig.model_validate(axis_table(speed_limit_rad_s=0.6))
    assert axis.acceleration_rad_s2 == pytest.approx(1.0)
    assert axis.jerk_rad_s3 == pytest.approx(5.0)


def test_box_corners_must_be_in_order():
    with pytest.raises(ValueError, match="must be below"):
        KeepOut(min_m=(0, 0, 0), max_m=(1, 0, 1))


def test_arm_by_name(small_cell):
    assert arm_named(small_cell).name == "main"
    with pytest.raises(ConfigError, match="there is no arm 'left'; it has main"):
        arm_named(small_cell, "left")


def test_a_posture_that_is_no_number_is_not_feasible(workspace):
    assert not workspace.feasible(np.array([[0.0, 0.0, np.nan, 0.0, 0.0, 0.0]]))[0]


def test_an_arm_inside_its_range_has_no_path_in(workspace):
    assert workspace.path_into_range(np.zeros(6)) is None


def test_only_joints_outside_move_inwards(workspace):
    workspace = among_boxes(workspace, NO_BOX)
    q_rad = np.array([0.3, 0.0, workspace.upper_rad[2] + 0.2, 0.0, workspace.lower_rad[4] - 0.1, 0.0])
    path = workspace.path_into_range(q_rad)
    assert path == pytest.approx(
        [0.3, 0, workspace.upper_rad[2] - INWARD_MARGIN_RAD, 0, workspace.lower_rad[4] + INWARD_MARGIN_RAD, 0]
    )
    assert workspace.why_not(path) is None
    assert "joint 3 outside" in workspace.why_not(q_rad)


@pytest.mark.parametrize("beyond", [0.36, 3.0, np.nan])
def test_an_arm_far_outside_is_not_moved(workspace, beyond):
    q_rad = np.zeros(6)
    q_rad[3] = workspace.upper_rad[3] + beyond
    with pytest.raises(PlanRefused, match="joint 4 is .* rad outside .* zero_offset_rad"):
        workspace.path_into_range(q_rad)


def test_a_box_on_the_path_in_refuses(workspace):
    """The box is between both ends, where the flange passes."""
    q_rad = np.array([workspace.upper_rad[0] + 0.3, 0.9, 0.0, 0.0, 0.0, 0.0])
    assert workspace.path_into_range(q_rad) is not None
    between = q_rad - [0.16, 0, 0, 0, 0, 0]
    centre = flange_m(workspace, between[None])[0]
    boxed = among_boxes(workspace, np.array([[centre - 0.005, centre + 0.005]]), radius_m=0.002)
    wide = replace(boxed, upper_rad=workspace.upper_rad + 1)
    assert wide.feasible(np.array([q_rad, q_rad - [0.32, 0, 0, 0, 0, 0]])).all()
    with pytest.raises(PlanRefused, match="path of joint 1 back into its range.*keep_out box 1"):
        boxed.path_into_range(q_rad)
    inside_a_box = among_boxes(workspace, np.array([[[-9.0] * 3, [9.0] * 3]]))
    with pytest.raises(PlanRefused, match="keep_out box 1"):
        inside_a_box.path_into_range(q_rad)


def test_the_first_bad_place_of_a_path_is_named(workspace):
    path = np.zeros((4, 6))
    path[2:, 0] = workspace.upper_rad[0] + 0.1
    refusal = workspace.refused_on(path)
    assert 1.0 < refusal.row <= 2.0
    assert refusal.q_rad[0] == pytest.approx((refusal.row - 1) * (workspace.upper_rad[0] + 0.1))
    assert "joint 1 outside" in refusal.reason
    assert workspace.why_not_path(path).startswith("at [")
    assert workspace.refused_on(path[:2]) is None
    assert "not a finite number" in workspace.why_not_path(np.array([path[0], np.full(6, np.nan)]))
    assert workspace.why_not_path(path[:1]) is None
    assert "joint 1 outside" in workspace.why_not_path(path[3:])


def test_a_path_that_needs_too_much_torque_in_its_middle_is_refused(workspace):
    """The arm is stretched out halfway; at both ends it is not. Whichever of several paths it is."""
    path = np.array([[0.0, -1.2, 0.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0, 0.0, 0.0]])
    places = np.linspace(0, 1, 200)[:, None] * (path[1] - path[0]) + path[0]
    free = replace(among_boxes(workspace, NO_BOX), lower_rad=np.full(6, -3.0), upper_rad=np.full(6, 3.0))
    need = free.holding_torque(places)[:, 1]
    ends = max(need[0], need[-1])
    assert need.max() > 1.2 * ends
    limit = np.full(6, 1e4)
    limit[1] = (need.max() + ends) / 2 / TORQUE_SHARE
    weak = replace(free, torque_nm=limit)
    still = np.zeros_like(path[:1]) + path[0]
    assert weak.feasible(path).all()
    assert weak.path_clear(np.vstack([still, path[:1], still]), np.vstack([still, path[1:], still])).tolist() == [
        True,
        False,
        True,
    ]
    assert "holding torque of joint 2" in weak.why_not_path(path)
    assert free.path_clear(path[:1], path[1:]).tolist() == [True]


def test_the_least_efficient_side_of_the_loads_counts(workspace, postures):
    """A load on the other side of a joint may relieve it: the unloaded arm then needs more."""
    links = gravity_of(workspace, postures, workspace.links)
    relief = replace(workspace, max_load=np.array([3.0, -0.9, 0.0, 0.0]))
    loaded = links + gravity_of(workspace, postures, np.r_[np.zeros(20), relief.max_load])
    expected = np.maximum(np.abs(links), np.abs(loaded)) / workspace.efficiency
    assert relief.holding_torque(postures) == pytest.approx(expected)
    assert (np.abs(loaded) < np.abs(links)).any()


def gravity_of(workspace, q_rad, parameters):
    """Torque (n, 6) of links with these masses and moments, from the gradient of their potential energy."""
    step = 1e-6

    def energy(q):
        frames = link_frames(workspace.robot, q)
        mass, moment = parameters.reshape(6, 4)[:, 0], parameters.reshape(6, 4)[:, 1:]
        weighed = mass[None, :, None] * frames[:, :6, :3, 3] + np.einsum("nlij,lj->nli", frames[:, :6, :3, :3], moment)
        return -weighed.sum(axis=1) @ workspace.gravity_m_s2

    return np.column_stack([(energy(q_rad + d) - energy(q_rad - d)) / (2 * step) for d in step * np.eye(6)])


@pytest.mark.parametrize(("margin", "inside"), [(0.0, True), (0.05, False)])
@pytest.mark.parametrize("end", ["lower_rad", "upper_rad"])
def test_a_joint_may_stand_at_its_limit_and_not_within_the_margin(workspace, margin, inside, end):
    q_rad = np.zeros((1, 6))
    q_rad[0, 3] = getattr(workspace, end)[3]
    assert bool(workspace.violations(q_rad, margin_rad=margin)[3][1][0]) != inside


def test_travel_takes_the_time_of_the_slowest_joint_and_its_ramp(workspace):
    """s / v + v / a of constant acceleration, the longest of either."""
    path = np.array([[0.2, 0.0, 1.0, 0.0, -0.4, 0.0], [0.0] * 6])
    cruise = np.abs(path) / workspace.speed_rad_s
    ramp = max(workspace.speed_rad_s / workspace.acceleration_rad_s2)
    found = workspace.travel_time(np.zeros((2, 6)), path)
    assert found == pytest.approx([cruise[0].max() + ramp, ramp])


def test_the_path_back_in_is_slow(workspace):
    speed = workspace.inward_speed_rad_s()
    assert (speed <= 0.05 + 1e-12).all()
    assert (speed <= 0.1 * workspace.speed_rad_s + 1e-12).all()
    assert ((speed == pytest.approx(0.05)) | (speed == 0.1 * workspace.speed_rad_s)).all()


def test_a_load_without_a_centre_of_gravity_is_a_point_mass_at_the_flange(small_cell):
    arm = small_cell.cell.arm[0].model_copy(update={"max_load_kg": 7.0, "max_load_com_m": None})
    robot = arm_robot(small_cell, arm)
    flange = np.zeros(3) if robot.flange is None else robot.flange[:3, 3]
    assert workspace_of(arm, robot).max_load == pytest.approx([7.0, *(7.0 * flange)])
    with_load = arm.model_copy(update={"max_load_com_m": (0.1, -0.2, 0.3)})
    assert workspace_of(with_load, robot).max_load == pytest.approx([7.0, 0.7, -1.4, 2.1])


def test_masses_and_centres_of_gravity_have_both_to_be_known(small_cell):
    arm = small_cell.cell.arm[0]
    robot = arm_robot(small_cell, arm)
    assert workspace_of(arm, robot).links == pytest.approx(
        np.column_stack([robot.mass_kg, robot.mass_kg[:, None] * robot.com_m]).ravel()
    )
    mass, com = robot.mass_kg.copy(), robot.com_m.copy()
    mass[3], com[2, 1] = np.nan, np.nan
    assert workspace_of(arm, replace(robot, mass_kg=mass)).links is None
    assert workspace_of(arm, replace(robot, com_m=com)).links is None


def test_a_box_beyond_the_first_bad_posture_does_not_hide_it_and_one_before_is_named_first(workspace):
    path = np.zeros((5, 6))
    path[:, 0] = np.linspace(0.0, 1.2, 5)
    free = replace(among_boxes(workspace, NO_BOX), links=None)
    assert free.refused_on(path) is None
    at = {}
    for row in (1.5, 3.5):
        q_rad = np.zeros((1, 6))
        q_rad[0, 0] = 0.3 * row
        point = flange_m(workspace, q_rad)[0]
        at[row] = [point - 0.004, point + 0.004]
    both = among_boxes(free, np.array([at[3.5], at[1.5]]))
    assert 0.5 < both.refused_on(path).row < 1.6
    at_once = among_boxes(free, np.array([at[3.5]]))
    assert 2.0 < at_once.refused_on(path).row < 3.6
    assert "keep_out box 1" in at_once.refused_on(path).reason


def test_a_joint_of_a_narrow_range_moves_to_its_middle(workspace):
    upper = workspace.upper_rad.copy()
    upper[4] = workspace.lower_rad[4] + 0.01
    narrow = replace(workspace, upper_rad=upper)
    q_rad = np.zeros(6)
    q_rad[4] = upper[4] + 0.1
    assert narrow.path_into_range(q_rad)[4] == pytest.approx(workspace.lower_rad[4] + 0.005)
