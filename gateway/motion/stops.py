"""Stop requests: every request is stored here, and the motion loop checks it at every SYNC.

Two kinds of stop can be requested; a third follows where they fail (`drives.stopping`: heartbeat stopped).

    along the path   all drives are healthy: operator, prompt, slow disk, internal force
    quick stop       contact, exceeded limit, second signal
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import stat
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from gateway.errors import ENDING_SIGNALS

#: Cause of a stop after the output was closed.
CLOSED: Final = "stopped: the terminal was closed"


class StopKind(IntEnum):
    """Urgency of a stop; the larger one wins."""

    ALONG_PATH = 1
    QUICK_STOP = 2


class StoppedByPerson(KeyboardInterrupt):
    """A person, a signal or a closed terminal requested a stop; the text names it."""


@dataclass(frozen=True, slots=True)
class StopRequest:
    """One stop request.

    Attributes
    ----------
    kind : StopKind
    cause : BaseException
        Raised once the arms are at rest.
    """

    kind: StopKind
    cause: BaseException


#: Called at every SYNC; None = continue.
StopSource = Callable[[], StopRequest | None]


class StopDesk:
    """Store of stop requests; `ask` may be called from any thread and from a signal handler.

    Requests are only ever appended: one that interrupts another, in a signal handler or a second thread, cannot
    overwrite it. The most urgent one counts.

    Attributes
    ----------
    under_power : bool
        Set by the motion loop: a signal then requests a stop, at other times it interrupts at once.
    """

    def __init__(self, *sources: StopSource) -> None:
        self.under_power = False
        self._sources = list(sources)
        self._requests: list[StopRequest] = []

    def watch(self, source: StopSource) -> None:
        """Add a source of stop requests, which is called at every SYNC."""
        self._sources.append(source)

    def forget(self, source: StopSource) -> None:
        """Remove a source added by `watch`."""
        self._sources.remove(source)

    def ask(self, cause: BaseException, kind: StopKind = StopKind.ALONG_PATH) -> None:
        """Request a stop; the first cause is kept, the most urgent kind wins."""
        if all(kind > request.kind for request in self._requests):
            self._requests.append(StopRequest(kind, cause))

    def look(self) -> StopRequest | None:
        """Return the present request, after checking all sources."""
        for source in self._sources:
            wish = source()
            if wish is not None:
                self.ask(wish.cause, wish.kind)
        requests = tuple(self._requests)
        if not requests:
            return None
        return StopRequest(max(request.kind for request in requests), requests[0].cause)

    def asked(self) -> bool:
        """Return True if a stop is requested."""
        return self.look() is not None


@contextmanager
def signals_ask(desk: StopDesk) -> Generator[None]:
    """Handle SIGINT, SIGTERM and SIGHUP: request a stop along the path, and a quick stop at the second signal.

    While nothing is under power they interrupt at once (`StoppedByPerson`), except a second signal after the stop: the
    command is ending and saves the measured data. A signal inherited as ignored is handled as well. Outside the main
    thread, where Python handles no signals, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received = 0

    def on_signal(number: int, _frame: Any) -> None:
        nonlocal received
        cause = StoppedByPerson(f"stopped by {signal.Signals(number).name}")
        second_after_stop = received == 1
        if not desk.under_power and not second_after_stop:
            raise cause
        received += 1
        desk.ask(cause, StopKind.ALONG_PATH if received == 1 else StopKind.QUICK_STOP)

    before = {number: signal.signal(number, on_signal) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def outputs_watched(descriptors: Sequence[int] = (1, 2)) -> StopSource:
    """Return a source that requests a stop along the path once standard output or error is closed.

    A closed terminal or pipe is detected at the next SYNC, not at the next output; one that was closed before prevents
    the start. Other kinds of output are not checked.

    Parameters
    ----------
    descriptors : sequence of int
        File descriptors of the outputs.
    """
    poll = select.poll()
    for number in descriptors:
        with contextlib.suppress(OSError):
            mode = os.fstat(number).st_mode
            if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(number):
                poll.register(number, 0)
    asking = threading.Lock()

    def closed() -> StopRequest | None:
        if not asking.acquire(blocking=False):  # the thread of another arm is checking at this moment
            return None
        try:
            if not poll.poll(0):
                return None
        finally:
            asking.release()
        return StopRequest(StopKind.ALONG_PATH, StoppedByPerson(CLOSED))

    return closed


@contextmanager
def terminal_mode(terminal: int) -> Generator[list[Any]]:
    """Yield the settings of a terminal (`termios.tcgetattr`), to be changed and set; afterwards they are as before.

    Raises
    ------
    StoppedByPerson
        The terminal is closed.
    """
    import termios  # of Linux and macOS

    try:
        before = termios.tcgetattr(terminal)
    except termios.error as error:
        raise StoppedByPerson(CLOSED) from error
    try:
        yield [*before]
    finally:
        with contextlib.suppress(termios.error):  # closed meanwhile: what ends the block is the cause
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def output_closed(error: BaseException) -> bool:
    """Return True if an error means that the output is closed.

    The rich library ends the program by SystemExit in that case.
    """
    if isinstance(error, SystemExit):
        return isinstance(error.__context__, BrokenPipeError)
    return isinstance(error, BrokenPipeError)


def guarded(listener: Callable[..., None], desk: StopDesk) -> Callable[..., None]:
    """Wrap a listener so that an exception becomes a request to stop along the path."""

    def safely(*arguments: Any) -> None:
        try:
            listener(*arguments)
        except BaseException as error:
            desk.ask(StoppedByPerson(CLOSED) if output_closed(error) else error)

    return safely
