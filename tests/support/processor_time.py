"""Processor time of a test: what it costs whatever else the computer does."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

#: Most processor time of a test that is not marked slow [s].
FAST_LIMIT_S: Final = 3.0


def processor_time_s() -> float:
    """User and system time of this process and of its children that have ended [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class Stopwatch:
    """Processor time since it was made, less the time in which it was paused."""

    def __init__(self) -> None:
        self._begin_s = processor_time_s()

    def spent_s(self) -> float:
        """Processor time so far [s]."""
        return processor_time_s() - self._begin_s

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Leave out what is spent inside; pauses may be nested."""
        begin_s = self._begin_s
        before_s = processor_time_s()
        try:
            yield
        finally:
            self._begin_s = begin_s + processor_time_s() - before_s
