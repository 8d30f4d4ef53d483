"""The brake test: an axis whose brake fails is held again at once; slaves on a wire, in lockstep."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gateway.check.brakes import SUPPORT_S, WATCH_S, try_brakes
from gateway.motion.opening import OpenArm
from gateway.motion.power import BRAKE_DROP_RAD
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions
from tests.support.rigs.wired_arm import Joint, wired_arm

PERIOD_S = 0.01


@pytest.fixture
def rig(small_cell):
    with wired_arm(small_cell, PERIOD_S) as opened:
        yield opened


class Person:
    """Supports the arm some SYNCs after being asked, and looks at it meanwhile."""

    def __init__(self, opened: OpenArm, slaves: list[Joint], syncs: int = 20) -> None:
        self.asked: list[str] = []
        self.states: list[set[str]] = []
        self._opened, self._slaves, self._syncs = opened, slaves, syncs

    def __call__(self, text: str) -> Callable[[], bool]:
        self.asked.append(text)
        return self._supported

    def _supported(self) -> bool:
        self.states.append({slave.state for slave in self._slaves})
        if len(self.states) < self._syncs:
            return False
        for slave in self._slaves:
            slave.falls_rad_s2 = slave.creeps_rad_s = 0.0
        return True


@pytest.mark.parametrize("period_s", [0.004, 0.01])
@pytest.mark.parametrize("acceleration", [2.0, 5.0, 10.0])
def test_an_axis_that_falls_is_held_again_at_the_first_sync_beyond_the_limit(small_cell, period_s, acceleration):
    with wired_arm(small_cell, period_s) as (opened, slaves):
        slave = slaves[0]
        slave.falls_rad_s2 = acceleration
        person = Person(opened, slaves)
        items = try_brakes(opened, MoveOptions(), person)
        assert [(item.severity, item.where) for item in items] == [("fail", "J1 node 1")]
        assert f"sank by {slave.farthest_rad:.4f} rad" in items[0].what
        assert slave.farthest_rad <= 0.02
        # by the fall's own equation the limit is passed at t, seen at the SYNC after, and the next one holds the axis
        passed_s = math.sqrt(2.0 * BRAKE_DROP_RAD / acceleration)
        left = slave.states.index("switched on", slave.states.index("operation enabled"))
        again = slave.states.index("operation enabled", left)
        assert (again - left) * period_s <= min(passed_s, WATCH_S[0] + period_s) + 2.0 * period_s
        assert person.states
        assert all(states == {"operation enabled"} for states in person.states)
        assert len(person.asked) == 1
        assert "Support it" in person.asked[0]
        assert {each.state for each in slaves} == {"switch on disabled"}


def test_one_controlword_holds_an_axis_that_falls_within_the_first_time(rig):
    opened, slaves = rig
    slaves[0].falls_rad_s2 = 10.0
    try_brakes(opened, MoveOptions(), Person(opened, slaves))
    words = [word for word, _ in slaves[0].commands]
    begin = words.index(0x07, words.index(0x0F))
    end = words.index(0x0F, begin)
    assert set(words[begin:end]) == {0x07}
    assert end - begin <= WATCH_S[0] / PERIOD_S


def test_the_drive_is_commanded_to_hold_the_axis_where_it_was_measured(rig):
    opened, slaves = rig
    slaves[0].falls_rad_s2 = 10.0
    try_brakes(opened, MoveOptions(), Person(opened, slaves))
    commanded = slaves[0].commands
    words = [word for word, _ in commanded]
    begin = words.index(0x07, words.index(0x0F))
    end = words.index(0x0F, begin)
    assert commanded[end][1] == slaves[0].measured[end - 1]
    assert abs(commanded[end][1] - commanded[begin][1]) > 0.004 * slaves[0].joint_count


def test_brakes_that_hold_are_left_to_themselves_for_longer_and_longer(rig):
    opened, slaves = rig
    items = try_brakes(opened, MoveOptions(), Person(opened, slaves))
    assert [item.severity for item in items] == ["ok"] * 6
    for slave in slaves:
        letters = {"operation enabled": "e", "switched on": "s"}
        states = "".join(letters.get(state, "d") for state in slave.states)
        runs = [run for run in states[states.index("e") : states.rindex("e")].split("e") if run]
        assert [len(run) * PERIOD_S for run in runs] == pytest.approx(WATCH_S, abs=0.06)
        assert [("d" in run) for run in runs] == [False, False, True]
    others = slaves[5]
    assert others.states.index("operation enabled") < 20


@pytest.mark.parametrize(("creeps_rad_s", "longest_s"), [(0.06, 0.05), (0.02, 0.25)])
def test_a_brake_that_creeps_is_given_no_longer_time(rig, creeps_rad_s, longest_s):
    opened, slaves = rig
    slaves[0].creeps_rad_s = creeps_rad_s
    person = Person(opened, slaves)
    (item,) = try_brakes(opened, MoveOptions(), person)
    assert item.severity == "fail"
    assert slaves[0].farthest_rad <= 0.006
    states = slaves[0].states[: len(slaves[0].states) - slaves[0].states[::-1].index("operation enabled")]
    released = states[states.index("operation enabled") :].count("switched on")
    assert released * PERIOD_S == pytest.approx(longest_s, abs=0.06)
    assert person.asked


@pytest.mark.parametrize(("word", "tried"), [(100, True), (260, False), (-260, False)])
def test_the_measured_torque_decides_whether_a_brake_is_tried(rig, word, tried):
    """0.1 % of the rated torque; what the model of the links says does not count."""
    opened, slaves = rig
    share = opened.workspace.torque_nm[2]
    per_word_nm = abs(float(opened.arm.axes.joint_torque(np.eye(6)[2] * opened.group.drives[2].scale.torque_nm)[2]))
    slaves[2].torque = round(word / 1000.0 * share / per_word_nm)
    items = try_brakes(opened, MoveOptions(), Person(opened, slaves))
    assert items[2].severity == ("ok" if tried else "warn")
    if not tried:
        assert "26% of its torque limit" in items[2].what
        assert "switched on" not in slaves[2].states[slaves[2].states.index("operation enabled") : -60]


def test_an_axis_whose_torque_is_not_known_is_not_tried(rig, monkeypatch):
    opened, slaves = rig

    def without_torque(plain):
        def answered(*targets):
            sample = plain(*targets)
            sample.joint_torque_nm[3] = math.nan
            return sample

        return answered

    for name, plain in (("exchange", opened.arm.exchange), ("hold", opened.arm.hold)):
        monkeypatch.setattr(opened.arm, name, without_torque(plain))
    items = try_brakes(opened, MoveOptions(), Person(opened, slaves))
    assert [item.severity for item in items] == ["ok", "ok", "ok", "warn", "ok", "ok"]
    assert "torque of its drive is not known" in items[3].what


def test_without_confirmation_the_arm_is_held_for_a_while(rig):
    opened, slaves = rig
    slaves[0].falls_rad_s2 = 5.0
    texts: list[str] = []

    def without_confirmation(text: str) -> None:
        texts.append(text)
        slaves[0].falls_rad_s2 = 0.0

    (item,) = try_brakes(opened, MoveOptions(), without_confirmation)
    assert item.severity == "fail"
    held = slaves[0].states[: len(slaves[0].states) - slaves[0].states[::-1].index("operation enabled")]
    assert held[-round(SUPPORT_S / PERIOD_S) :] == ["operation enabled"] * round(SUPPORT_S / PERIOD_S)


def test_a_stop_while_the_arm_is_held_names_the_brake(rig):
    opened, slaves = rig
    slaves[0].falls_rad_s2 = 5.0
    desk = StopDesk()

    def ask(_text: str) -> Callable[[], bool]:
        slaves[0].falls_rad_s2 = 0.0
        desk.ask(StoppedByPerson("stopped by SIGINT"))
        return lambda: False

    with pytest.raises(StoppedByPerson) as caught:
        try_brakes(opened, MoveOptions(desk), ask)
    assert any("J1 node 1: sank by 0.0" in note for note in caught.value.__notes__)
    assert {slave.state for slave in slaves} == {"switch on disabled"}


@pytest.mark.parametrize("kind", StopKind)
@pytest.mark.parametrize("syncs", [1, 2])
def test_a_request_while_an_axis_moves_in_its_brake_is_answered_once_the_arm_is_held_and_supported(rig, kind, syncs):
    opened, slaves = rig
    slaves[0].falls_rad_s2 = 10.0
    person = Person(opened, slaves)

    def asks() -> StopRequest | None:
        released = slaves[0].states[-syncs:].count("switched on") == syncs and slaves[0].farthest_rad > 0.0
        return StopRequest(kind, StoppedByPerson("a person")) if released else None

    with pytest.raises(StoppedByPerson, match="a person") as caught:
        try_brakes(opened, MoveOptions(StopDesk(asks)), person)
    assert len(person.asked) == 1
    assert person.states[1:] == [{"operation enabled"}] * (len(person.states) - 1)
    assert any("J1 node 1: sank by 0.0" in note for note in caught.value.__notes__)
    assert slaves[0].farthest_rad < 4 * BRAKE_DROP_RAD
    assert {slave.state for slave in slaves} == {"switch on disabled"}


def test_a_second_request_ends_the_wait_for_support(rig):
    opened, slaves = rig
    slaves[0].falls_rad_s2 = 10.0
    desk, texts = StopDesk(), []

    def ask(text: str) -> Callable[[], bool]:
        texts.append(text)
        slaves[0].falls_rad_s2 = 0.0
        desk.ask(StoppedByPerson("again"), StopKind.QUICK_STOP)
        return lambda: False

    def asks() -> StopRequest | None:
        falls = slaves[0].states[-1:] == ["switched on"] and slaves[0].farthest_rad > 0.0
        return StopRequest(StopKind.ALONG_PATH, StoppedByPerson("a person")) if falls else None

    desk.watch(asks)
    with pytest.raises(StoppedByPerson, match="a person"):
        try_brakes(opened, MoveOptions(desk), ask)
    assert len(texts) == 1
    assert {slave.state for slave in slaves} == {"switch on disabled"}


@pytest.mark.parametrize("sync", [20, 60, 75, 110, 180, 250])
@pytest.mark.parametrize("kind", StopKind)
def test_a_request_at_any_sync_of_the_brake_test_disables_all_at_once(rig, sync, kind):
    opened, slaves = rig

    def person() -> StopRequest | None:
        return StopRequest(kind, StoppedByPerson("a person")) if slaves[0].sync_seen >= sync else None

    with pytest.raises(StoppedByPerson, match="a person"):
        try_brakes(opened, MoveOptions(StopDesk(person)), Person(opened, slaves))
    enabled = [number for slave in slaves for number, state in enumerate(slave.states) if state == "operation enabled"]
    assert max(enabled) <= sync + 2
    assert {slave.state for slave in slaves} == {"switch on disabled"}
