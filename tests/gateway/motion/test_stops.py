"""Stop requests: the first cause is kept, the most urgent kind wins, signals and listeners are sources too."""

import os
import signal
import sys
import threading
import weakref

import pytest

from gateway.errors import ENDING_SIGNALS
from gateway.motion.stops import (
    StopDesk,
    StopKind,
    StoppedByPerson,
    StopRequest,
    guarded,
    output_closed,
    outputs_watched,
    signals_ask,
)


def test_the_first_cause_is_kept_and_the_most_urgent_kind_wins():
    desk = StopDesk()
    assert desk.look() is None
    first, second = ValueError("first"), ValueError("second")
    desk.ask(first)
    desk.ask(second, StopKind.QUICK_STOP)
    desk.ask(second)
    assert desk.look() == StopRequest(StopKind.QUICK_STOP, first)


@pytest.mark.parametrize("line", range(1, 8))
@pytest.mark.parametrize("pending", [(), (StopKind.ALONG_PATH,)])
def test_a_request_that_interrupts_another_one_is_not_overwritten(line, pending):
    """A signal handler, or another thread, asks for a quick stop between any two lines of a weaker request."""
    desk, lines = StopDesk(), []
    for kind in pending:
        desk.ask(ValueError("before"), kind)

    def on_line(frame, event, _argument):
        if event == "line":
            lines.append(frame.f_lineno)
            if len(lines) == line:
                sys.settrace(None)
                desk.ask(ValueError("second signal"), StopKind.QUICK_STOP)
        return on_line

    before = sys.gettrace()
    sys.settrace(lambda frame, _event, _argument: on_line if frame.f_code is StopDesk.ask.__code__ else None)
    try:
        desk.ask(ValueError("first signal"))
    finally:
        sys.settrace(before)
    if len(lines) < line:
        desk.ask(ValueError("second signal"), StopKind.QUICK_STOP)
    wish = desk.look()
    assert wish is not None
    assert wish.kind is StopKind.QUICK_STOP


def test_requests_that_repeat_do_not_pile_up():
    """Of a hundred requests with a cause each the desk keeps one alive."""
    desk, kept = StopDesk(), weakref.WeakSet[StoppedByPerson]()

    def full() -> StopRequest:
        kept.add(cause := StoppedByPerson("full"))
        return StopRequest(StopKind.ALONG_PATH, cause)

    desk.watch(full)
    assert [desk.look().cause for _ in range(100)] == 100 * list(kept)


def test_sources_are_asked_until_they_are_forgotten():
    desk, wish = StopDesk(), StopRequest(StopKind.ALONG_PATH, ValueError("full"))

    def full():
        return wish

    desk.watch(full)
    desk.forget(full)
    assert not desk.asked()
    desk.watch(full)
    assert desk.look() == wish


@pytest.mark.parametrize("number", ENDING_SIGNALS)
def test_under_power_a_signal_asks_and_the_second_one_is_urgent(number):
    desk, before = StopDesk(), signal.getsignal(number)
    with signals_ask(desk):
        desk.under_power = True
        signal.raise_signal(number)
        assert desk.look().kind is StopKind.ALONG_PATH
        assert isinstance(desk.look().cause, KeyboardInterrupt)
        assert number.name in str(desk.look().cause)
        signal.raise_signal(signal.SIGINT)
        assert desk.look().kind is StopKind.QUICK_STOP
    assert signal.getsignal(number) is before


def test_a_second_signal_after_the_stop_does_not_interrupt_what_is_being_kept():
    desk = StopDesk()
    with signals_ask(desk):
        desk.under_power = True
        signal.raise_signal(signal.SIGINT)
        desk.under_power = False
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(StoppedByPerson):
            signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("number", ENDING_SIGNALS)
def test_a_signal_that_was_inherited_as_ignored_is_received(number):
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with signals_ask(StopDesk()), pytest.raises(StoppedByPerson, match=number.name):
            signal.raise_signal(number)
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_a_listener_that_fails_asks_for_a_stop_and_breaks_nothing():
    desk = StopDesk()

    def broken(_event):
        raise BrokenPipeError(32, "Broken pipe")

    guarded(broken, desk)("event")
    assert isinstance(desk.look().cause, StoppedByPerson)
    assert "terminal" in str(desk.look().cause)
    other = StopDesk()
    guarded(lambda: 1 / 0, other)()
    assert isinstance(other.look().cause, ZeroDivisionError)


def test_a_closed_output_is_a_wish_to_stop():
    ends = [os.pipe() for _ in range(2)]
    source = outputs_watched([write for _, write in ends])
    assert source() is None
    os.close(ends[1][0])
    wish = source()
    assert wish is not None
    assert wish.kind is StopKind.ALONG_PATH
    assert "terminal was closed" in str(wish.cause)
    for descriptor in (ends[0][0], *(write for _, write in ends)):
        os.close(descriptor)


def test_an_output_that_was_closed_before_lets_nothing_begin():
    read, write = os.pipe()
    os.close(read)
    wish = outputs_watched([write])()
    assert wish is not None
    assert "terminal was closed" in str(wish.cause)
    os.close(write)


def test_an_output_that_is_a_file_or_nothing_is_not_looked_at(tmp_path):
    with (tmp_path / "log").open("w") as log:
        assert outputs_watched([log.fileno(), 9999])() is None


def ended_by_rich() -> SystemExit:
    """What rich raises when it prints to a closed pipe."""
    try:
        try:
            raise BrokenPipeError
        except BrokenPipeError:
            raise SystemExit(1)  # noqa: B904 - as rich does it
    except SystemExit as error:
        return error


def test_a_listener_that_prints_to_a_closed_pipe_is_a_closed_terminal():
    desk = StopDesk()

    def printed(*_arguments):
        raise ended_by_rich()

    guarded(printed, desk)()
    wish = desk.look()
    assert wish is not None
    assert isinstance(wish.cause, StoppedByPerson)
    assert not output_closed(SystemExit(1))


def test_two_threads_may_ask_about_the_outputs_at_the_same_time():
    read, write = os.pipe()
    source = outputs_watched([write])
    failed = []

    def ask():
        try:
            for _ in range(20_000):
                source()
        except RuntimeError as error:
            failed.append(error)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    os.close(read)
    os.close(write)


def test_outside_the_main_thread_signals_are_left_as_they_are():
    before = [signal.getsignal(number) for number in ENDING_SIGNALS]
    seen = []

    def run():
        with signals_ask(StopDesk()):
            seen.append([signal.getsignal(number) for number in ENDING_SIGNALS])

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [before]


def test_a_listener_that_runs_well_is_notified_and_asks_for_nothing():
    desk, reported = StopDesk(), []
    guarded(lambda *words: reported.append(words), desk)("a", 1)
    assert reported == [("a", 1)]
    assert not desk.asked()
