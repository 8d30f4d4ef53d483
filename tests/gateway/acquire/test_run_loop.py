"""The loop: what was planned is driven and measured, and every failure ends with the brakes on and the data kept."""

from dataclasses import replace

import numpy as np
import pytest

from drives.errors import DriveFault, IncompleteEpochs
from gateway.acquire.events import PoseDone, Progress, SampleRepeated, Started, StateChanged, Stopped, VisitDone
from gateway.acquire.plan import Plan, VisitSettings, plan_poses
from gateway.acquire.run_loop import rest_visits
from gateway.acquire.visit_store import MemoryStore
from gateway.data.visit import RestPose
from gateway.errors import InputError, LimitExceeded, PlanRefused, PoseNeverSettles
from gateway.motion.reactions import ARM_RULES
from gateway.motion.state import SAFE, Phase
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions

SETTINGS = VisitSettings(
    approach_offset_rad=0.03, approach_speed_rad_s=0.05, settle_timeout_s=2.0, samples=40, period_s=0.01
)
POSES = (
    RestPose(1, (0.2, 0.3, 0.2, 0.1, 0.5, -0.4), "fit"),
    RestPose(2, (-0.1, 0.5, -0.3, 0.6, -0.5, 0.3), "validation"),
)


@pytest.fixture
def measure(run, arm, workspace):
    """Measure a plan; what a run is made with may be replaced."""
    return lambda plan, load="none", done=(), **more: run(**more).execute(rest_visits(plan, arm, workspace, done), load)


@pytest.fixture
def plan(workspace) -> Plan:
    plan, unreachable = plan_poses("main", workspace, POSES, SETTINGS)
    assert not unreachable
    return plan


def test_all_poses_are_measured_from_both_sides(measure, plan, store, events, fake):
    measure(plan, "a")
    assert fake.log == ["enable", "disable"]
    assert not fake.enabled
    assert sorted((v.pose, v.approach) for v in store.visits) == [(1, -1), (1, 1), (2, -1), (2, 1)]
    for visit in store.visits:
        assert visit.complete
        assert len(visit) == SETTINGS.samples
        assert (visit.direction == visit.approach).all()
        assert visit.load == "a"
        assert visit.purpose == ("fit" if visit.pose == 1 else "validation")
        assert visit.q_rad.mean(axis=0) == pytest.approx(POSES[visit.pose - 1].q_rad, abs=1e-5)
        assert np.diff(visit.sync_index).tolist() == [1] * (SETTINGS.samples - 1)
    assert isinstance(events[0], Started)
    assert sum(isinstance(event, VisitDone) for event in events) == 4
    assert not any(isinstance(event, Stopped) for event in events)


def test_half_sums_are_gravity_and_half_differences_the_band(measure, arm, plan, events, fake):
    """Without gear losses: half sum = gravity of the fake, half difference = its band."""
    fake.axes = replace(fake.axes, efficiency=np.ones(6))
    arm.axes = fake.axes
    measure(plan)
    done = [event for event in events if isinstance(event, PoseDone)]
    assert sorted(event.pose for event in done) == [1, 2]
    for event in done:
        gravity = fake.gravity(np.array(POSES[event.pose - 1].q_rad))
        assert event.gravity_nm == pytest.approx(gravity, abs=0.2)
        assert event.friction_band_nm == pytest.approx(fake.band_nm, abs=0.2)


def test_motion_keeps_the_limits(measure, plan, fake, workspace):
    measure(plan)
    path = np.array(fake.path)
    speed = np.diff(path, axis=0) / SETTINGS.period_s
    acceleration = np.diff(speed, axis=0) / SETTINGS.period_s
    assert (np.abs(speed).max(axis=0) <= workspace.speed_rad_s).all()
    assert (np.abs(acceleration).max(axis=0) <= workspace.acceleration_rad_s2 * 1.01).all()
    assert workspace.feasible(path).all()


