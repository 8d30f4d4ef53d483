"""Writer process and the pipe to it, without blocking the motion loop.

Messages that do not fit in the pipe wait here until the next call.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any

from gateway.errors import ENDING_SIGNALS

#: Largest piece that is read or written at once; the size of a pipe.
PIECE_BYTES = 65536
#: Between two looks whether the process that feeds this one is still there: another one may hold its end of the pipe.
LOOK_S = 0.5
_LENGTH = struct.Struct("<Q")


def framed(message: object) -> bytes:
    """Return a message with its length prefix, as sent through a pipe."""
    content = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    return _LENGTH.pack(len(content)) + content


class Inbox:
    """Reassembles messages from the bytes of a pipe; a truncated message is never returned."""

    def __init__(self) -> None:
        self._pieces = bytearray()

    def put(self, piece: bytes) -> None:
        """Add received bytes."""
        self._pieces += piece

    def take(self) -> Any:
        """Return the next complete message, None if there is none."""
        if len(self._pieces) < _LENGTH.size:
            return None
        end = _LENGTH.size + _LENGTH.unpack_from(self._pieces)[0]
        if len(self._pieces) < end:
            return None
        message = pickle.loads(bytes(self._pieces[_LENGTH.size : end]))
        del self._pieces[:end]
        return message


class PipeEnd:
    """Pipes of a writer process, from and to the process that sends to it."""

    def __init__(self, source: int, sink: int) -> None:
        self._source, self._sink = source, sink
        self._parent = os.getppid()
        self._inbox = Inbox()

    def receive(self) -> Any:
        """Return the next message; None after the end of the input."""
        while (message := self._inbox.take()) is None:
            if not select.select([self._source], [], [], LOOK_S)[0]:
                if os.getppid() != self._parent:
                    return None
                continue
            piece = os.read(self._source, PIECE_BYTES)
            if not piece:
                return None
            self._inbox.put(piece)
        return message

    def say(self, message: object) -> None:
        """Send an answer; ignore a closed pipe."""
        with suppress(BrokenPipeError):
            os.write(self._sink, framed(message))


@contextmanager
def _held_back() -> Generator[None]:
    """Block signals during the start of a child, which inherits the mask; they are delivered here afterwards."""
    # a terminal or a service manager sends these to all processes; the writer ends when its work is done
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WriterProcess:
    """Handle of a writer process; `gone` once it has ended.

    The process has its own session, so that Ctrl-C in a terminal does not reach it. When this process dies, its pipe
    is closed; it then writes the received data and ends.

    Parameters
    ----------
    program : str
        Module that is run.
    """

    def __init__(self, program: str) -> None:
        # The same modules are found there as here, wherever this process was started.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
        with _held_back():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )
        self._to, self._from = _own_end(self._process.stdin), _own_end(self._process.stdout)
        self._unsent = bytearray()
        self._inbox = Inbox()
        self.gone = False

    @property
    def pid(self) -> int:
        """Process number."""
        return self._process.pid

    def send(self, frame: bytes) -> None:
        """Queue a message; does not block."""
        self._unsent += frame
        self._push()

    def receive(self) -> list[Any]:
        """Send queued data and return the received answers; does not block."""
        self._push()
        while not self.gone:
            try:
                piece = os.read(self._from, PIECE_BYTES)
            except BlockingIOError:
                break
            self._inbox.put(piece)
            self.gone = not piece
        return list(iter(self._inbox.take, None))

    def wait(self, timeout_s: float) -> None:
        """Wait until the process answers or its pipe accepts data."""
        if self.gone:
            return
        poll = select.poll()
        poll.register(self._from, select.POLLIN)
        if self._unsent:
            poll.register(self._to, select.POLLOUT)
        poll.poll(timeout_s * 1000.0)

    @property
    def unsent_bytes(self) -> int:
        """Number of queued bytes not yet sent."""
        return 0 if self.gone else len(self._unsent)

    @property
    def unsent(self) -> bool:
        """Return whether queued data remain."""
        return bool(self._unsent) and not self.gone

    def close_pipe(self) -> None:
        """Close the input of the process: it writes the received data and ends."""
        if self._to >= 0:
            os.close(self._to)
            self._to = -1
        self._unsent.clear()

    def end(self) -> int:
        """Wait for the end of the process, close its pipes and return its exit code."""
        self.close_pipe()
        code = self._process.wait()
        if self._from >= 0:
            os.close(self._from)
            self._from = -1
        self.gone = True
        return code

    def leave(self) -> None:
        """Let the process finish in the background; its end is not reported."""
        self.close_pipe()
        os.close(self._from)
        self._from = -1
        self.gone = True
        threading.Thread(target=self._process.wait, daemon=True, name="writer that is left").start()

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()
        self.end()

    def _push(self) -> None:
        if not self._unsent or self._to < 0:
            return
        try:
            with memoryview(self._unsent) as view:
                sent = os.write(self._to, view[:PIECE_BYTES])
        except BlockingIOError:
            return
        except BrokenPipeError:
            # It has ended; receive() says so once everything it had said is read.
            sent = len(self._unsent)
        del self._unsent[:sent]


def _own_end(pipe: Any) -> int:
    """Return a non-blocking pipe end with a descriptor above 2, so that it cannot replace a closed standard stream."""
    import fcntl  # pipes of this kind are of Linux and macOS; what only reads needs none

    with pipe:
        descriptor = fcntl.fcntl(pipe.fileno(), fcntl.F_DUPFD_CLOEXEC, 3)
    os.set_blocking(descriptor, False)
    return descriptor
