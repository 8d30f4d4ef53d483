"""The feed never makes the motion loop wait: rows beyond the buffer are dropped, and a closed page is released."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gateway.acquire.events import PoseDone, Progress
from gateway.live.feed import ROW_S, WAITING
from gateway.live.page_content import Show
from gateway.live.page_process import Channel
from gateway.live.wire import HEAD, PER_AXIS, STOP, CommandOver, Ended, Happened, Hello, PoseSeen, ShownCell
from gateway.motion.observer import MotionProgress, Observers
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson
from tests.data.observed import ENABLED, PERIOD_S, observed

Q_RAD = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.6])


def rows(received: list) -> list[np.ndarray]:
    return [each for each in received if isinstance(each, np.ndarray)]


def test_a_row_holds_what_the_loop_saw(rig, began):
    rig.feed.began(*began)
    rig.feed.sampled(observed(6, Q_RAD))
    rig.later(PERIOD_S)
    rig.feed.sampled(observed(7, Q_RAD + 0.01, unresponsive=2))
    shown, _, row = rig.received()
    assert isinstance(shown, ShownCell)
    assert [arm.name for arm in shown.arms] == ["main"]
    sent_s, sync, time_s, _phase, unanswered = row[:HEAD]
    assert (sent_s, sync, time_s, unanswered) == (100.0 + PERIOD_S, 7, pytest.approx(0.07), 1)
    q_rad, followed_rad, torque_nm, modelled_nm, status = row[HEAD:].reshape(PER_AXIS, 6)
    answered = [0, 1, 3, 4, 5]
    assert q_rad[answered] == pytest.approx(Q_RAD[answered] + 0.01)
    assert followed_rad == pytest.approx(Q_RAD + 1e-3)  # what was sent with the SYNC before
    assert torque_nm[answered] == pytest.approx([1, 2, 4, 5, 6])
    assert modelled_nm == pytest.approx(range(6))
    assert status[answered].tolist() == [ENABLED] * 5
    assert np.isnan([q_rad[2], torque_nm[2], status[2]]).all()


def test_a_screen_is_not_fed_faster_than_it_shows(rig, began):
    rig.feed.began(*began)
    for sync in range(1, 1001):  # a second at 1 kHz
        rig.feed.sampled(observed(sync, Q_RAD))
        rig.later(0.001)
    times = [row[0] for row in rows(rig.received())]
    assert len(times) == 125
    assert min(np.diff(times)) >= ROW_S
    assert rig.feed.dropped == 0


def test_a_page_that_does_not_read_costs_rows_and_no_time(rig, began):
    """The kernel's buffer fills up; every row after that is left out and counted, and nothing is ever waited for."""
    rig.feed.began(*began)
    for sync in range(1, 5001):
        rig.feed.sampled(observed(sync, Q_RAD))
        rig.feed.reported(MotionProgress("move", sync, 5000))
        rig.later(PERIOD_S)
    assert not rig.feed.gone
    assert rig.feed.dropped > 4000
    before = rows(rig.received())
    assert [row[1] for row in before] == list(range(1, len(before) + 1))
    rig.later(PERIOD_S)
    rig.feed.sampled(observed(5001, Q_RAD))
    assert rows(rig.received())[-1][1] == 5001


def test_messages_beyond_the_buffer_come_later_and_in_order(rig, began):
    rig.feed.began(*began)
    while not rig.feed.dropped:
        rig.feed.sampled(observed(1, Q_RAD))
        rig.later(PERIOD_S)
    for number in range(WAITING + 5):
        rig.feed.reported(Progress(number, 9, "move", float(number), 1.0 + number))
        rig.later(1.0)
    rig.received()
    rig.feed.sampled(observed(2, Q_RAD))
    steps = [each.event.step for each in rig.received() if isinstance(each, Happened)]
    assert steps == list(range(WAITING))


