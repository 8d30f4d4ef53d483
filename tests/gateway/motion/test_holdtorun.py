"""Hold to run: a release of the key or of the input asks for a stop along the path."""

import io
import os
import select
import termios
import threading
import tty
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from drives.sdo import Posted
from gateway.cell.config import HoldToRun
from gateway.errors import ConfigError, PlanRefused
from gateway.motion import holdtorun
from gateway.motion.holdtorun import (
    FIRST_REPEAT_S,
    PATIENCE_S,
    RELEASED_S,
    HeldInput,
    HeldKey,
    held_key,
    line_entered,
    with_held_input,
)
from gateway.motion.stops import StopKind
from gateway.motion.stream import MoveOptions


class Clock:
    """A monotonic clock that only moves when it is set."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(holdtorun, "time", clock)
    return clock


class Typist:
    """Types on a terminal by a clock that moves only while a key is waited for, or when the test moves it."""

    def __init__(self, clock: Clock, terminal: int, keyboard: int) -> None:
        self.due_s: list[float] = []
        self.blocked = 0
        self._clock, self._terminal, self._keyboard = clock, terminal, keyboard

    def hold(self, begin_s: float, repeats: int, every_s: float = 0.1, first_s: float = 0.4) -> None:
        """Press a key after a time, and hold it for so many repeats."""
        pressed_s = self._clock.now_s + begin_s
        self.due_s += [pressed_s, *(pressed_s + first_s + number * every_s for number in range(repeats))]

    def pass_until(self, until_s: float) -> None:
        """Time passes; keys that are due arrive."""
        while self.due_s and self.due_s[0] <= until_s:
            self._clock.now_s = max(self._clock.now_s, self.due_s.pop(0))
            os.write(self._keyboard, b" ")
        self._clock.now_s = max(self._clock.now_s, until_s)

    def select(self, reading, writing, failed, timeout_s):
        """As `select.select`, in real time."""
        ready = real_select(reading, writing, failed, 0.0)
        if ready[0] or timeout_s == 0.0:
            return ready
        until_s = self._clock.now_s + (1e9 if timeout_s is None else timeout_s)
        self.pass_until(min([until_s, *self.due_s[:1]]))
        return real_select(reading, writing, failed, 0.0)


real_select = select.select


@pytest.fixture
def typist(clock, monkeypatch):
    keyboard, terminal = os.openpty()
    tty.setcbreak(terminal)
    typist = Typist(clock, terminal, keyboard)
    monkeypatch.setattr(holdtorun, "select", typist)
    typist.key = HeldKey(terminal)
    yield typist
    os.close(keyboard)
    os.close(terminal)


@pytest.fixture
def keyboard(monkeypatch):
    """A pipe; what is not there yet does not come."""
    at_once = SimpleNamespace(select=lambda *ends: real_select(*ends[:3], 0.0))
    monkeypatch.setattr(holdtorun, "select", at_once)
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)
    os.close(writing)


def test_a_key_that_repeats_is_held_and_one_that_does_not_is_released(clock, keyboard):
    reading, writing = keyboard
    key = HeldKey(reading)
    os.write(writing, b" ")
    key.wait()
    clock.now_s += 0.9 * FIRST_REPEAT_S
    assert key() is None
    for _ in range(20):
        os.write(writing, b" ")
        assert key() is None
        clock.now_s += 0.9 * RELEASED_S
        assert key() is None
    clock.now_s += 0.2 * RELEASED_S
    assert key().kind is StopKind.ALONG_PATH
    assert "released" in str(key().cause)


def test_a_key_that_was_struck_before_it_was_asked_for_is_not_held(typist, clock):
    typist.hold(0.0, repeats=0)
    typist.pass_until(clock.now_s + 5.0)
    with pytest.raises(PlanRefused, match="no key was held within 60 s"):
        typist.key.wait()
    assert typist.key() is not None


def test_a_key_that_is_tapped_counts_as_released_before_anything_moves(typist, clock):
    typist.hold(2.0, repeats=0)
    typist.key.wait()
    assert typist.key().kind is StopKind.ALONG_PATH


def test_the_wait_ends_with_the_first_repeat(typist, clock):
    began_s = clock.now_s
    typist.hold(2.0, repeats=30)
    typist.key.wait()
    assert clock.now_s - began_s == pytest.approx(2.4)
    for _ in range(20):
        typist.pass_until(clock.now_s + 0.1)
        assert typist.key() is None
    typist.due_s.clear()
    typist.pass_until(clock.now_s + RELEASED_S + 0.1)
    assert typist.key() is not None


def test_keys_that_were_not_looked_at_for_long_do_not_prove_that_one_is_held(typist, clock):
    """The key is not checked while the drives are read before enabling: the key may have been released meanwhile."""
    typist.hold(1.0, repeats=5)
    typist.key.wait()
    typist.pass_until(clock.now_s + 5.0)
    assert typist.key() is None
    typist.pass_until(clock.now_s + RELEASED_S / 2.0 + 0.01)
    assert typist.key() is not None


def test_two_threads_ask_and_only_one_reads_the_terminal(typist, clock, monkeypatch):
    """The second one asks while the first one has seen a key and not yet taken it: it does not wait for another key."""
    typist.hold(1.0, repeats=2)
    typist.key.wait()
    typist.pass_until(clock.now_s + 0.1)
    asked: list[object] = []
    read = os.read

    def slow_read(descriptor: int, size: int) -> bytes:
        other = threading.Thread(target=lambda: asked.append(typist.key()), daemon=True)
        other.start()
        other.join(5.0)
        return read(descriptor, size)

    monkeypatch.setattr(holdtorun.os, "read", slow_read)
    assert typist.key() is None
    assert asked == [None]


def test_a_line_counts_only_if_it_was_entered_after_it_was_asked_for():
    keyboard, terminal = os.openpty()
    os.write(keyboard, b"yes\n")
    entered = line_entered(terminal)
    assert not entered()
    os.write(keyboard, b"\n")
    assert entered()
    assert not entered()
    os.close(keyboard)
    os.close(terminal)


def test_without_a_terminal_no_key_can_be_held(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(ConfigError, match="needs a terminal"), held_key():
        pass


@dataclass
class Input:
    """An SDO client and a bus whose node answers at the next look."""

    clock: Clock
    value: int | None = 0
    asked: list = field(default_factory=list)

    def post(self, index, subindex, data_type):
        self.asked.append((index, subindex))
        return Posted(data_type, self.clock.now_s + 0.3, self.value, answered=self.value is not None)

    def listen(self, seconds):
        self.clock.now_s += seconds


CONFIG = HoldToRun.model_validate({"node_id": 3, "object": {"index": 0x60FD}, "mask": 0x10000, "good": 0x10000})


def look(held, clock, seconds):
    """Wishes over a time, looked at every 10 ms."""
    wishes = []
    for _ in range(round(seconds / 0.01)):
        wishes.append(held())
        clock.now_s += 0.01
    return [wish for wish in wishes if wish is not None]


def test_an_input_is_asked_again_and_again_and_its_release_stops_along_the_path(clock):
    node = Input(clock, value=0x10001)
    held = HeldInput(node, node, CONFIG)
    held.wait()
    assert look(held, clock, 5.0) == []
    assert set(node.asked) == {(0x60FD, 0)}
    assert 40 <= len(node.asked) <= 60
    node.value = 0x00001
    assert look(held, clock, RELEASED_S - 0.1) == []
    (first, *_) = look(held, clock, 0.3)
    assert first.kind is StopKind.ALONG_PATH
    assert "input was released" in str(first.cause)


def test_an_input_that_does_not_answer_is_not_held(clock):
    node = Input(clock, value=0x10000)
    held = HeldInput(node, node, CONFIG)
    held.wait()
    node.value = None
    assert look(held, clock, RELEASED_S + 0.2)


def test_nothing_is_powered_before_the_input_is_held(clock):
    node = Input(clock, value=0)
    with pytest.raises(PlanRefused, match=r"node 3:60FD:00, was not held within 60 s"):
        HeldInput(node, node, CONFIG).wait()
    assert clock.now_s > 100.0 + PATIENCE_S


def test_a_first_key_may_take_longer_to_repeat_than_the_next_one(clock, keyboard):
    reading, writing = keyboard
    key = HeldKey(reading)
    os.write(writing, b" ")
    key.wait()
    clock.now_s += 1.01 * FIRST_REPEAT_S
    assert key() is not None


def test_a_key_pressed_twice_before_the_start_is_pressed_once(clock, keyboard):
    """A second press while the drives are enabled does not yet show how fast the key repeats."""
    reading, writing = keyboard
    key = HeldKey(reading)
    for _ in range(2):
        os.write(writing, b" ")
        key.wait()
    clock.now_s += (RELEASED_S + FIRST_REPEAT_S) / 2
    assert key() is None


def test_a_terminal_that_is_gone_is_a_release(clock, monkeypatch):
    monkeypatch.setattr(holdtorun, "select", SimpleNamespace(select=lambda *ends: real_select(*ends[:3], 0.0)))
    reading, writing = os.pipe()
    key = HeldKey(reading)
    os.write(writing, b" ")
    key.wait()
    os.close(writing)
    clock.now_s += 1.01 * FIRST_REPEAT_S
    assert key() is not None
    os.close(reading)


def test_keys_of_a_terminal_come_one_by_one_and_unseen_and_everything_is_put_back(clock, monkeypatch):
    master, terminal = os.openpty()
    typist = Typist(clock, terminal, master)
    monkeypatch.setattr(holdtorun, "select", typist)
    before = termios.tcgetattr(terminal)
    with os.fdopen(terminal, "r") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with held_key() as key:
            assert termios.tcgetattr(terminal)[3] == before[3], "a job that is refused leaves the terminal as it is"
            typist.hold(1.0, repeats=1)
            key.wait()
            assert key() is None
            assert not termios.tcgetattr(terminal)[3] & (termios.ECHO | termios.ICANON)
        assert termios.tcgetattr(terminal)[3] == before[3]
    os.close(master)


def opened(clock, config, nodes=(3,)):
    node = Input(clock, value=0x10000)
    access = [SimpleNamespace(node_id=each, sdo=node) for each in nodes]
    group = SimpleNamespace(access=access, bus=node)
    return node, SimpleNamespace(config=SimpleNamespace(hold_to_run=config), group=group)


def test_a_cell_without_an_input_changes_nothing(clock):
    options = MoveOptions()
    assert with_held_input(opened(clock, None)[1], options) is options


def test_a_cell_with_an_input_is_ready_when_it_is_held_and_received_under_power_alone(clock):
    said = []
    node, arm = opened(clock, CONFIG)
    before = MoveOptions(ready=lambda: said.append("ready"))
    options = with_held_input(arm, before)
    options.ready()
    assert said == ["ready"]
    assert node.asked
    node.value = 0
    clock.now_s += RELEASED_S + 0.2
    assert options.desk.look() is None
    options.desk.under_power = True
    clock.now_s += RELEASED_S + 0.2
    wish = options.desk.look()
    assert wish is not None
    assert wish.kind is StopKind.ALONG_PATH


@pytest.mark.parametrize(("value", "held"), [(0x10000, True), (0x1FFFF, True), (0x0FFFF, False), (0, False)])
def test_only_the_bits_of_the_mask_say_whether_it_is_held(clock, value, held):
    node = Input(clock, value=value)
    source = HeldInput(node, node, CONFIG)
    source()
    clock.now_s += 0.01
    assert (source() is None) == held
