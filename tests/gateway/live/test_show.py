"""What a page receives: frames from rows, speed, states in words, and the same for one that is opened later."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.acquire.events import PoseDone, Progress, SampleRepeated, StateChanged, Stopped
from gateway.live.feed import PHASES
from gateway.live.page_content import Show, _ArmPast
from gateway.live.wire import HEAD, PER_AXIS, CommandOver, Ended, Happened, Hello, PoseSeen
from gateway.model.kinematics import link_frames
from gateway.motion.observer import MotionProgress
from gateway.motion.state import CellState, Phase
from gateway.report.stop import curves_of

ENABLED, FAULT = 0x1237, 0x1218


@pytest.fixture
def show(shown) -> Show:
    show = Show(Hello(8460, "word", "servo-gateway record", stops=True))
    show.take(shown)
    show.news()
    return show


def row(sync: int, time_s: float, q_rad: np.ndarray, status: float = ENABLED) -> np.ndarray:
    head = [0.0, sync, time_s, PHASES.index(Phase.MOVING), 2]
    return np.concatenate([head, q_rad, q_rad + 1e-3, np.arange(6.0), np.ones(6), np.full(6, status)])


def last_frame(show: Show) -> dict:
    return [json.loads(text) for text in show.news() if text.startswith('{"frame"')][-1]["frame"]


def test_a_frame_holds_rows_frames_of_the_links_and_states(show, workspace):
    q_rad = np.array([0.1, -0.2, 0.3, 0.4, 0.5, -0.6])
    for number in range(5):
        show.take(row(number, 0.01 * number, q_rad * (1.0 + 0.1 * number)))
    frame = last_frame(show)
    assert (frame["phase"], frame["sync"], frame["unanswered"]) == ("moving", 4, 2)
    (arm,) = frame["arms"]
    rows = np.array(arm["rows"][1:], dtype=float)
    assert rows[:, 0] == pytest.approx([0.01, 0.02, 0.03, 0.04])
    assert rows[-1, 1:7] == pytest.approx(1.4 * q_rad, abs=1e-5)
    assert rows[-1, 7:13] == pytest.approx(10.0 * q_rad, abs=1e-4)  # speed
    assert rows[-1, 13:19] == pytest.approx(np.full(6, 1e-3), abs=1e-5)  # target less actual
    assert rows[-1, 19:25] == pytest.approx(range(6))
    assert rows[-1, 25:31] == pytest.approx(np.ones(6))
    frames = np.array(arm["frames"]).reshape(6, 3, 4)
    assert frames == pytest.approx(link_frames(workspace.robot, 1.4 * q_rad[None])[0, :, :3], abs=1e-5)
    assert arm["drives"] == [["OPERATION ENABLED", "plain"]] * 6
    assert show.news() == []


def test_what_is_not_known_is_null_and_never_a_number(show):
    q_rad = np.zeros(6)
    show.take(row(1, 0.0, q_rad))
    broken = row(2, 0.01, q_rad)
    broken[HEAD + 2] = math.nan
    broken[HEAD + (PER_AXIS - 1) * 6 + 2] = math.nan
    show.take(broken)
    (arm,) = last_frame(show)["arms"]
    assert arm["rows"][0][7:13] == [None] * 6  # no speed from a single row
    assert arm["rows"][1][3] is None
    assert arm["drives"][2] == ["no answer", "warn"]


def test_a_drive_in_fault_is_grave(show):
    show.take(row(1, 0.0, np.zeros(6), FAULT))
    assert last_frame(show)["arms"][0]["drives"][0] == ["FAULT", "fail"]


def test_events_progress_and_poses(show, workspace):
    show.take(Happened(Progress(1, 9, "move", 1.0, 63.24)))
    show.take(Happened(MotionProgress("approach pose 2", 4, 9)))
    show.take(Happened(SampleRepeated(17, (2, 3))))
    show.take(Happened(StateChanged(CellState("main", Phase.MOVING, None))))  # type: ignore[arg-type]
    show.take(PoseSeen(PoseDone(2, "none", (5.0,) * 6, (0.5,) * 6), np.full(6, 4.0)))
    messages = [json.loads(text) for text in show.news()]
    events = [each["event"]["text"] for each in messages if "event" in each]
    assert events[0] == "SYNC 17 not answered by J2, J3; sample repeated"
    (pose,) = [each["pose"] for each in messages if "pose" in each]
    assert pose == {"pose": 2, "load": "unloaded arm", "band_nm": [0.5] * 6, "residual_nm": [1.0] * 6}
    frame = next(each["frame"] for each in messages if "frame" in each)
    assert (frame["what"], frame["left_s"]) == ("approach pose 2", 63.2)


@pytest.mark.parametrize(("disabled", "phase"), [(True, "stopped, in its brakes"), (False, "in an unknown state")])
def test_a_stop_is_reported_with_its_reason_and_as_far_as_it_is_known(show, disabled, phase):
    show.take(Happened(Stopped("joint 3 is 0.12 rad off its target")))
    show.take(Ended("joint 3 is 0.12 rad off its target", disabled))
    messages = [json.loads(text) for text in show.news()]
    assert [each["event"]["grave"] for each in messages if "event" in each] == ["fail"]
    assert messages[-1]["frame"]["phase"] == phase


def test_a_page_that_is_opened_later_sees_the_same(show):
    for number in range(5):
        show.take(row(number, 0.01 * number, np.full(6, 0.1 * number)))
    show.take(PoseSeen(PoseDone(2, "none", (5.0,) * 6, (0.5,) * 6), np.full(6, 4.0)))
    first = [json.loads(text) for text in show.news()]
    later = [json.loads(text) for text in show.past()]
    assert later[0] == {"hello": {"title": "servo-gateway record", "stops": True}}
    assert "scene" in later[1]
    assert later[2]["frame"]["arms"][0]["rows"] == first[-1]["frame"]["arms"][0]["rows"]
    assert {"pose", "event"} <= {key for each in later for key in each}
    show.take(CommandOver("The command has ended."))
    assert json.loads(show.past()[-1]) == {"over": "The command has ended."}


def test_the_following_error_has_one_sign_on_the_live_page_and_in_the_stop_report():
    """Target less actual (ISO 9283, 0x60F4): a joint 2 mrad behind a rising target has +2 mrad on both."""
    time_s = 0.004 * np.arange(10)
    target = np.outer(time_s, np.ones(6))
    actual = target - 2e-3
    sent = np.vstack([target[1:], target[-1:]])  # what goes out with a SYNC is due at the next
    values = {
        "q_rad": actual,
        "target_rad": sent,
        "joint_torque_nm": np.zeros((10, 6)),
        "modelled_torque_nm": np.zeros((10, 6)),
    }
    curves = curves_of(SimpleNamespace(name="main", values=values), time_s - time_s[-1], np.arange(10))
    assert curves.error_rad[1:] == pytest.approx(np.full((9, 6), 2e-3))
    past = _ArmPast(SimpleNamespace(robot=None))
    past.take(0.0, np.array([actual[3], target[3], np.zeros(6), np.zeros(6), np.zeros(6)]))
    assert past.fresh[0][13:19] == pytest.approx([2e-3] * 6)
