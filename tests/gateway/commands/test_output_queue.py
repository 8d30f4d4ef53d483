"""A terminal that takes no output: printing never waits, and dropped lines are counted."""

from __future__ import annotations

import logging
import os
import re
import threading
import time

import pytest

from gateway.commands.console import Session

MOST_CHARS = 1 << 13


class Terminal:
    """A pseudo-terminal; its other end is read only when the test says so."""

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        self.stream = os.fdopen(slave, "w")
        self.seen = b""
        self._reads = threading.Event()
        self._ends = False
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def thaw(self) -> None:
        self._reads.set()

    def _read(self) -> None:
        self._reads.wait()
        os.set_blocking(self.master, False)
        while True:
            try:
                self.seen += os.read(self.master, 65536)
            except BlockingIOError:
                if self._ends:
                    return
                time.sleep(0.001)

    def close(self) -> str:
        self.thaw()
        self._ends = True
        self._reader.join()
        self.stream.close()
        os.close(self.master)
        return self.seen.decode()


@pytest.fixture
def terminal():
    terminal = Terminal()
    yield terminal
    if not terminal.stream.closed:
        terminal.close()


@pytest.mark.timeout(30)
def test_a_frozen_terminal_delays_no_thread_at_any_verbosity(terminal, monkeypatch):
    """A progress bar, lines and a warning of a library, into a terminal that takes a few kB, and a queue of 8 kB."""
    monkeypatch.setattr("gateway.commands.output_queue.MOST_CHARS", MOST_CHARS)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr("sys.stderr", terminal.stream)
    session, lines = Session(verbosity=2), 800
    with session.detached():
        with session.progress(1.0, "move") as bar:
            for number in range(lines):
                session.note(f"line {number} of what happens in the loop", level=number % 3)
                if number % 50 == 0:
                    bar.set(number / lines, 1.0, "pose")
            logging.getLogger("can").warning("a warning of a library")
        terminal.thaw()
    seen = terminal.close()
    written = [int(number) for number in re.findall(r"line (\d+) of what happens in the loop", seen)]
    dropped = sum(int(number) for number in re.findall(r"\[(\d+) lines were dropped", seen))
    assert written[:50] == list(range(50))
    assert written == sorted(written)
    assert len(written) < lines
    assert len(written) + dropped >= lines
    assert len(seen) < 5 * MOST_CHARS


@pytest.mark.timeout(30)
def test_what_the_terminal_takes_comes_whole_and_in_order(terminal, monkeypatch):
    monkeypatch.setattr("sys.stderr", terminal.stream)
    session = Session()
    terminal.thaw()
    session.note("before")
    with session.detached():
        for number in range(100):
            session.note(f"line {number}")
        session.settle()
        session.note("last")
    session.note("after")
    assert terminal.close().split() == ["before", *" ".join(f"line {n}" for n in range(100)).split(), "last", "after"]
    assert not [each for each in threading.enumerate() if each.name == "terminal"]


def test_a_terminal_that_is_closed_is_an_error_of_the_next_line(monkeypatch):
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        session = Session()
        with session.detached():
            os.close(reading)
            session.note("into nothing")
            session.settle()
            with pytest.raises(BrokenPipeError):
                session.note("more")


def test_a_stream_without_a_descriptor_is_written_as_well(capsys):
    session = Session()
    with session.detached():
        session.show("an answer")
        session.note("a remark")
    assert tuple(capsys.readouterr()) == ("an answer\n", "a remark\n")