def test_remaining_time_falls_to_zero(measure, plan, events):
    measure(plan)
    progress = [event for event in events if isinstance(event, Progress)]
    remaining = [event.remaining_s for event in progress]
    assert remaining[0] == pytest.approx(events[0].duration_s)
    assert (np.diff(remaining) <= 1e-9).all()
    assert remaining[-1] == 0.0
    assert len(progress) > 20


def test_done_visits_are_left_out(measure, plan, store):
    measure(plan, done=((1, -1), (1, 1), (2, -1)))
    assert [(v.pose, v.approach) for v in store.visits] == [(2, 1)]


def test_incomplete_epochs_are_sampled_again_and_marked(measure, plan, store, events, fake):
    lost = {sync: sync % 6 for sync in range(5, 20_000, 9)}
    fake.unanswered = lost
    measure(plan)
    for visit in store.visits:
        assert len(visit) == SETTINGS.samples
        assert visit.incomplete_epochs > 0
        assert not set(visit.sync_index.tolist()) & set(lost)
    repeated = [event for event in events if isinstance(event, SampleRepeated)]
    assert all(event.axes == (lost[event.sync_index] + 1,) for event in repeated)
    assert len(repeated) == sum(visit.incomplete_epochs for visit in store.visits)


def stopped_by(asked, kind=StopKind.ALONG_PATH) -> MoveOptions:
    """An operator stops the arm as soon as `asked` says so."""
    return MoveOptions(StopDesk(lambda: StopRequest(kind, StoppedByPerson("a person")) if asked() else None))


def brought_to_rest(fake) -> bool:
    return not fake.enabled and fake.log[-1] == "disable"


def test_too_many_incomplete_epochs_give_the_visit_up(measure, plan, store, events, fake):
    fake.unanswered = dict.fromkeys(range(0, 20000, 2), 2)
    with pytest.raises(IncompleteEpochs, match="were not answered by all axes"):
        measure(plan)
    assert brought_to_rest(fake)
    assert [visit.complete for visit in store.visits] == [False]
    assert isinstance(events[-1], Stopped)


def test_a_pose_that_never_settles(measure, plan, store, fake):
    fake.swing_nm = 3.0
    with pytest.raises(PoseNeverSettles, match="joint 5") as stopped:
        measure(plan)
    assert stopped.value.exit_code == 5
    assert stopped.value.joint == 5
    assert brought_to_rest(fake)
    assert store.visits == []


def test_contact_stops_by_the_drives_ramp(measure, plan, fake, workspace):
    fake.contact_nm = {200: 1.2 * workspace.torque_nm[2]}
    with pytest.raises(LimitExceeded, match="joint 3 needs") as stopped:
        measure(plan)
    assert stopped.value.joint == 3
    assert fake.sync_index == 200 + ARM_RULES["limits"].count - 1
    assert fake.log == ["enable", "quick stop", "disable"]


def test_the_state_of_the_cell_is_reported_throughout(measure, plan, fake):
    states = []
    measure(plan, "a", listeners=(states.append,))
    phases = [event.state.phase for event in states if isinstance(event, StateChanged)]
    assert phases[:4] == [Phase.HOLDING, Phase.MOVING, Phase.SETTLING, Phase.SAMPLING]
    assert phases[-2:] == [Phase.STOPPING, Phase.IN_BRAKES]
    states.clear()
    fake.fault_at = fake.sync_index + 100
    with pytest.raises(DriveFault) as failed:
        measure(plan, "a", listeners=(states.append,))
    stopping, stopped = [event.state for event in states if isinstance(event, StateChanged)][-2:]
    assert (stopping.phase, stopped.phase) == (Phase.STOPPING, Phase.STOPPED)
    assert stopped.phase in SAFE
    assert str(failed.value) in str(stopped)
    assert f"SYNC {stopping.sync_index} of this run" in failed.value.__notes__[-1]


def test_a_joint_that_does_not_follow(measure, plan, fake):
    fake.jam_at = 60
    with pytest.raises(LimitExceeded, match=r"joint 2 (is .* off its target|was commanded to move by)"):
        measure(plan)
    assert fake.log == ["enable", "quick stop", "disable"]


