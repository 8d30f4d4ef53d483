"""An output that never makes its writer wait: text goes to a bounded queue, a thread hands it to terminal or pipe."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final, TextIO

#: Text that may wait for the terminal [characters]; further text is dropped and counted.
MOST_CHARS: Final = 1 << 17
#: How often whoever waits for the queue looks whether it is empty [s].
LOOK_S: Final = 0.05


class Outlet:
    """A text stream for one terminal, pipe or file.

    Written directly until `detached` is entered. While that is open, `write` only queues: a terminal that takes no
    output (Ctrl-S, an ssh connection that hangs) delays nobody. What the queue has no room for is dropped, and the
    number of dropped lines is written once there is room again.

    Parameters
    ----------
    stream : TextIO
    """

    def __init__(self, stream: TextIO) -> None:
        self.encoding = getattr(stream, "encoding", None) or "utf-8"
        self._stream = stream
        self._lock = threading.Lock()
        self._queue: deque[str] | None = None
        self._chars = self._dropped_lines = 0
        self._written = threading.Event()
        self._wake = threading.Event()
        self._closing = False
        self._failure: OSError | None = None

    # -- as a stream ---------------------------------------------------------------------------------------------------

    def write(self, text: str) -> int:
        """Write or queue; raises what the thread has met, such as `BrokenPipeError`, at the next call."""
        if self._failure is not None:
            raise self._failure
        with self._lock:
            if self._queue is None:  # a terminal that hangs here keeps the lock: `detached` waits for it
                return self._stream.write(text)
            if self._chars + len(text) > MOST_CHARS:
                self._dropped_lines += text.count("\n")
            elif text:
                self._queue.append(text)
                self._chars += len(text)
        self._wake.set()
        return len(text)

    def flush(self) -> None:
        """Flush where text is written directly."""
        if self._queue is None:
            self._stream.flush()

    def isatty(self) -> bool:
        """Whether a person looks at it."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Its file descriptor."""
        return self._stream.fileno()

    # -- detached ------------------------------------------------------------------------------------------------------

    @contextmanager
    def detached(self) -> Generator[None]:
        """Queue what is written; on leaving, what waits is written out. To be entered while nothing moves.

        Entering waits for a thread that is being held up by the terminal. Leaving waits for the terminal as any program
        does; a signal interrupts that.
        """
        with self._lock:
            nested, self._closing = self._queue is not None, False
            if not nested:
                self._stream.flush()
                self._queue = deque()
        if nested:
            yield
            return
        writer = threading.Thread(target=self._run, name="terminal", daemon=True)
        writer.start()
        try:
            yield
        finally:
            try:
                self.settle()
            finally:
                self._closing = True
                self._wake.set()
                with self._lock:
                    self._queue = None
            writer.join(LOOK_S)

    def settle(self) -> None:
        """Wait until everything is written; not while anything moves. Nothing to wait for where it fails."""
        while self._queue is not None and self._failure is None and (self._chars or self._dropped_lines):
            self._written.wait(LOOK_S)
            self._written.clear()

    def _run(self) -> None:
        while not self._closing:
            self._wake.wait()
            self._wake.clear()
            while text := self._taken():
                try:
                    self._put(text)
                except OSError as error:
                    self._failure = error
                    return
                with self._lock:
                    self._chars -= len(text)
                self._written.set()
            self._written.set()

    def _taken(self) -> str:
        """What waits, or the number of the lines that were dropped; they count as waiting until they are written."""
        with self._lock:
            if not self._queue:
                lines, self._dropped_lines = self._dropped_lines, 0
                if not lines:
                    return ""
                text = f"[{lines} lines were dropped: this terminal took no output]\n"
                self._chars += len(text)
                return text
            text = "".join(self._queue)
            self._queue.clear()
            return text

    def _put(self, text: str) -> None:
        """Hand text to the system. By the descriptor: a thread that hangs there holds no lock of the stream."""
        try:
            number = self._stream.fileno()
        except (OSError, ValueError, AttributeError):
            self._stream.write(text)
            self._stream.flush()
            return
        rest = memoryview(text.encode(self.encoding, errors="replace"))
        while rest:
            with contextlib.suppress(InterruptedError):
                rest = rest[os.write(number, rest) :]
