"""The loop that sends setpoints: how long it holds, whom it reads and notifies, when it comes to rest."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from unittest.mock import Mock

import numpy as np
import pytest

from gateway.errors import LimitExceeded
from gateway.motion.arms import Arms
from gateway.motion.observer import Observers
from gateway.motion.power import powered
from gateway.motion.setpoints import MotionSetpoints
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson
from gateway.motion.stream import REPORT_S, REST_LONGEST_S, REST_SYNCS, MoveOptions, Stream
from gateway.motion.trajectory import Motion, MotionLimits, straight
from gateway.motion.watch import TAKE_OVER_S, Watch

PERIOD_S = 0.01
TARGET = np.array([0.3, 0.2, -0.2, 0.1, 0.2, -0.3])


@pytest.fixture
def notified() -> list[tuple[str, int, int]]:
    return []


@pytest.fixture
def make(arm, workspace, notified) -> Callable[..., Stream]:
    def make(pacing: str = "lockstep", **options) -> Stream:
        arms, keep = Arms((arm,), pacing), lambda *report: notified.append(report)  # type: ignore[arg-type]
        stream = Stream(arms, (workspace,), PERIOD_S, MoveOptions(**options), keep)
        stream.start()
        return stream

    return make


def motion_of(stream: Stream, workspace, target: np.ndarray = TARGET) -> Motion:
    limits = MotionLimits(workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
    return straight(stream.q_rad[0], target, limits, PERIOD_S)


def move(stream: Stream, workspace, target: np.ndarray = TARGET) -> None:
    stream.move([motion_of(stream, workspace, target)], "move")


def rates_of(stream: Stream, workspace, listen: Callable[[list[float]], None] = lambda _rates: None) -> list[float]:
    """Rate at every SYNC of the motion to the target, which a person stops."""
    source, rates = MotionSetpoints(stream.q_rad, [motion_of(stream, workspace)]), list[float]()
    source.take = lambda _at, rate, _samples: (rates.append(rate), listen(rates))  # type: ignore[method-assign]
    with pytest.raises(StoppedByPerson):
        stream.drive(source, "move")
    return rates


@pytest.mark.parametrize(("seconds", "syncs"), [(0.0, 0), (0.3, 30), (0.07, 7), (0.301, 31), (0.3 + 1e-13, 30)])
def test_it_waits_for_as_many_whole_periods_as_cover_the_time(make, fake, seconds, syncs):
    stream = make()
    notified = []
    before = fake.sync_index
    stream.stand(seconds, "hold", notified.append)
    assert fake.sync_index - before == len(notified) == syncs
    assert [samples[0].sync_index for samples in notified] == list(range(before + 1, before + 1 + syncs))
    assert stream.sync_index == fake.sync_index


def test_the_brakes_are_given_their_time_and_then_a_jump_of_torque_is_contact(make, fake, workspace):
    """While the drives take over from the brakes the torque may jump; afterwards it may not."""
    stream = make()
    fake.contact_nm = {fake.sync_index + 3: 0.5 * workspace.torque_nm[2]}
    stream.take_over()
    assert fake.sync_index == 1 + round(TAKE_OVER_S / PERIOD_S)
    stream.stand(0.2, "hold")
    fake.contact_nm[fake.sync_index + 1] = -0.5 * workspace.torque_nm[2]
    with pytest.raises(LimitExceeded, match="joint 3: the torque has jumped"):
        stream.stand(0.2, "hold")


def test_observers_are_notified_four_times_a_second(make, notified):
    stream = make()
    stream.stand(2.0, "hold")
    assert [row for _, row, _ in notified] == list(range(0, 200, round(REPORT_S / PERIOD_S)))
    assert {(what, rows) for what, _, rows in notified} == {("hold", 200)}


def test_setpoints_begin_where_the_arm_is_and_no_motion_is_none(make, fake, workspace):
    fake.q_rad = TARGET.copy()
    stream = make()
    assert stream.q_rad[0] == pytest.approx(TARGET, abs=1e-4)
    before = fake.sync_index
    move(stream, workspace, stream.q_rad[0])
    assert fake.sync_index == before
    assert not stream.moving


@pytest.mark.parametrize(("kind", "urgent"), [(StopKind.ALONG_PATH, False), (StopKind.QUICK_STOP, True)])
@pytest.mark.parametrize("moving", [False, True])
def test_a_wish_says_how_urgent_it_is(make, fake, workspace, kind, urgent, moving):
    stream = make(desk=fake.asks_at(20, kind))
    with pytest.raises(StoppedByPerson):
        move(stream, workspace) if moving else stream.stand(1.0, "hold")
    assert stream.urgent == urgent
    # along the path the arm has come to rest by then; an urgent stop is left to the drives
    assert stream.moving == (moving and urgent)


def test_a_wish_that_becomes_urgent_while_the_arm_comes_to_rest_is_detected(make, fake, workspace):
    """The servo lags, so that rest takes a while after the last setpoint."""
    lag = 0.9
    plain = fake.follow

    def follow() -> None:
        before = fake.q_rad
        plain()
        fake.q_rad = lag * before + (1 - lag) * fake.q_rad

    desk = StopDesk()
    stream = make(desk=desk)
    fake.follow = follow

    def ask(rates: list[float]) -> None:
        if rates.count(0.0) == 2:
            desk.ask(StoppedByPerson("again"), StopKind.QUICK_STOP)
        elif len(rates) == 30:
            desk.ask(StoppedByPerson("once"))

    assert rates_of(stream, workspace, ask).count(0.0) == 2
    assert stream.urgent
    assert str(desk.look().cause) == "once"


@pytest.mark.parametrize(("swing_rad", "rest_s"), [(0.0, (REST_SYNCS + 1) * PERIOD_S), (1e-3, REST_LONGEST_S)])
def test_a_stop_ends_when_the_joints_stand_and_at_the_latest_after_its_time(make, fake, workspace, swing_rad, rest_s):
    stream = make(desk=fake.asks_at(40))
    plain = fake.follow

    def follow() -> None:
        plain()
        fake.q_rad = fake.q_rad + swing_rad * (-1) ** fake.sync_index

    fake.follow = follow
    assert rates_of(stream, workspace).count(0.0) * PERIOD_S == pytest.approx(rest_s)
    assert not stream.moving


def test_a_joint_that_is_read_with_delay_is_not_at_rest(make, fake, workspace):
    """The servo lags, and its drive shows every position in three SYNCs."""
    stream = make(desk=fake.asks_at(40))
    plain, at = fake.follow, [fake.q_rad.copy()]

    def follow() -> None:
        plain()
        at.append(0.9 * at[-1] + 0.1 * fake.q_rad)
        fake.q_rad = at[fake.sync_index // 3 * 3 - fake.sync_index - 1].copy()

    fake.follow = follow
    with pytest.raises(StoppedByPerson):
        move(stream, workspace)
    assert at[-1] == pytest.approx(stream.q_rad[0], abs=5e-4)


def test_in_lockstep_a_job_is_just_done(make, fake):
    stream = make()
    before, switch_s = fake.sync_index, sys.getswitchinterval()
    assert stream.hold_while(lambda: threading.current_thread(), "work") is threading.main_thread()
    assert fake.sync_index == before
    assert sys.getswitchinterval() == switch_s


def test_by_the_clock_the_arm_is_held_while_a_job_is_done_beside_it(make, fake):
    stream = make("real")
    stream.arms.enabled = True
    go_on = threading.Event()
    held = fake.hold

    def hold():
        if fake.sync_index >= 10:
            go_on.set()
        return held()

    fake.hold = hold
    switch_s = sys.getswitchinterval()
    assert stream.hold_while(lambda: go_on.wait(10.0) and threading.current_thread().name, "work").startswith("beside")
    assert fake.sync_index >= 10
    assert sys.getswitchinterval() == switch_s


@pytest.mark.parametrize("kind", StopKind)
def test_a_stop_does_not_wait_for_the_job_beside_the_arm(make, fake, kind):
    """The axes are disabled while the job is still running; SYNCs go on until then."""
    desk, release = StopDesk(), threading.Event()
    stream = make("real", desk=desk)
    ended, running = list[bool](), list[bool]()
    plain, held = fake.disable, fake.hold

    def disable() -> None:
        running.append(not ended)
        plain()

    def hold():
        if fake.sync_index == 20:
            desk.ask(StoppedByPerson("a person"), kind)
        return held()

    def job() -> None:
        release.wait(5.0)
        ended.append(True)

    def work() -> None:
        with powered(stream):
            stream.arms.enabled = True
            stream.hold_while(job, "work")

    fake.disable, fake.hold = disable, hold
    try:
        with pytest.raises(StoppedByPerson):
            work()
        assert running == [True]
        assert fake.sync_index == 21
    finally:
        release.set()


def test_the_first_sync_of_an_arm_that_has_just_moved_is_over_before_a_job_begins(make, fake):
    """The drives' watch for stalls takes it for one of a moving arm, and a job may delay it."""
    stream = make("real")
    stream.arms.enabled = True
    before = fake.sync_index
    assert stream.hold_while(lambda: fake.sync_index, "work") > before


