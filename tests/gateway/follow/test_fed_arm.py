"""Offsets beside every target: of the middle of the stretch, eased, and zero as soon as anything is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.errors import LimitExceeded, PlanRefused
from gateway.feedforward.load import assumed_load
from gateway.follow.path import FollowPath, read_path
from gateway.follow.path_run import FedArm, follow
from gateway.follow.settings import Setting, check_offsets
from gateway.follow.track import Recorder
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions

PERIOD_S = 0.01
#: Time in which the offsets of an arm that a person has stopped are brought to zero.
EASED_OUT_S = 0.4
FAULT = 0x0608


@pytest.fixture
def fed(arm, law):
    fed = FedArm(arm, PERIOD_S, 0.1)
    fed.enable()
    fed.use(law)
    return fed


def ramped(fed):
    fed.ramp.rise()
    while not fed.ramp.resting:
        fed.hold()
    return fed


def drive(fed, points):
    """Targets (n, 6), each with the one after it."""
    for q, ahead in zip(points, [*points[1:], points[-1]], strict=True):
        fed.exchange(fed.command(q, ahead))


def offsets(commands):
    return [c.velocity_offset_rad_s for c in commands], [c.torque_offset_nm for c in commands]


def test_nothing_is_fed_before_the_offsets_are_asked_for(fed, perfect):
    drive(fed, np.full((5, 6), 0.001))
    assert {offset for row in perfect.commanded for pair in offsets(row) for offset in pair} == {0.0}


def test_the_offsets_ease_in_and_out(fed, perfect, law):
    ramped(fed)
    complete = np.array(law.offsets([0.0] * 6, [0.0] * 6, [0.0] * 6, [0.0] * 6)[1])
    shares = np.array([np.array(offsets(row)[1]) @ complete / (complete @ complete) for row in perfect.commanded])
    assert shares[0] < 0.1
    assert (np.diff(shares) > 0).all()
    assert shares[-1] == pytest.approx(1.0)
    fed.ramp.fall()
    while not fed.ramp.resting:
        fed.hold()
    assert offsets(perfect.commanded[-1]) == ([0.0] * 6, [0.0] * 6)


def test_the_offsets_are_those_of_the_middle_of_the_stretch(fed, perfect, law):
    """On a parabola the difference quotients are exact: q = a t^2 / 2."""
    gain = np.array([0.3, -0.2, 0.4, 0.5, -0.3, 0.2])
    ramped(fed)
    begun = len(perfect.commanded)
    time_s = PERIOD_S * np.arange(1, 31)
    drive(fed, 0.5 * gain * time_s[:, None] ** 2)
    n = 20
    middle_s = (n - 0.5) * PERIOD_S
    q = 0.5 * (0.5 * gain * (n * PERIOD_S) ** 2 + 0.5 * gain * ((n - 1) * PERIOD_S) ** 2)
    expected = law.offsets(q.tolist(), (gain * middle_s).tolist(), gain.tolist(), np.sign(gain).tolist())
    velocity, torque = offsets(perfect.commanded[begun + n - 1])
    np.testing.assert_allclose(velocity, expected[0], rtol=1e-9)
    np.testing.assert_allclose(torque, expected[1], rtol=1e-9)


def test_what_is_recorded_is_the_target_that_the_drives_had_reached(fed):
    ramped(fed)
    fed.recorder = Recorder("identified", PERIOD_S)
    drive(fed, np.linspace(0.0, 0.02, 21)[1:, None] * np.ones(6))
    track = fed.recorder.track()
    np.testing.assert_allclose(track.error_rad, 0.0, atol=1e-12)
    assert (track.torque_offset_nm[:, 1] != 0).all()
    assert (track.computing_s > 0).all()


def test_a_drive_that_leaves_operation_enabled_cuts_every_offset(fed, perfect):
    ramped(fed)
    perfect.statusword = FAULT
    fed.hold()
    fed.hold()
    assert offsets(perfect.commanded[-1]) == ([0.0] * 6, [0.0] * 6)
    assert "OPERATION ENABLED" in fed.ramp.reason


def test_a_stop_by_the_drives_ramp_takes_no_offset_with_it(fed, perfect):
    ramped(fed)
    fed.quick_stop()
    assert (fed.ramp.gain, perfect.calls[-1]) == (0.0, "quick_stop")


def test_another_law_is_refused_while_offsets_are_fed(fed, law):
    ramped(fed)
    with pytest.raises(ValueError, match="ramped down"):
        fed.use(law)


def test_an_offset_at_its_limit_is_not_sent(fed, feed, perfect):
    heavy = feed.law(assumed_load("heavy", 900.0, [0.0, 0.0, 0.3], "test"))
    fed.use(heavy)
    fed.ramp.rise()
    with pytest.raises(LimitExceeded, match=r"axis \d: the feedforward requires .* Nm at the motor, its limit"):
        [fed.hold() for _ in range(20)]
    for row in perfect.commanded:
        assert all(abs(c.torque_offset_nm) <= limit for c, limit in zip(row, heavy.limits_nm, strict=True))
    assert fed.ramp.gain == 0.0


# -- the run -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def path(tmp_path, workspace) -> FollowPath:
    (tmp_path / "p.toml").write_text("waypoints_rad = [[0,0,0,0,0,0], [0.05,0.1,-0.1,0.1,0.1,0.1], [0,0,0,0,0,0]]")
    return read_path(tmp_path / "p.toml", workspace, PERIOD_S)


def run(arm, workspace, path, settings, stop=lambda: False):
    desk = StopDesk(lambda: StopRequest(StopKind.ALONG_PATH, StoppedByPerson("a person")) if stop() else None)
    return follow(arm, workspace, path, settings, lambda what, done: None, MoveOptions(desk))


def test_one_track_per_setting_and_the_arm_ends_in_its_brakes(arm, workspace, path, law, perfect):
    tracks = run(arm, workspace, path, [Setting("off", None, None), Setting("identified", law, None)])
    assert [track.setting for track in tracks] == ["off", "identified"]
    assert len(tracks[0].target_rad) == len(tracks[1].target_rad)
    assert np.abs(tracks[0].torque_offset_nm).max() == 0.0
    assert np.abs(tracks[1].torque_offset_nm).max() > 1.0
    assert perfect.calls == ["enable", "disable"]
    assert offsets(perfect.commanded[-1]) == ([0.0] * 6, [0.0] * 6)


@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_a_stop_while_ramping_or_moving_brings_the_offsets_to_zero_with_the_reason(
    arm, workspace, path, law, perfect, gain
):
    def stop():
        if not perfect.commanded:
            return False
        complete = law.offsets([0.0] * 6, [0.0] * 6, [0.0] * 6, [0.0] * 6)[1][1]
        fed = perfect.commanded[-1][1].torque_offset_nm / complete
        moving = abs(perfect.commanded[-1][1].velocity_offset_rad_s) > 1.0
        return fed > gain if gain < 1.0 else bool(fed) and moving

    with pytest.raises(KeyboardInterrupt) as stopped:
        run(arm, workspace, path, [Setting("identified", law, None)], stop)
    note = stopped.value.__notes__[0]
    assert "brought to zero" in note
    assert ("during the ramp of the offsets" in note) == (gain < 1.0)
    assert offsets(perfect.commanded[-1]) == ([0.0] * 6, [0.0] * 6)
    fed = np.abs([row[1].torque_offset_nm for row in perfect.commanded])
    still = np.flatnonzero(np.diff(fed) >= 0.0)[-1]
    easing = fed[still:]
    assert np.abs(np.diff(easing)).max() < 5.0 * easing.max() * PERIOD_S / EASED_OUT_S / gain
    assert len(easing) <= EASED_OUT_S / PERIOD_S + 2
    assert perfect.calls == ["enable", "disable"]


def test_a_path_that_takes_an_offset_to_its_limit_is_refused_before_anything_moves(path, feed):
    heavy = assumed_load("heavy", 900.0, [0.0, 0.0, 0.3], "test")
    with pytest.raises(PlanRefused, match=r"axis 5, setting 'maximum', .* not moved"):
        check_offsets(path, [Setting("off", None, None), Setting("maximum", feed.law(heavy), heavy)], "main")
