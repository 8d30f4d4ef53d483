"""What a reader of foreign input must keep to: a typed error or a result, little time, little memory."""

from __future__ import annotations

import signal
import threading
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Result = TypeVar("Result")

#: Processor time that one input may take.
TIME_LIMIT_S = 5.0
#: Memory that any parse may take, however short the input; beyond it, ten times the input.
BASE_BYTES = 2 << 20
PER_INPUT_BYTE = 10


class Unfinished(BaseException):
    """One input took longer than the limit."""


@contextmanager
def cpu_limit(limit_s: float = TIME_LIMIT_S) -> Iterator[None]:
    """Raise `Unfinished` when the block takes more processor time than this; only in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def expired(_signal: int, _frame: object) -> None:
        raise Unfinished(f"more than {limit_s} s of processor time")

    before = signal.signal(signal.SIGVTALRM, expired)
    signal.setitimer(signal.ITIMER_VIRTUAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def bounded(call: Callable[[], Result], allowed: tuple[type[Exception], ...], size: int) -> Result | None:
    """Result of `call`, or None after an allowed error; anything else that escapes is the failure itself.

    Parameters
    ----------
    call : callable
        Reads the input.
    allowed : tuple of exception types
        The reader's typed errors.
    size : int
        Length of the input, bytes; the peak of memory is held against it.
    """
    tracemalloc.start()
    try:
        with cpu_limit():
            try:
                result = call()
            except allowed as error:
                if not str(error).strip():
                    raise AssertionError(f"{type(error).__name__} says nothing") from error
                result = None
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    limit = BASE_BYTES + PER_INPUT_BYTE * size
    if peak > limit:
        raise AssertionError(f"{peak} bytes of memory for an input of {size} bytes")
    return result
