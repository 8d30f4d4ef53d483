"""What is said of a recording while it runs."""

from __future__ import annotations

from gateway.acquire.events import PeriodDone, Started
from gateway.commands.console import Bar, Session
from gateway.commands.terminal import ProgressListener


def period(number: int, *, complete: bool = True, lost: int = 0, speed: float = 1.0) -> PeriodDone:
    return PeriodDone(number, "load", number, "a", speed, complete, lost)


def said(capsys, verbosity: int, *events) -> list[str]:
    listener = ProgressListener(Session(verbosity), Bar())
    for event in (Started("main", "a", 3, 20.0), *events):
        listener(event)
    return capsys.readouterr().err.splitlines()


def test_whole_periods_are_counted_and_others_say_what_they_lack(capsys):
    """A period that is driven again does not count twice."""
    several = [period(1, speed=0.25), period(1, complete=False, lost=10), period(2, complete=False), period(1)]
    assert said(capsys, 1, *several) == [
        "period 1/3: 'load' number 1 at 25%",
        "'load' number 1: 10 SYNCs not answered",
        "'load' number 2: cut short",
        "period 2/3: 'load' number 1",
    ]
    assert said(capsys, 0, *several) == ["'load' number 1: 10 SYNCs not answered"]
