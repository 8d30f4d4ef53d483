"""Arms under power: the stop fits its cause, and the brakes are closed before any observer is notified."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from drives.errors import BrakeDropped, DriveFault, NotStoodDown
from gateway.errors import LimitExceeded
from gateway.motion.arms import Arms
from gateway.motion.power import BRAKE_DROP_RAD, powered
from gateway.motion.state import Phase
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import FIRST_SHARE, MoveOptions, Stream
from gateway.motion.trajectory import MotionLimits, straight

PERIOD_S = 0.01
TARGET = np.array([0.3, 0.2, -0.2, 0.1, 0.2, -0.3])


@pytest.fixture
def reported() -> list:
    return []


@pytest.fixture
def make(arm, workspace, reported):
    def make(
        options=None, pacing="lockstep", state_changed=lambda state: reported.append(state.phase), **more
    ) -> Stream:
        return Stream(Arms((arm,), pacing), (workspace,), PERIOD_S, options, state_changed=state_changed, **more)

    return make


@pytest.fixture
def stream(make) -> Stream:
    return make()


def move(stream: Stream, workspace, target=TARGET) -> None:
    limits = MotionLimits(0.9 * workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
    stream.move([straight(stream.q_rad[0], target, limits, PERIOD_S)], "move")


def test_a_motion_ends_with_the_brakes_on(stream, workspace, fake, reported):
    with powered(stream):
        assert stream.options.desk.under_power
        move(stream, workspace)
    assert fake.log == ["enable", "disable"]
    assert fake.q_rad == pytest.approx(TARGET, abs=1e-5)
    assert reported == [Phase.HOLDING, Phase.STOPPING, Phase.IN_BRAKES]
    assert not stream.options.desk.under_power


def test_a_wish_to_stop_brings_the_arm_to_rest_along_its_path(make, workspace, fake):
    moved = make(MoveOptions(fake.asks_at(40, StopKind.ALONG_PATH)))
    with pytest.raises(StoppedByPerson), powered(moved) as stream:
        move(stream, workspace)
    assert fake.log == ["enable", "disable"]
    path = np.array(fake.path)
    acceleration = np.diff(path, n=2, axis=0) / PERIOD_S**2
    assert (np.abs(acceleration) <= 1.05 * workspace.acceleration_rad_s2).all()
    share = path @ TARGET / (TARGET @ TARGET)
    assert path == pytest.approx(share[:, None] * TARGET, abs=1e-6)
    assert 0.05 < share[-1] < 0.95


def test_an_urgent_wish_is_a_quick_stop_with_the_next_sync(make, workspace, fake):
    moved = make(MoveOptions(fake.asks_at(40, StopKind.QUICK_STOP)))
    with pytest.raises(StoppedByPerson), powered(moved) as stream:
        move(stream, workspace)
    assert fake.log == ["enable", "quick stop", "disable"]
    assert fake.sync_index == 40


def test_a_wish_while_the_arm_is_at_rest_is_answered_at_once(make, fake):
    moved = make(MoveOptions(fake.asks_at(5, StopKind.ALONG_PATH)))
    with pytest.raises(StoppedByPerson), powered(moved) as stream:
        stream.stand(1.0, "hold")
    assert fake.log == ["enable", "disable"]
    assert fake.sync_index == 5


def test_a_wish_during_enabling_powers_nothing(make, fake):
    asked = []

    def enable(stop_requested):
        asked.append(stop_requested())
        raise DriveFault("a stop was asked for")

    fake.enable = enable
    moved = make(MoveOptions(fake.asks_at(0, StopKind.ALONG_PATH)))
    with pytest.raises(StoppedByPerson), powered(moved):
        pass
    assert asked == [True]
    assert fake.log[-1] == "disable"


def test_a_defect_while_set_points_go_out_is_a_quick_stop(stream, workspace, fake):
    exchange = fake.exchange

    def broken(commands):
        if fake.sync_index == 30:
            raise ZeroDivisionError
        return exchange(commands)

    fake.exchange = broken
    with pytest.raises(ZeroDivisionError), powered(stream):
        move(stream, workspace)
    assert fake.log == ["enable", "quick stop", "disable"]


def test_observers_are_notified_after_the_arm_is_safe_and_cannot_prevent_it(make, workspace, fake):
    log = []

    def listen(state):
        log.append((state.phase, fake.enabled))
        if state.phase is Phase.STOPPING:
            raise BrokenPipeError(32, "Broken pipe")

    options = MoveOptions(fake.asks_at(40, StopKind.QUICK_STOP))
    moved = make(options, state_changed=listen)
    with pytest.raises(BrokenPipeError), powered(moved) as stream:
        move(stream, workspace)
    assert (Phase.STOPPING, False) in log
    assert fake.log == ["enable", "quick stop", "disable"]


def test_a_report_that_fails_stops_the_arm_along_its_path(make, workspace, fake):
    def report(what, row, rows):
        if row > 10:
            raise BrokenPipeError(32, "Broken pipe")

    with pytest.raises(StoppedByPerson, match="terminal"), powered(make(report=report)) as stream:
        move(stream, workspace)
    assert fake.log == ["enable", "disable"]


def test_the_first_motion_with_a_set_of_drives_is_slow_and_the_next_one_is_not(make, workspace, fake):
    done = []
    options = MoveOptions(override=0.8, first_done=lambda: done.append(fake.sync_index))
    with powered(make(options)) as stream:
        move(stream, workspace)
        first = np.abs(np.diff(np.array(fake.path), axis=0)).max(axis=0) / PERIOD_S
        count = len(fake.path)
        move(stream, workspace, np.zeros(6))
    second = np.abs(np.diff(np.array(fake.path[count:]), axis=0)).max(axis=0) / PERIOD_S
    assert first / second == pytest.approx(FIRST_SHARE / 0.8, rel=0.02)
    assert done == [fake.sync_index]


def test_a_joint_that_sinks_in_its_brake_is_reported(stream, fake):
    tracker = stream.state
    fake.brake_drop_rad = fake.axes.motor_velocity(np.array([0.0, 0.008, 0.0, 0.0, 0.0, 0.0])).tolist()
    with pytest.raises(BrakeDropped, match=r"joint 2 sank by 0\.0080 rad"), powered(stream):
        pass
    assert "joint 2 sank by 0.0080 rad" in tracker.state.reason


@pytest.mark.parametrize("cause", [StoppedByPerson("a person"), LimitExceeded("too fast", 1)])
def test_a_drop_after_a_stop_is_an_error_of_the_drives_that_names_the_stop(stream, fake, cause):
    fake.brake_drop_rad = fake.axes.motor_velocity(np.array([0.0, 0.008, 0.0, 0.0, 0.0, 0.0])).tolist()
    with pytest.raises(BrakeDropped) as dropped, powered(stream):
        raise cause
    assert dropped.value.exit_code == 4
    assert any(str(cause) in note for note in dropped.value.__notes__)


@pytest.mark.parametrize(("sunk_rad", "said"), [(0.9, False), (1.1, True)])
def test_a_joint_sinks_from_a_limit_on(stream, fake, sunk_rad, said):
    drop_rad = np.zeros(6)
    drop_rad[3] = sunk_rad * BRAKE_DROP_RAD
    fake.brake_drop_rad = np.abs(fake.axes.motor_velocity(drop_rad)).tolist()
    with pytest.raises(BrakeDropped) if said else nullcontext(), powered(stream):
        pass
    assert ("joint 4 sank" in stream.state.state.reason) == said
    assert ("check these brakes" in stream.state.state.reason) == said


def test_a_stop_that_fails_without_another_error_is_raised(stream, fake):
    def broken():
        raise DriveFault("cannot be disabled", node=4)

    fake.disable = broken
    with pytest.raises(DriveFault, match="cannot be disabled") as failed, powered(stream):
        pass
    assert not stream.options.desk.under_power
    assert stream.state.state.phase is Phase.UNKNOWN
    assert any("use the emergency stop (node 1: OPERATION ENABLED)" in note for note in failed.value.__notes__)


def test_drives_that_are_disabled_are_in_their_brakes_whatever_fails_afterwards(stream, fake):
    def full_disk():
        fake.enabled = False
        raise NotStoodDown("every drive was read as disabled; then: the write ledger cannot be written")

    fake.disable = full_disk
    with pytest.raises(StoppedByPerson) as stopped, powered(stream):
        raise StoppedByPerson("a person")
    assert stream.state.state.phase is Phase.STOPPED
    assert not any("emergency stop" in note for note in stopped.value.__notes__)


def test_a_drop_after_an_error_is_among_its_notes_with_time_and_sync(stream, workspace, fake):
    fake.fault_at = 30
    fake.brake_drop_rad = np.abs(fake.axes.motor_velocity(np.full(6, 2 * BRAKE_DROP_RAD))).tolist()
    with pytest.raises(DriveFault, match="FAULT") as failed, powered(stream):
        move(stream, workspace)
    notes = " ".join(failed.value.__notes__)
    assert "joint 1 sank" in notes
    assert "SYNC 29 of this run" in notes
    assert stream.state.state.phase is Phase.STOPPED
    assert "FAULT" in stream.state.state.reason


def test_a_first_motion_that_was_stopped_is_not_done(make, workspace, fake):
    done = []
    asked = MoveOptions(fake.asks_at(40, StopKind.ALONG_PATH))
    options = replace(asked, first_done=lambda: done.append(1))
    with pytest.raises(StoppedByPerson), powered(make(options)) as stream:
        move(stream, workspace)
    assert done == []


def test_by_the_clock_the_scheduler_is_asked_for_while_power_is_on(make, stream, fake, monkeypatch):
    log = []

    class Asked:
        def __enter__(self):
            log.append(("real time", fake.enabled))

        def __exit__(self, *_):
            log.append(("usual", fake.enabled))

    monkeypatch.setattr("gateway.motion.power.RealTime", Asked)
    with powered(stream):
        pass
    assert log == []
    with powered(make(pacing="real")):
        assert fake.enabled
    assert log == [("real time", False), ("usual", False)]


def test_a_wish_that_comes_with_the_last_sync_is_reported(make, fake):
    wish = StopRequest(StopKind.ALONG_PATH, StoppedByPerson("a person"))
    asked = []
    options = MoveOptions(StopDesk(lambda: wish if asked else None))
    with pytest.raises(StoppedByPerson), powered(make(options)):
        asked.append(1)
    assert fake.log == ["enable", "disable"]


def test_an_error_of_a_drive_is_kept_and_what_fails_while_stopping_joins_it(stream, workspace, fake):
    fake.fault_at = 30

    def broken():
        raise DriveFault("cannot be disabled", node=4)

    fake.disable = broken
    with pytest.raises(DriveFault, match="FAULT") as failed, powered(stream):
        move(stream, workspace)
    assert any("cannot be disabled" in note for note in failed.value.__notes__)
