"""Processor time of a test: what it costs whatever else the computer does."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

#: Most processor time of a test that is not marked slow [s], on the reference computer.
FAST_LIMIT_S: Final = 3.0
#: Processor time of `_reference_work` on the reference computer when it is idle [s].
REFERENCE_S: Final = 0.028
_ROUNDS: Final = 560_000


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


def slowness() -> float:
    """Factor by which a second of work costs more here and now than on the reference computer, at least 1.

    A slower processor, or a core that two processes share, makes the same work cost more processor time.
    """
    return max(1.0, *(_reference_work() / REFERENCE_S for _ in range(3)))


def _reference_work() -> float:
    begin_s = time.process_time()
    total = 0
    for number in range(_ROUNDS):
        total += number % 7
    return time.process_time() - begin_s
