"""Excitations under power: every period kept SYNC by SYNC, and every failure ends with the brakes on."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drives.errors import DriveFault
from gateway.acquire.events import PeriodDone, Progress, Started, Stopped
from gateway.acquire.passes import TRIED_SPEED, passes_of
from gateway.acquire.plan import VisitSettings
from gateway.acquire.session import driven_passes
from gateway.errors import InputError, LimitExceeded, PlanRefused
from gateway.excite.excitation import MovingPlan, fingerprint
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions
from gateway.motion.trajectory import Motion
from tests.data.excitations import HOME_RAD, swing

PERIOD_S = 0.01
SETTINGS = VisitSettings(0.03, 0.05, 2.0, 40, PERIOD_S)
NOTHING: frozenset[tuple[int, float, int]] = frozenset()


class Unrested:
    """A series whose last setpoint is that of the one before."""

    def __init__(self, series) -> None:
        self.series = series

    def __getattr__(self, name):
        return getattr(self.series, name)

    def motion(self, sync_period_s):
        full_motion = self.series.motion(sync_period_s)
        q, qd, qdd = (values[:-1] for values in (full_motion.q_rad, full_motion.qd_rad_s, full_motion.qdd_rad_s2))
        return Motion(q, qd, qdd, sync_period_s)


@pytest.fixture
def plan(workspace) -> MovingPlan:
    return MovingPlan("main", (swing(workspace),), {})


@pytest.fixture
def drive(run, arm, workspace, plan, small_cell):
    """Drive a plan under a load; what a run is made with may be replaced."""

    def drive(load="none", what=plan, driven=NOTHING, options=None, **changes):
        options = options or MoveOptions()
        passes = passes_of(what, load, driven, options.override, PERIOD_S)
        driving = run(options=options, **changes)
        driving.execute(driven_passes(arm, workspace, small_cell.cell.arm[0], passes, SETTINGS), load)
        return driving.missed

    return drive


def test_every_sync_of_every_period_is_kept(drive, plan, store, events, fake):
    assert drive() == ()
    assert fake.log == ["enable", "disable"]
    assert [(p.period, p.load, p.speed, p.complete, p.kind, p.joint) for p in store.periods] == [
        (k, "none", 1.0, True, "series", 0) for k in (1, 2, 3)
    ]
    for period in store.periods:
        assert period.excitation == fingerprint(plan.excitations[0])
        assert len(period) == 200
        assert period.period_s == pytest.approx(2.0)
        assert np.diff(period.sync_index).tolist() == [1] * 199
        planned = plan.excitations[0].at(np.arange(1, 201) * PERIOD_S)[0]
        assert period.target_rad == pytest.approx(planned, abs=1e-9)
        # the fake is where it was commanded one SYNC before
        assert period.q_rad[1:] == pytest.approx(period.target_rad[:-1], abs=1e-5)
    assert all(two.sync_index[0] == one.sync_index[-1] + 1 for one, two in pairwise(store.periods))
    assert [event.period for event in events if isinstance(event, PeriodDone)] == [1, 2, 3]


def test_a_load_is_tried_at_a_quarter_of_the_speed_first(drive, plan, store):
    drive("a")
    tried, *rest = store.periods
    assert (tried.speed, tried.period, len(tried)) == (TRIED_SPEED, 1, 800)
    assert tried.motion not in {period.motion for period in rest}
    assert [period.period for period in rest] == [1, 2, 3]
    fast = np.abs(np.diff(store.periods[1].target_rad, axis=0)).max(axis=0)
    slow = np.abs(np.diff(tried.target_rad, axis=0)).max(axis=0)
    assert slow == pytest.approx(TRIED_SPEED * fast, rel=0.01)


def test_what_was_driven_is_left_out(drive, plan, store):
    recorded_print = fingerprint(plan.excitations[0])
    drive("a", driven=frozenset({(recorded_print, TRIED_SPEED, 1), (recorded_print, 1.0, 1), (recorded_print, 1.0, 3)}))
    assert [(period.period, period.speed) for period in store.periods] == [(2, 1.0)]


def test_an_override_makes_the_same_path_slower(drive, store):
    drive(options=MoveOptions(override=0.5))
    assert {(period.speed, len(period)) for period in store.periods} == {(0.5, 400)}


def test_a_period_that_lacks_a_sync_is_driven_again(drive, store, events, fake):
    drive()
    second = store.periods[1].sync_index
    fake.q_rad = fake.target_rad = np.zeros(6)
    fake.sync_index, fake.unanswered = 0, {int(second[50]): 2}
    store.periods.clear()
    assert drive() == ()
    assert [(period.period, period.complete) for period in store.periods] == [
        (1, True),
        (2, False),
        (3, True),
        (2, True),
    ]
    assert (len(store.periods[1]), store.periods[1].incomplete_epochs) == (199, 1)
    done = [event for event in events if isinstance(event, PeriodDone)][-4:]
    assert [(event.complete, event.incomplete_epochs) for event in done] == [
        (True, 0),
        (False, 1),
        (True, 0),
        (True, 0),
    ]


def test_a_period_that_lacks_a_sync_twice_is_left_out(drive, store, fake):
    fake.unanswered = dict.fromkeys(range(0, 100_000, 450), 2)
    missed = drive()
    assert set(missed) == {("load", period.period) for period in store.periods if not period.complete} - {
        ("load", period.period) for period in store.periods if period.complete
    }
    assert missed


def stop_at(row: int, fake, kind=StopKind.ALONG_PATH):
    """An operator who asks for a stop at a SYNC."""
    cause = StoppedByPerson("stopped by SIGINT")
    return lambda: StopRequest(kind, cause) if fake.sync_index >= row else None


def test_ctrl_c_in_a_period_stops_along_the_path_and_keeps_what_was_driven(drive, store, events, fake):
    drive()
    middle = int(store.periods[1].sync_index[100])
    fake.q_rad = fake.target_rad = np.zeros(6)
    fake.sync_index, before = 0, len(fake.path)
    store.periods.clear()
    with pytest.raises(StoppedByPerson):
        drive(options=MoveOptions(StopDesk(stop_at(middle, fake))))
    assert fake.log[2:] == ["enable", "disable"]
    assert [(period.period, period.complete) for period in store.periods] == [(1, True), (2, False)]
    assert 95 <= len(store.periods[1]) <= 102
    assert isinstance(events[-1], Stopped)
    stopping = np.array(fake.path[before:])
    acceleration = np.diff(stopping, n=2, axis=0) / PERIOD_S**2
    assert np.abs(stopping[-1] - stopping[-2]).max() < 1e-6
    assert np.abs(acceleration).max() < 4.0


def test_a_drive_fault_in_a_period_stops_at_once_and_keeps_what_was_driven(drive, store, fake):
    fake.fault_at = 500
    with pytest.raises(DriveFault):
        drive()
    assert fake.log[-1] == "disable"
    assert [period.complete for period in store.periods] == [True] * (len(store.periods) - 1) + [False]
    assert store.periods[-1].sync_index[-1] == 499


def test_contact_in_a_period_stops_the_arm(drive, store, fake):
    fake.contact_nm = {500: 150.0}
    with pytest.raises(LimitExceeded, match="joint 3"):
        drive()
    assert "quick stop" in fake.log
    assert store.periods[-1].sync_index[-1] < 510


def test_a_full_disk_stops_the_arm(drive, store, fake):
    store.full_after = 1
    with pytest.raises(InputError, match="No space left"):
        drive()
    assert fake.log[-1] == "disable"
    assert store.periods[0].complete


def test_two_excitations_are_joined_by_a_planned_transfer(drive, workspace, store, fake):
    first, second = swing(workspace, periods=1), swing(workspace, periods=1, seed=8)
    second = replace(second, name="more", start_rad=HOME_RAD + 0.2)
    drive(what=MovingPlan("main", (first, second), {}))
    assert [(period.name, period.complete) for period in store.periods] == [("load", True), ("more", True)]
    speed = np.diff(np.array(fake.path), axis=0) / PERIOD_S
    assert (np.abs(speed).max(axis=0) <= workspace.speed_rad_s * 1.001).all()
    assert workspace.feasible(np.array(fake.path)).all()


def test_the_first_motion_with_these_drives_is_slow_and_not_measured(drive, store, fake):
    """The arm is at the start already: one period at a tenth of its speed comes first."""
    fake.q_rad = fake.target_rad = HOME_RAD.copy()
    done = []
    drive(options=MoveOptions(first_done=lambda: done.append(True)))
    assert done == [True]
    assert [period.period for period in store.periods] == [1, 2, 3]
    assert store.periods[0].sync_index[0] > 2000
    assert {period.speed for period in store.periods} == {1.0}


def test_time_left_falls_to_zero(drive, events):
    drive("a")
    progress = [event.remaining_s for event in events if isinstance(event, Progress)]
    started = next(event for event in events if isinstance(event, Started))
    assert started.visits == 4
    assert progress[0] == pytest.approx(started.duration_s)
    assert (np.diff(progress) <= 1e-9).all()
    assert progress[-1] == 0.0


def test_samples_that_do_not_determine_the_harmonics_are_refused(drive, workspace, fake):
    with pytest.raises(PlanRefused, match="20 SYNCs in a period of 3 harmonics are too few, 24 are needed"):
        drive(what=MovingPlan("main", (swing(workspace, period_s=0.2),), {}))
    assert fake.log == []


def test_periods_that_do_not_follow_one_another_are_refused(drive, workspace, fake):
    with pytest.raises(PlanRefused, match="'load': a period must end at rest in its start posture"):
        drive(what=MovingPlan("main", (Unrested(swing(workspace)),), {}))
    assert fake.log == []
