"""Frame log of a bus during operation: a tap that packs its frames and sends them twice a second to the disk."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from drives.child_process import ENDED
from drives.errors import BusError
from drives.frame_log import FRAME, add_packed, open_log, packed_frame
from gateway.data.disk import Disk

#: Between two messages to the process that writes [s]: half of what a kill may cost.
PART_S: Final = 0.5
#: Longest wait for the rest of the log to be written when it is closed [s].
CLOSING_S: Final = 10.0


class FrameLog:
    """Frame log of one bus; its first error switches it off.

    Parameters
    ----------
    disk : Disk
    path : Path
        Its suffix picks the format (.blf, .log, .asc ..).

    Attributes
    ----------
    dropped : int
        Frames that the disk was too slow for.

    Raises
    ------
    BusError
        The file cannot be written, or its suffix is unknown.
    """

    def __init__(self, disk: Disk, path: Path) -> None:
        self.dropped, self._path = 0, path
        self._failure: OSError | None = None
        self._frames, self._handed_s = bytearray(), time.monotonic()
        self._channel: str | int | None = None
        self._lock = threading.Lock()  # frames arrive from several threads
        self._file = disk.open(_open_log, path)
        if self._file.failure is not None:
            what = f"frame trace {path} cannot be written: {self._file.failure.strerror}"
            raise BusError(what, advice="check folder and suffix")

    @property
    def failure(self) -> OSError | None:
        """Why the log ends early; None = it is complete so far."""
        if self._file.is_open:
            self._file.disk.pump()
            if (first := self._file.first_failure) is not None:
                self._fail(first.errno, first.strerror)
            elif self._file.disk.gone:
                self._fail(errno.EPIPE, ENDED)
        return self._failure

    def take(self, frame: Any, received: bool) -> None:
        """Append a frame; a tap of the bus."""
        packed = packed_frame(frame, received, frame.timestamp if received else time.time())
        with self._lock:
            self._frames += packed
            self._channel = frame.channel if received else self._channel
            if time.monotonic() - self._handed_s >= PART_S:
                self._hand_on()

    def close(self) -> None:
        """Write the rest and close the file; never raises, `failure` holds an error."""
        with self._lock:
            self._hand_on()
        if self.failure is None and not self._file.close(CLOSING_S, again=False):
            late = f"the disk has not taken the rest within {CLOSING_S:.0f} s"
            self._fail(errno.EAGAIN, ENDED if self._file.disk.gone else late)
        elif (first := self._file.first_failure) is not None:
            self._fail(first.errno, first.strerror)
        if self.dropped:
            self._fail(errno.EAGAIN, f"{self.dropped} frames are missing: the disk was too slow")

    def _hand_on(self) -> None:
        self._handed_s = time.monotonic()
        if self._file.full:
            self.dropped += len(self._frames) // FRAME.size
        else:
            self._file.put(add_packed, bytes(self._frames), self._channel)
        self._frames.clear()

    def _fail(self, number: int | None, text: str | None) -> None:
        """Keep the first failure, with the name of the file, and write no more."""
        if self._failure is None:
            self._failure = OSError(number, f"the frame log is incomplete: {text}", str(self._path))
            self._file.forget()


@contextmanager
def _open_log(path: Path, again: bool) -> Generator[Any]:
    """Open a frame log in the process that writes (a kind of `Disk.open`); one that was cut off is not continued.

    Its folder is made if need be.
    """
    if again:
        raise OSError(errno.EPIPE, ENDED)
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_log(path) as log:
        yield log
