"""Output stream that never blocks its writer: a bounded queue, and a thread that writes to terminal or pipe."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final, TextIO

#: Capacity of the queue [characters]; further text is dropped and counted.
MOST_CHARS: Final = 1 << 17
#: Polling interval while waiting for an empty queue [s].
LOOK_S: Final = 0.05


class Outlet:
    """A text stream for one terminal, pipe or file.

    Written directly until `detached` is entered. While that is open, `write` only queues: a blocked terminal (Ctrl-S, a
    stalled ssh connection) delays nothing. If the queue is full, text is dropped; the number of dropped lines is
    written when there is space again.

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
        """Write or queue text; raises an earlier error of the thread, such as `BrokenPipeError`."""
        if self._failure is not None:
            raise self._failure
        with self._lock:
            if self._queue is None:  # a blocked terminal keeps the lock here: `detached` waits for it
                return self._stream.write(text)
            if self._chars + len(text) > MOST_CHARS:
                self._dropped_lines += text.count("\n")
            elif text:
                self._queue.append(text)
                self._chars += len(text)
        self._wake.set()
        return len(text)

    def flush(self) -> None:
        """Flush, if text is written directly."""
        if self._queue is None:
            self._stream.flush()

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._stream.fileno()

    # -- detached ------------------------------------------------------------------------------------------------------

    @contextmanager
    def detached(self) -> Generator[None]:
        """Queue all text; write it out on exit. Must be entered while nothing moves.

        Entering waits for a thread that is blocked by the terminal. Leaving waits for the terminal; a signal
        interrupts that.
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
        """Wait until everything is written; not to be called during motion. Returns at once after a write error."""
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
        """Return the queued text, or a line with the number of dropped lines; it counts as queued until written."""
        with self._lock:
            if not self._queue:
                lines, self._dropped_lines = self._dropped_lines, 0
                if not lines:
                    return ""
                text = f"[{lines} lines were dropped: the terminal was blocked]\n"
                self._chars += len(text)
                return text
            text = "".join(self._queue)
            self._queue.clear()
            return text

    def _put(self, text: str) -> None:
        """Write text to the file descriptor, so that a blocked thread does not hold the lock of the stream."""
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
