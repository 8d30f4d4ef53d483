"""A process that writes, and the pipe to it: the side of the motion loop never waits.

What the pipe has no room for stays here until the next call.
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
    """A message as it goes through a pipe."""
    content = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    return _LENGTH.pack(len(content)) + content


class Inbox:
    """Puts the pieces that come out of a pipe together again; a message that was cut off never comes out."""

    def __init__(self) -> None:
        self._pieces = bytearray()

    def put(self, piece: bytes) -> None:
        """Add what was read."""
        self._pieces += piece

    def take(self) -> Any:
        """Next whole message, None if there is none."""
        if len(self._pieces) < _LENGTH.size:
            return None
        end = _LENGTH.size + _LENGTH.unpack_from(self._pieces)[0]
        if len(self._pieces) < end:
            return None
        message = pickle.loads(bytes(self._pieces[_LENGTH.size : end]))
        del self._pieces[:end]
        return message


class PipeEnd:
    """In a process that writes: the pipes from and to the one that feeds it."""

    def __init__(self, source: int, sink: int) -> None:
        self._source, self._sink = source, sink
        self._parent = os.getppid()
        self._inbox = Inbox()

    def receive(self) -> Any:
        """Next message; None = there will be none any more."""
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
        """Answer; nobody may be there to hear it any more."""
        with suppress(BrokenPipeError):
            os.write(self._sink, framed(message))


@contextmanager
def _held_back() -> Generator[None]:
    """A process that is started meanwhile never gets these signals; this one gets them afterwards."""
    # a terminal or a service manager sends these to all processes; the writer ends when its work is done
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WriterProcess:
    """The process that writes, as seen from here; `gone` once it has ended.

    It has a session of its own, so that Ctrl-C in a terminal does not reach it, and sees the end of its pipe when this
    process dies in whatever way: it then writes what it has got and ends.

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
        """Its process number."""
        return self._process.pid

    def send(self, frame: bytes) -> None:
        """Take a message in; never waits."""
        self._unsent += frame
        self._push()

    def receive(self) -> list[Any]:
        """Push on what is still here and return what has arrived; never waits."""
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
        """Wait until it says something or can take more."""
        if self.gone:
            return
        poll = select.poll()
        poll.register(self._from, select.POLLIN)
        if self._unsent:
            poll.register(self._to, select.POLLOUT)
        poll.poll(timeout_s * 1000.0)

    @property
    def unsent_bytes(self) -> int:
        """How much is still here."""
        return 0 if self.gone else len(self._unsent)

    @property
    def unsent(self) -> bool:
        """Whether something is still here."""
        return bool(self._unsent) and not self.gone

    def hang_up(self) -> None:
        """Nothing more comes: it writes what it has got and ends."""
        if self._to >= 0:
            os.close(self._to)
            self._to = -1
        self._unsent.clear()

    def end(self) -> int:
        """Wait for its end and give the pipe back; returns its exit code."""
        self.hang_up()
        code = self._process.wait()
        if self._from >= 0:
            os.close(self._from)
            self._from = -1
        self.gone = True
        return code

    def leave(self) -> None:
        """Let it go on with what it has got, for however long; nobody hears of its end."""
        self.hang_up()
        os.close(self._from)
        self._from = -1
        self.gone = True
        threading.Thread(target=self._process.wait, daemon=True, name="writer that is left").start()

    def kill(self) -> None:
        """End it at once."""
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
    """This end of a pipe, made one that never waits, above 2: where standard streams are closed, others write there."""
    import fcntl  # pipes of this kind are of Linux and macOS; what only reads needs none

    with pipe:
        descriptor = fcntl.fcntl(pipe.fileno(), fcntl.F_DUPFD_CLOEXEC, 3)
    os.set_blocking(descriptor, False)
    return descriptor
