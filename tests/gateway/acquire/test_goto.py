"""The move command: named postures, a path checked over its whole length, and every stop ends in the brakes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drives.errors import DriveFault
from gateway.acquire.goto import Destination, destination, go, plan_transfer, remarks, transfer_from_here
from gateway.acquire.plan import MoveTo, inward_steps
from gateway.cell.config import KeepOut
from gateway.check.stop import slow_motion
from gateway.errors import ConfigError, LimitExceeded, PlanRefused, WrongPlace
from gateway.model.arm_model import arm_robot
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import refuse_start, smallest_exit, widened, workspace_of

TARGET = (0.3, -0.2, 0.4, 0.5, -0.4, 0.6)
PERIOD_S = 0.01
#: Setpoints come back in counts of the drives.
COUNTS_RAD = 1e-4
LEFT, RIGHT = (-1.2, -0.2, 0.4, 0.0, 0.0, 0.0), (1.2, -0.2, 0.4, 0.0, 0.0, 0.0)


def with_box(cell, low_m, high_m):
    """The workspace of a cell with one keep-out box instead of its own."""
    box = KeepOut(min_m=low_m, max_m=high_m)
    config = cell.cell.arm[0].model_copy(update={"keep_out": (box,)})
    return workspace_of(config, arm_robot(cell, config))


def post(cell):
    """A post in front of the arm that blocks a turn of joint 1 from one side to the other."""
    return with_box(cell, (0.45, -0.05, -0.5), (0.6, 0.05, 0.95))


def went(arm, target, *more):
    """Plan the path and drive it; return the plan."""
    plan = plan_transfer(arm, target)
    go(arm, plan, *more)
    return plan


@pytest.fixture
def config(small_cell):
    return small_cell.cell.arm[0]


@pytest.fixture
def opened(small_cell, config, arm, workspace):
    def make(pacing="lockstep", surroundings=workspace):
        return SimpleNamespace(
            loaded=small_cell,
            config=config,
            workspace=surroundings,
            arm=arm,
            group=SimpleNamespace(timing=SimpleNamespace(pacing=pacing, period_s=PERIOD_S)),
        )

    return make


def stand(fake, q_rad) -> None:
    fake.q_rad = fake.target_rad = np.array(q_rad, dtype=float)


def to(q_rad) -> Destination:
    return Destination("there", tuple(q_rad))


# --------------------------------------------------------------------------------------------------- named postures


def test_home_and_loading_are_those_of_the_cell(config, workspace):
    named = config.model_copy(update={"home_rad": TARGET, "loading_rad": RIGHT})
    assert destination(named, workspace, "home").q_rad == TARGET
    assert destination(named, workspace, "loading").q_rad == RIGHT


def test_home_that_is_not_configured_is_the_middle_of_the_joint_ranges_and_said_to_be(small_cell, config, workspace):
    without_home = config.model_copy(update={"home_rad": None})
    found = destination(without_home, workspace, "home")
    assert found.q_rad == pytest.approx([(low + high) / 2 for low, high in (a.position_limit_rad for a in config.axis)])
    assert "the cell file has no home_rad" in str(found)
    wall = with_box(small_cell, (-2.0, -2.0, 0.0), (2.0, 2.0, 2.0))
    with pytest.raises(PlanRefused, match=r"no home_rad.*keep_out box 1.*choose another posture"):
        destination(without_home, wall, "home")


def test_a_loading_posture_that_is_not_configured_is_asked_for(config, workspace):
    with pytest.raises(ConfigError, match="loading_rad is missing"):
        destination(config.model_copy(update={"loading_rad": None}), workspace, "loading")


@pytest.mark.parametrize(
    ("posture", "says"),
    [((9.0, 0, 0, 0, 0, 0), "joint 1 outside"), ((-1.2, 1.3, 1.0, 0.0, 0.4, 0.0), "in keep_out box 1")],
)
def test_a_posture_where_the_arm_may_not_stand_is_refused_with_what_it_would_touch(config, workspace, posture, says):
    with pytest.raises(PlanRefused, match=says):
        destination(config, workspace, posture)


# ------------------------------------------------------------------------------------------------------------- paths


def test_a_free_path_is_straight(opened, fake, workspace):
    plan = plan_transfer(opened(), to(TARGET))
    assert plan.steps == (MoveTo(TARGET),)
    assert remarks(plan, workspace) == ()


def test_a_path_is_planned_again_only_where_the_arm_has_moved_since(opened, fake):
    plan = plan_transfer(opened(), to(TARGET))
    assert transfer_from_here(opened(), to(TARGET), plan) is plan
    stand(fake, LEFT)
    replanned = transfer_from_here(opened(), to(TARGET), plan)
    assert replanned.start_rad == pytest.approx(LEFT)


def test_a_path_that_is_not_free_goes_round_and_says_what_it_would_touch(small_cell, opened, fake):
    surroundings = post(small_cell)
    stand(fake, LEFT)
    plan = plan_transfer(opened(surroundings=surroundings), to(RIGHT))
    assert len(plan.steps) == 2
    ends = [np.array(LEFT), *(np.array(step.q_rad) for step in plan.steps)]
    for begin, end in zip(ends, ends[1:], strict=False):
        share = np.linspace(0.0, 1.0, 400)[:, None]
        assert surroundings.feasible((1 - share) * begin + share * end).all()
    (said,) = remarks(plan, surroundings)
    assert "in keep_out box 1" in said
    assert "by way of" in said


def test_without_a_free_path_the_message_names_what_the_straight_one_meets(small_cell, opened, fake):
    wall = with_box(small_cell, (0.25, -0.02, -2.0), (3.0, 0.02, 3.0))
    pinned = replace(wall, lower_rad=np.array([-1.3, -0.25, 0.35, -0.1, -0.1, -0.1]))
    pinned = replace(pinned, upper_rad=np.array([1.3, -0.15, 0.45, 0.1, 0.1, 0.1]))
    stand(fake, LEFT)
    with pytest.raises(PlanRefused, match=r"on the straight path, at .*in keep_out box 1.*of your choice"):
        plan_transfer(opened(surroundings=pinned), to(RIGHT))
    assert fake.log == []


@pytest.mark.slow
@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_the_arm_comes_from_outside_its_range_inwards_and_goes_on(opened, fake, workspace, pacing):
    stand(fake, (0.0, 0.2, 0.1, workspace.upper_rad[3] + 0.1, 0.3, 0.0))
    plan = went(opened(pacing), to(TARGET))
    assert plan.steps[0].is_inwards
    assert "joint 4 is outside its range: it first moves slowly back" in remarks(plan, workspace)[0]
    path = np.array(fake.path)
    assert (np.diff(path[:, 3]) <= COUNTS_RAD).all(), "never outwards"
    assert path[-1] == pytest.approx(TARGET, abs=COUNTS_RAD)
    assert fake.log == ["enable", "disable"]


def test_an_arm_inside_a_box_is_not_moved_and_the_path_out_is_named(small_cell, opened, fake):
    stand(fake, (0.0, -0.2, 0.4, 0.0, 0.0, 0.0))
    surroundings = post(small_cell)
    with pytest.raises(
        PlanRefused,
        match=r"in keep_out box 1.*move it clear by hand.*joint [1-6] by [+-].*no command of servo-gateway moves it",
    ) as refused:
        went(opened(surroundings=surroundings), to(LEFT))
    assert not isinstance(refused.value, WrongPlace), "no command leads out of there"
    assert fake.log == []
    said = smallest_exit(surroundings, fake.q_rad)
    joint, turn = int(said.split("joint ")[1][0]), float(said.split(" by ")[1].split(" rad")[0])
    turned = fake.q_rad.copy()
    turned[joint - 1] += turn
    assert surroundings.why_not(turned) is None
    less = fake.q_rad.copy()
    less[joint - 1] += turn * (1 - 0.02 / abs(turn))
    assert surroundings.why_not(less) is not None, "the shortest"


# ---------------------------------------------------------------------------------------------------- motion and ends


@pytest.mark.slow
@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_it_goes_there_at_its_share_of_the_speed_and_ends_in_the_brakes(opened, fake, workspace, pacing):
    messages = []
    went(opened(pacing), to(TARGET), (messages.append,), MoveOptions(override=0.3))
    path = np.array(fake.path)
    assert path[-1] == pytest.approx(TARGET, abs=COUNTS_RAD)
    speed = np.abs(np.diff(path, axis=0)).max(axis=0) / PERIOD_S
    assert (speed <= 0.3 * workspace.speed_rad_s + 2 * COUNTS_RAD / PERIOD_S).all()
    assert fake.log == ["enable", "disable"]
    assert workspace.feasible(path).all()
    assert messages


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_a_lost_drive_ends_it_as_everywhere_else(opened, fake, pacing):
    fake.fault_at = 60
    with pytest.raises(DriveFault):
        went(opened(pacing), to(TARGET))
    assert fake.log == ["enable", "quick stop", "disable"]


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_a_person_stops_it_along_its_path(opened, fake, pacing):
    def asked():
        if fake.sync_index < 80:
            return None
        return StopRequest(StopKind.ALONG_PATH, StoppedByPerson("a person"))

    with pytest.raises(StoppedByPerson):
        went(opened(pacing), to(TARGET), (), MoveOptions(StopDesk(asked)))
    assert fake.log == ["enable", "disable"]
    goal = np.array(TARGET)
    share = fake.q_rad / goal
    assert share.min() > 0.0
    assert share.max() < 1.0
    assert share == pytest.approx(share.mean(), abs=1e-3), "on the line"


def test_contact_during_the_motion_stops_it(opened, fake, workspace):
    fake.contact_nm = {90: 1.2 * workspace.torque_nm[2]}
    with pytest.raises(LimitExceeded, match="joint 3 needs"):
        went(opened(), to(TARGET))
    assert fake.log == ["enable", "quick stop", "disable"]


# ------------------------------------------------------------------------------------- where something may begin


def test_what_goes_to_either_side_does_not_begin_outside_the_range(workspace):
    outside = np.array([0.0, 0.2, 0.1, workspace.upper_rad[3] + 0.1, 0.3, 0.0])
    with pytest.raises(WrongPlace, match="joint 4 outside") as refused:
        refuse_start(workspace, outside, "main")
    assert (refused.value.arm, refused.value.to) == ("main", "home")
    refuse_start(workspace, np.array(TARGET), "main")


def test_the_stop_is_proven_on_the_path_inwards(workspace):
    outside = np.array([0.0, 0.2, 0.1, workspace.upper_rad[3] + 0.1, 0.3, 0.0])
    motion = slow_motion("main", workspace, outside, 0.5, PERIOD_S)
    assert (np.diff(motion.q_rad[:, 3]) < 0).all()
    assert widened(workspace, outside).feasible(motion.q_rad).all()
    assert len(inward_steps(workspace, motion.q_rad[-1], "main")[0]) == 1, "still outside, and further in"