def test_drive_fault(measure, plan, store, fake):
    measure(plan, store=MemoryStore())
    syncs = fake.sync_index
    fake.fault_at = syncs + int(0.9 * syncs)
    with pytest.raises(DriveFault):
        measure(plan)
    assert fake.log[-2:] == ["quick stop", "disable"]
    assert len(store.visits) >= 2


def test_a_wish_to_stop_stops_gently_and_keeps_the_data(measure, plan, store, events, fake, workspace):
    visits_before_stop = 2

    def asked() -> bool:
        moved = len(fake.path) > 3 and np.abs(fake.path[-1] - fake.path[-2]).max() > 0.002
        return len(store.visits) == visits_before_stop and moved

    with pytest.raises(KeyboardInterrupt):
        measure(plan, options=stopped_by(asked))
    assert fake.log == ["enable", "disable"]
    assert len(store.visits) == visits_before_stop
    speed = np.diff(np.array(fake.path), axis=0) / SETTINGS.period_s
    assert np.abs(speed[-1]).max() < 0.05
    acceleration = np.diff(speed, axis=0) / SETTINGS.period_s
    assert (np.abs(acceleration).max(axis=0) <= workspace.acceleration_rad_s2 * 1.01).all()
    brake = np.array(fake.path[-20:]) - fake.path[-1]
    assert np.linalg.svd(brake)[1][1] < 1e-3 * np.linalg.svd(brake)[1][0]
    assert isinstance(events[-1], Stopped)


def test_a_wish_to_stop_while_sampling_keeps_the_samples_marked_incomplete(measure, plan, store, fake, events):
    def asked() -> bool:
        return sum(isinstance(e, Progress) and e.what == "sample pose 2" for e in events) == 2

    with pytest.raises(KeyboardInterrupt):
        measure(plan, options=stopped_by(asked))
    assert brought_to_rest(fake)
    assert not store.visits[-1].complete
    assert 0 < len(store.visits[-1]) < SETTINGS.samples


def test_full_disk_stops_the_arm(measure, plan, store, fake):
    store.full_after = 1
    with pytest.raises(InputError, match="No space left"):
        measure(plan)
    assert brought_to_rest(fake)
    assert len(store.visits) == 1


def test_a_start_outside_the_limits_is_refused_before_anything_is_enabled(measure, plan, fake):
    fake.q_rad = np.array([0.0, 0.0, 0.0, 0.0, 2.5, 0.0])
    with pytest.raises(PlanRefused, match="joint 5 is .* rad outside"):
        measure(plan)
    assert fake.log == []


def test_an_arm_that_drops_when_its_brakes_open_is_not_moved(measure, plan, fake):
    fake.drop_on_enable_rad = 0.05
    with pytest.raises(PlanRefused, match="while its brake opened"):
        measure(plan)
    assert brought_to_rest(fake)
    assert len(fake.path) == 1


def test_errors_while_stopping_are_added_not_hidden(measure, plan, fake):
    def broken() -> None:
        fake.log.append("quick stop")
        raise DriveFault("cannot be stopped", node=4)

    fake.quick_stop = broken
    fake.fault_at = 50
    with pytest.raises(DriveFault, match="FAULT") as stopped:
        measure(plan)
    assert "cannot be stopped" in stopped.value.__notes__[0]
    assert brought_to_rest(fake)


def test_an_arm_outside_its_range_comes_back_slowly_first(measure, plan, fake, workspace, store):
    fake.q_rad = fake.target_rad = np.array([0.0, 0.2, 0.1, workspace.upper_rad[3] + 0.015, 0.3, 0.0])
    measure(plan)
    path = np.array(fake.path)
    inside = int(np.argmax(path[:, 3] <= workspace.upper_rad[3] - 0.0199))
    speed = np.diff(path[: inside + 1], axis=0) / SETTINGS.period_s
    counts = 1e-4
    assert np.abs(speed[:, [0, 1, 2, 4, 5]]).max() < counts
    assert speed[:, 3].max() < counts
    assert 0.02 < -speed[:, 3].min() < 0.05 + counts
    assert len(store.visits) == 4
