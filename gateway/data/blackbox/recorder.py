"""Black box in the motion loop: collect samples and frames and send them twice a second, without blocking."""

from __future__ import annotations

import threading
import time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drives.child_process import ENDED
from drives.frame_log import packed_frame
from gateway.data.blackbox.part import HEAD, BoxHeader, pack, width_of
from gateway.data.blackbox.ring_buffer import Ring, box_of, open_ring
from gateway.data.disk import Disk

#: Between two parts [s]: half of what a kill may cost.
PART_S: Final = 0.5
#: Number of samples after which a part is sent in any case.
MOST_ROWS: Final = 1024
#: Time limit for writing the box after standstill [s].
CLOSING_S: Final = 60.0


class BoxRecorder:
    """Collects samples and frames and sends them to the process that writes.

    Samples come from one thread, frames from several.

    Parameters
    ----------
    disk : Disk
    header : BoxHeader

    Attributes
    ----------
    left_out : int
        Number of parts dropped because the process did not store them in time.
    """

    def __init__(self, disk: Disk, header: BoxHeader) -> None:
        self.left_out = 0
        self._rows = np.full((MOST_ROWS, width_of(sum(axes for _, axes in header.arms))), np.nan)
        self._taken = self._parts = 0
        self._closed = False
        self._frames = bytearray()
        self._lock = threading.Lock()
        self._box = box_of(header.recording)
        self._file = disk.open(open_ring, self._box, header)
        self._time_s, self._handed_s = 0.0, time.monotonic()

    def row(self, time_s: float, sync_index: int) -> NDArray[np.float64]:
        """Append a sample of NaN and return its axis values, to be filled by the caller."""
        with self._lock:
            if self._taken == MOST_ROWS or time.monotonic() - self._handed_s >= PART_S:
                self._hand_on()
            else:
                self._file.disk.pump()
        row = self._rows[self._taken]
        row[: len(HEAD)] = time.time(), time_s, sync_index
        self._taken += 1
        self._time_s = time_s
        return row[len(HEAD) :]

    def frame(self, message: Any, received: bool) -> None:
        """Append one CAN frame."""
        packed = packed_frame(message, received, time.time())
        with self._lock:
            if self._closed:  # from a thread that was about to pass it on
                return
            self._frames += packed
            if not self._taken and time.monotonic() - self._handed_s >= PART_S:
                self._hand_on()  # no rows come: the arm is not under power yet, or no more

    def close(self, reason: str | None) -> str:
        """Write the black box, or delete the stored data if `reason` is None; not to be called in the motion loop.

        Returns
        -------
        str
            Error text; empty if none.
        """
        with self._lock:
            self._closed = True
            if self._taken or self._frames:
                self._hand_on()
        file = self._file
        file.put(Ring.finish, reason)
        done = file.settle(CLOSING_S)
        failure = file.failure
        if done:
            file.close()
            return "" if failure is None else f"{self._box}: cannot be written: {failure.strerror}"
        if file.disk.gone:
            return f"{self._box}: {ENDED}; the next run writes it"
        return f"{self._box}: the black box is not complete after {CLOSING_S:g} s; writing continues in the background"

    def _hand_on(self) -> None:
        """Send the collected part to the process; drop it if too much waits for the disk."""
        self._handed_s = time.monotonic()
        self._parts += 1
        if self._file.full:
            self.left_out += 1
        else:
            part = pack(self._rows[: self._taken], self._frames, self._time_s, time.time())
            self._file.put(Ring.add, self._parts, part)
        self._rows[: self._taken] = np.nan
        self._taken = 0
        self._frames = bytearray()