def test_a_job_that_fails_beside_the_arm_is_raised(make):
    stream = make("real")
    stream.arms.enabled = True
    switch_s = sys.getswitchinterval()
    with pytest.raises(ZeroDivisionError):
        stream.hold_while(lambda: 1 / 0, "work")
    assert sys.getswitchinterval() == switch_s


def test_arms_in_their_brakes_are_not_held_meanwhile(make, fake):
    stream = make("real")
    stream.arms.enabled = False
    before = fake.sync_index
    assert stream.hold_while(lambda: 5, "work") == 5
    assert fake.sync_index == before


@pytest.mark.parametrize(("pacing", "more"), [("real", 1), ("lockstep", 0)])
def test_by_the_clock_a_motion_begins_with_one_sync_at_rest(make, fake, workspace, pacing, more):
    """What was computed since the last SYNC must not pass for a stall of the motion."""
    stream = make(pacing)
    motion = motion_of(stream, workspace)
    before = fake.sync_index
    stream.move([motion], "move")
    assert fake.sync_index - before == len(motion) + more


@pytest.mark.parametrize(("override", "done"), [(1.0, None), (0.5, None), (1.0, lambda: None), (0.05, lambda: None)])
def test_the_first_motion_is_never_faster_than_the_override(make, fake, workspace, override, done):
    stream = make(override=override, first_done=done)
    motion = motion_of(stream, workspace)
    before = fake.sync_index
    stream.move([motion], "move")
    share = override if done is None else min(0.1, override)
    assert fake.sync_index - before == pytest.approx(len(motion) / share, abs=2)
    assert stream.first_moved == (done is not None)


def test_a_first_motion_that_was_stopped_has_not_ended(make, fake, workspace):
    stream = make(desk=fake.asks_at(60), first_done=lambda: None)
    with pytest.raises(StoppedByPerson):
        move(stream, workspace)
    assert not stream.first_moved


def test_the_monitor_uses_the_gravity_of_the_present_posture(make, fake, workspace):
    observer = Mock()
    stream = make(observers=Observers(observer))
    move(stream, workspace)
    stream.stand(PERIOD_S, "hold")
    expected = Watch("main", workspace, PERIOD_S).modelled_torque(TARGET[None])[0]
    assert observer.sampled.call_args.args[0].modelled_nm[0] == pytest.approx(expected, abs=1e-6)
