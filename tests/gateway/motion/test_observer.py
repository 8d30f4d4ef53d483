"""An observer receives every SYNC and every event, and can neither stop nor delay motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drives.errors import DriveFault
from gateway.errors import LimitExceeded
from gateway.model.regressor import gravity_regressor
from gateway.motion.arms import Arms
from gateway.motion.observer import MotionProgress, Observed, Observers
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions, Stream
from gateway.motion.trajectory import MotionLimits, straight
from gateway.motion.watch import TAKE_OVER_S

PERIOD_S = 0.01
TARGET = np.array([0.3, 0.2, -0.2, 0.1, 0.2, -0.3])


class Seen:
    """Keeps what it is handed."""

    def __init__(self) -> None:
        self.begun: list[tuple] = []
        self.rows: list[Observed] = []
        self.events: list[object] = []
        self.ends: list[BaseException | None] = []

    def began(self, *arms) -> None:
        self.begun.append(arms)

    def sampled(self, observed: Observed) -> None:
        self.rows.append(observed)

    def reported(self, event: object) -> None:
        self.events.append(event)

    def ended(self, failure: BaseException | None) -> None:
        self.ends.append(failure)


class Broken(Seen):
    """Raises with the first SYNC."""

    def sampled(self, observed: Observed) -> None:
        super().sampled(observed)
        raise RuntimeError("a defect of who looks on")


def stream_of(arm, workspace, *observers) -> Stream:
    return Stream(Arms((arm,), "lockstep"), (workspace,), PERIOD_S, MoveOptions(observers=Observers(*observers)))


def drive(stream: Stream, workspace) -> None:
    limits = MotionLimits(0.9 * workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
    with powered(stream):
        stream.take_over()
        stream.move([straight(stream.q_rad[0], TARGET, limits, PERIOD_S)], "move")


def test_every_sync_is_handed_on_once_with_its_targets_and_model(arm, workspace, fake):
    seen = Seen()
    stream = stream_of(arm, workspace, seen)
    drive(stream, workspace)
    assert [each.samples[0].sync_index for each in seen.rows] == list(range(2, fake.sync_index + 1))
    assert seen.begun == [(stream.arms, (workspace,), PERIOD_S, stream.state)]
    assert seen.ends == [None]
    last = seen.rows[-1]
    assert last.targets_rad[0] == pytest.approx(TARGET)
    assert last.samples[0].q_rad == pytest.approx(TARGET, abs=1e-4)
    gravity_nm = gravity_regressor(workspace.robot, TARGET[None], workspace.gravity_m_s2) @ workspace.links
    assert last.modelled_nm[0] == pytest.approx(gravity_nm[0])
    progress = [event for event in seen.events if isinstance(event, MotionProgress)]
    assert {event.what for event in progress} == {"open the brakes", "move"}


def test_the_sync_that_ends_a_motion_is_handed_on_before_anything_is_stopped(arm, workspace, fake):
    seen = Seen()
    fake.contact_nm = {round(TAKE_OVER_S / PERIOD_S) + 20: 0.5 * workspace.torque_nm[2]}
    with pytest.raises(LimitExceeded) as stopped:
        drive(stream_of(arm, workspace, seen), workspace)
    assert seen.rows[-1].samples[0].sync_index == fake.sync_index
    assert seen.ends == [stopped.value]


def test_a_failed_drive_ends_what_is_seen_with_its_cause(arm, workspace, fake):
    seen = Seen()
    fake.fault_at = 30
    with pytest.raises(DriveFault) as failed:
        drive(stream_of(arm, workspace, seen), workspace)
    assert seen.ends == [failed.value]


def test_an_observer_that_raises_is_notified_no_more_and_changes_nothing(arm, workspace, fake):
    broken, seen = Broken(), Seen()
    stream = stream_of(arm, workspace, broken, seen)
    drive(stream, workspace)
    assert fake.log == ["enable", "disable"]
    assert len(broken.rows) == 1
    assert broken.ends == []
    assert len(seen.rows) == fake.sync_index - 1
    assert [str(error) for error in stream.options.observers.troubles] == ["a defect of who looks on"]


def test_the_motion_is_the_same_with_and_without_observers(arm, workspace, fake):
    drive(stream_of(arm, workspace, Broken(), Seen()), workspace)
    with_them, fake.path = list(fake.path), []
    fake.q_rad, fake.sync_index = np.zeros(6), 0
    drive(stream_of(arm, workspace), workspace)
    assert np.array_equal(with_them, fake.path)


def test_observers_come_along_when_options_are_changed():
    options = MoveOptions(observers=Observers(Seen()))
    assert replace(options, override=0.5).observers is options.observers
