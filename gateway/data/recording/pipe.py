"""What the motion loop and the process that writes the recording say to each other, and the pipe between them.

The loop's side never waits: what the pipe has no room for stays here until the next call.
"""

from __future__ import annotations

import fcntl
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.data.period import Period
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import ArmHeader, RecordingHeader, Write
from gateway.data.visit import Visit

PROGRAM = "gateway.data.recording.process"
#: Largest piece that is read or written at once; the size of a pipe.
PIECE_BYTES = 65536
#: A terminal or a service manager sends these to all processes; the writer ends when its work is done.
NOT_FOR_THE_WRITER = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_LENGTH = struct.Struct("<Q")


@dataclass(frozen=True, slots=True)
class Start:
    """First message to the writer: the file; fields as of `RecordingWriter`."""

    path: Path
    header: RecordingHeader
    arm: ArmHeader
    earlier: Recording | None
    write: Write


@dataclass(frozen=True, slots=True, eq=False)
class Keep:
    """To the writer: a visit or a period that has its number."""

    arm: str
    visit: Visit | Period


@dataclass(frozen=True, slots=True)
class Finish:
    """To the writer: how the run ended; fields as of `RecordingWriter.finish`, and the number of the question."""

    question: int
    arm: str
    status: str
    reason: str
    statistics: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Ready:
    """From the writer, once: it has begun, or why it cannot (empty = it can)."""

    refused: str


@dataclass(frozen=True, slots=True)
class Written:
    """From the writer: all visits up to this number are on disk."""

    number: int


@dataclass(frozen=True, slots=True)
class Failed:
    """From the writer: a write has failed; the visit is still held and goes into the next one."""

    reason: str


@dataclass(frozen=True, slots=True)
class Finished:
    """From the writer: answer to that `Finish`; why it could not be written (empty = it is on disk)."""

    question: int
    failed: str


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


@contextmanager
def _held_back() -> Generator[None]:
    """A process that is started meanwhile never gets these signals; this one gets them afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, NOT_FOR_THE_WRITER)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WriterProcess:
    """The process that writes, as seen from here; `gone` once it has ended.

    It has a session of its own, so that Ctrl-C in a terminal does not reach it, and sees the end of its pipe when this
    process dies in whatever way: it then writes what it has got and ends.
    """

    def __init__(self) -> None:
        # The same modules are found there as here, wherever this process was started.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
        with _held_back():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", PROGRAM],
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
    with pipe:
        descriptor = fcntl.fcntl(pipe.fileno(), fcntl.F_DUPFD_CLOEXEC, 3)
    os.set_blocking(descriptor, False)
    return descriptor
