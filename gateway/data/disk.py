"""Files that another process writes, so that the motion loop never waits for a disk.

`Disk` is that process (`gateway.data.recording.disk_process`) with the one pipe to it: it writes everything that a
moving command leaves, i.e. recording, black box and frame log. `DiskFile` is one file of it. A message is a call of a
method of the file's writer. The process answers each message when it is on disk; until then the message is kept here,
so that a process that ended is started again without loss.
"""

from __future__ import annotations

import errno
import itertools
import math
import pickle
import select
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Self

from drives.child_process import ADVICE, PIECE_BYTES, complete_messages, framed, start_module
from gateway.errors import ENDING_SIGNALS

PROGRAM: Final = "gateway.data.recording.disk_process"
#: Limit of the data of one file that are not confirmed.
MOST_BYTES: Final = 64_000_000
#: Time limit for the start of the process, and for its end [s].
START_TIMEOUT_S: Final = 60.0
END_TIMEOUT_S: Final = 10.0
#: Longest wait for the pipe at a time [ms].
WAIT_MS: Final = 500


class Disk:
    """The process that writes, from the first `open` to `close`; may be used by several threads.

    The process has its own session, so that Ctrl-C in a terminal does not reach it. When this program dies, the pipe
    is closed; the process then writes the received data and ends.

    Parameters
    ----------
    most_bytes : int
        Limit of the data of one file that wait for the disk.

    Attributes
    ----------
    gone : bool
        No process is running.
    files : dict of int to DiskFile
        Open ones by number.
    lock : RLock
        Of all of this and of the files.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self.most_bytes, self.gone = most_bytes, True
        self.files: dict[int, DiskFile] = {}
        self.lock = threading.RLock()
        self._numbers = itertools.count()
        self._process: Any = None
        self._unsent, self._received = bytearray(), bytearray()

    def open(self, kind: Callable[..., Any], path: Path, *arguments: object) -> DiskFile:
        """Open a file and wait until it is open, or until its `failure` is known; not for the motion loop.

        Parameters
        ----------
        kind : callable
            Function of a module that returns the context of the writer. The process calls it with the path, these
            arguments, and whether it is a restart: messages may then arrive a second time.
        path : Path
        """
        with self.lock:
            file = DiskFile(self, next(self._numbers), (kind, path, *arguments))
            self.files[file.number] = file
            if self.gone:
                self.start()
            else:
                self.pump(file.unconfirmed())
        if not file.settle(START_TIMEOUT_S):
            file.failure = OSError(errno.EPIPE, f"the process that writes it does not start; {ADVICE}")
        if file.failure is not None:
            file.forget()
        return file

    def start(self) -> None:
        """Start the process, again if it has ended, with every open file and the messages that are not on disk."""
        with self.lock:
            self._end()
            self._process = start_module(PROGRAM, ENDING_SIGNALS)
            self.gone = False
            self.pump(b"".join(file.unconfirmed() for file in self.files.values()))

    def pump(self, messages: bytes = b"") -> None:
        """Queue messages, send what the pipe accepts, and take the answers; does not block."""
        with self.lock:
            if self.gone:
                return
            self._unsent += messages
            if self._unsent:
                try:
                    with memoryview(self._unsent) as view:
                        sent = self._process.stdin.write(view[:PIECE_BYTES]) or 0
                except BrokenPipeError:  # it has ended: what it had answered before is read below
                    sent = len(self._unsent)
                del self._unsent[:sent]
            while not self.gone and (piece := self._process.stdout.read(PIECE_BYTES)) is not None:
                self._received += piece
                self.gone = not piece
            for number, message, content in complete_messages(self._received):
                if (file := self.files.get(number)) is not None:
                    file.take(message, pickle.loads(content))

    def wait(self) -> None:
        """Wait until the process answers or the pipe accepts queued data, then `pump`."""
        poll = select.poll()
        poll.register(self._process.stdout, select.POLLIN)
        if self._unsent:
            poll.register(self._process.stdin, select.POLLOUT)
        poll.poll(WAIT_MS)
        self.pump()

    def close(self) -> None:
        """End the process: it writes the received data; after a time it continues in the background."""
        until_s = time.monotonic() + END_TIMEOUT_S
        while not self.gone and time.monotonic() < until_s:
            if not self._unsent:
                self._process.stdin.close()
            self.wait()
        self._end()

    def _end(self) -> None:
        """Close the pipes; a process that is still running is not waited for."""
        if self._process is None:
            return
        self._process.stdin.close()
        self._process.stdout.close()
        self._unsent, self._received = bytearray(), bytearray()
        if self.gone:
            self._process.wait()
        else:
            threading.Thread(target=self._process.wait, daemon=True, name="end of the disk process").start()
        self._process, self.gone = None, True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class DiskFile:
    """A file that the process writes.

    Attributes
    ----------
    disk : Disk
    number : int
        Of this file among those of the process.
    confirmed : int
        Number of the last message that is on disk with all before it; 0 = it is open, -1 = not yet.
    failure, first_failure : OSError or None
        Error of the last message that was answered, and of the first one that failed.
    """

    def __init__(self, disk: Disk, number: int, opening: tuple[Any, ...]) -> None:
        self.disk, self.number = disk, number
        self.failure: OSError | None = None
        self.first_failure: OSError | None = None
        self.confirmed = self._answered = -1
        self._opening, self._last = opening, 0
        self._messages: dict[int, bytes] = {}

    @property
    def is_open(self) -> bool:
        """Return whether the file is neither closed nor has failed for good."""
        return self.number in self.disk.files

    @property
    def full(self) -> bool:
        """Return whether too much waits for the disk: the caller drops what comes, or stops."""
        return sum(map(len, self._messages.values())) >= self.disk.most_bytes

    def put(self, method: Callable[..., None] | None, *arguments: object) -> int:
        """Call a method of the writer in the process, None: close it; does not wait. Return the message's number.

        A file that is not open takes no messages.
        """
        with self.disk.lock:
            if self.is_open:
                self._last += 1
                call = method and (method, arguments)
                self._messages[self._last] = framed(self.number, self._last, call)
                self.disk.pump(self._messages[self._last])
            return self._last

    def unconfirmed(self) -> bytes:
        """Return what a new process needs: how the file is opened, and the messages that are not on disk."""
        self._answered = self.confirmed
        return framed(self.number, 0, (*self._opening, self.confirmed >= 0)) + b"".join(self._messages.values())

    def take(self, number: int, failure: OSError | None) -> None:
        """Take the answer to a message: success confirms those before it as well, a failure confirms none."""
        self._answered, self.failure = max(self._answered, number), failure
        self.first_failure = self.first_failure or failure
        if failure is None:
            self.confirmed = max(self.confirmed, number)
            self._messages = {each: message for each, message in self._messages.items() if each > number}

    def settle(self, limit_s: float = math.inf, *, again: bool = True) -> bool:
        """Wait until the last message is answered; return whether it is. Not for the motion loop.

        Parameters
        ----------
        limit_s : float
            Longest wait [s].
        again : bool
            Start a process that has ended again, once.
        """
        until_s = time.monotonic() + limit_s
        while self.is_open and self._answered < self._last:
            if self.disk.gone:
                if not again:
                    return False
                again = False
                self.disk.start()
            if time.monotonic() >= until_s:
                return False
            self.disk.wait()
        return True

    def close(self, limit_s: float = math.inf, *, again: bool = True) -> bool:
        """Close the file when its messages are on disk; return whether that is done, as `settle`."""
        self.put(None)
        try:
            return self.settle(limit_s, again=again)
        finally:
            self.forget()

    def forget(self) -> None:
        """Put no more messages: the file is closed, or has failed for good."""
        with self.disk.lock:
            self.disk.files.pop(self.number, None)