def test_a_page_that_is_gone_is_let_go(rig, began):
    rig.feed.began(*began)
    rig.page.close()
    observers = Observers(rig.feed)
    observers.notify(lambda each: each.sampled(observed(1, Q_RAD)))
    assert rig.feed.gone
    observers.notify(lambda each: each.sampled(observed(2, Q_RAD)))
    observers.notify(lambda each: each.reported(MotionProgress("move", 1, 2)))
    observers.notify(lambda each: each.ended(None))
    assert observers.troubles == []
    wish = rig.feed.pressed()
    assert wish is not None
    assert (wish.kind, wish.cause.exit_code) == (StopKind.ALONG_PATH, 5)
    assert "stop button" in str(wish.cause)


def test_the_button_asks_for_a_stop_and_the_second_time_for_a_quick_one(rig):
    desk = StopDesk()
    desk.watch(rig.feed.pressed)
    assert desk.look() is None
    rig.page.send(STOP)
    wish = desk.look()
    assert wish is not None
    assert wish.kind is StopKind.ALONG_PATH
    assert isinstance(wish.cause, StoppedByPerson)
    assert "live page" in str(wish.cause)
    rig.page.send(STOP)
    assert desk.look().kind is StopKind.QUICK_STOP  # type: ignore[union-attr]


def test_a_page_that_does_not_answer_for_2_s_stops_the_arm_along_its_path(rig):
    assert rig.run(5.0, answered=True) is None
    frozen_s = rig.now_s[0]
    wish = rig.run(5.0, answered=False)
    assert 1.7 < rig.now_s[0] - frozen_s < 2.1
    assert (wish.kind, wish.cause.exit_code) == (StopKind.ALONG_PATH, 5)
    assert re.fullmatch(r"stopped: the process of the live page has not answered for 2 s, so its .*", str(wish.cause))


def test_a_stall_of_the_command_is_not_taken_for_one_of_its_page(rig):
    """A suspended computer, a prompt between two motions: the page may have been suspended as well."""
    assert rig.run(1.0, answered=True) is None
    for _ in range(5):
        rig.later(3.0)
        assert rig.run(0.1, answered=False) is None
    assert rig.run(5.0, answered=True) is None
    assert rig.run(2.1, answered=False) is not None, "it is still watched"


def test_a_page_is_given_time_to_start_but_not_without_limit(rig):
    assert rig.run(29.0, answered=False) is None
    assert rig.run(1.0, answered=True) is None
    assert rig.run(2.1, answered=False) is not None


def test_a_page_that_never_starts_stops_the_arm(rig):
    assert rig.run(33.0, answered=False) is not None


def test_time_without_an_answer_counts_whole_where_the_sync_period_is_long(rig, began):
    rig.feed.began(*began[:2], 1.0, began[3])
    assert rig.run(0.5, answered=True) is None
    wishes = []
    for _ in range(3):
        rig.later(1.0)
        wishes.append(rig.feed.pressed())
    assert wishes[0] is None
    assert wishes[-1] is not None


def test_a_pose_comes_with_what_the_model_asks_for_there(rig, began):
    rig.feed.began(*began)
    rig.feed.sampled(observed(1, Q_RAD))
    rig.feed.reported(PoseDone(3, "none", (1.0,) * 6, (0.1,) * 6))
    seen = rig.received()[-1]
    assert isinstance(seen, PoseSeen)
    assert seen.done.pose == 3
    assert seen.modelled_nm == pytest.approx(range(6))


def test_the_end_says_why(rig, began):
    rig.feed.began(*began)
    rig.feed.ended(None)
    rig.feed.ended(StoppedByPerson("stopped by SIGINT"))
    rig.feed.close("The command has ended.")
    received = rig.received()
    assert [each.reason for each in received if isinstance(each, Ended)] == ["", "stopped by SIGINT"]
    assert received[-1] == CommandOver("The command has ended.")


def test_the_end_is_read_though_an_answer_to_the_heartbeat_was_not(rig):
    """An end that is closed before it has read everything resets the other one, which then still holds messages."""
    channel, show = Channel(rig.page), Show(Hello(8460, "word", "servo-gateway record", stops=True))
    assert rig.feed.pressed() is None
    channel.drain(show)  # asked, and answered
    rig.feed.close("stopped by the button of the live page")
    channel.drain(show)
    assert show.over == "stopped by the button of the live page"
    assert channel.gone
