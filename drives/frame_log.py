"""CAN frame logs in the formats of python-can: log during operation (`FrameLog`), read a log, write a BLF file."""

from __future__ import annotations

import contextlib
import errno
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import can

#: How a frame log is read, by the suffix that picks its format; the first is preferred.
_READERS: Final[dict[str, tuple[Any, str]]] = {
    ".blf": (can.BLFReader, "rb"),
    ".log": (can.CanutilsLogReader, "r"),
    ".asc": (can.ASCReader, "r"),
}
SUFFIXES: Final = tuple(_READERS)
#: Frames that may wait for the disk: 5 s of a full bus at 1 Mbit/s; further ones are dropped and counted.
_QUEUE_FRAMES: Final = 50_000
#: The writer writes at most this many frames at a time, then pauses [s]: it holds the interpreter for under 1 ms, and
#: keeps up with a full bus.
_BATCH_FRAMES: Final = 64
_PAUSE_S: Final = 0.005
#: Longest wait for the rest of the log to be written when it is closed [s].
_CLOSE_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class LoggedFrame:
    """One frame of a log.

    Attributes
    ----------
    time_s : float
        As it was logged: on most adapters seconds of this computer's wall clock.
    can_id : int
    data : bytes
    received : bool
        False: this master sent it.
    kind : str
        `data`, `remote`, `error`.
    extended : bool
        Whether the id has 29 bit.
    length : int
        Data length code; that of a remote frame is not that of its data.
    channel : str or int or None
    """

    time_s: float
    can_id: int
    data: bytes
    received: bool = True
    kind: str = "data"
    extended: bool = False
    length: int = 8
    channel: str | int | None = None


class FrameLog:
    """Frame log, written by its own thread, so that sending and receiving never wait for the disk.

    The first error switches the log off.

    Parameters
    ----------
    path : Path
        Its suffix picks the format (.blf, .log, .asc ..).

    Attributes
    ----------
    failure : OSError or None
        Why the log ends early; None = it is complete so far.
    dropped : int
        Frames that the disk was too slow for.

    Raises
    ------
    OSError, ValueError
        The file cannot be written, or its suffix is unknown.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failure: OSError | None = None
        self.dropped = 0
        self._writer: Any = can.Logger(path)
        self._waiting: deque[can.Message] = deque()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="frame-log", daemon=True)
        self._thread.start()

    def add(self, frame: can.Message) -> None:
        """Queue a frame; it must not change afterwards."""
        if self.failure is not None:
            return
        if len(self._waiting) >= _QUEUE_FRAMES:
            self.dropped += 1
            return
        self._waiting.append(frame)

    def close(self) -> None:
        """Write the queued frames and close the file; never raises, `failure` holds an error."""
        self._closing.set()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive():
            self._fail(OSError(errno.EAGAIN, f"the disk has not taken the rest within {_CLOSE_S:.0f} s"))
        if self.dropped:
            self._fail(OSError(errno.EAGAIN, f"{self.dropped} frames are missing: the disk was too slow"))

    def _run(self) -> None:
        while not self._closing.wait(_PAUSE_S) and self.failure is None:
            self._write(_BATCH_FRAMES)
        self._write(_QUEUE_FRAMES)
        try:
            self._writer.stop()
        except Exception as error:
            self._fail(error)
            with contextlib.suppress(Exception):  # python-can leaves the file open; closing it fails once more
                self._writer.file.close()

    def _write(self, most: int) -> None:
        try:
            for _ in range(min(most, len(self._waiting))):
                if self.failure is not None:
                    return
                self._writer.on_message_received(self._waiting.popleft())
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Keep the first failure, with the name of the file."""
        if self.failure is None:
            number = (error.errno if isinstance(error, OSError) else None) or errno.EIO
            said = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
            self.failure = OSError(number, f"the frame log is incomplete: {said}", str(self.path))
            self._waiting.clear()


def read_frames(path: Path) -> list[LoggedFrame]:
    """Every frame of a log, in its order.

    Parameters
    ----------
    path : Path
        Its suffix is one of `SUFFIXES`.

    Raises
    ------
    ValueError
        It is not a frame log, or damaged.
    OSError
        It cannot be read.
    """
    reader, mode = _READERS[path.suffix.lower()]
    try:
        with path.open(mode) as stream:
            return [_of_message(message) for message in reader(stream)]
    except OSError:
        raise
    except Exception as error:  # python-can's readers report damage by many kinds of exception
        raise ValueError(" ".join(str(error).split())[:200] or type(error).__name__) from error


def write_blf(path: Path, frames: Iterable[LoggedFrame]) -> None:
    """Write frames as BLF, with the times that they have.

    Raises
    ------
    OSError
        It cannot be written.
    """
    with can.BLFWriter(path) as log:
        for frame in frames:
            log.on_message_received(_message(frame))


def _of_message(message: Any) -> LoggedFrame:
    kind = "error" if message.is_error_frame else "remote" if message.is_remote_frame else "data"
    return LoggedFrame(
        time_s=message.timestamp,
        can_id=message.arbitration_id,
        data=bytes(message.data),
        received=message.is_rx,
        kind=kind,
        extended=message.is_extended_id,
        length=message.dlc,
        channel=message.channel,
    )


def _message(frame: LoggedFrame) -> can.Message:
    return can.Message(
        timestamp=frame.time_s,
        arbitration_id=frame.can_id,
        data=frame.data,
        is_rx=frame.received,
        is_error_frame=frame.kind == "error",
        is_remote_frame=frame.kind == "remote",
        is_extended_id=frame.extended,
        dlc=frame.length,
        channel=frame.channel,
    )
