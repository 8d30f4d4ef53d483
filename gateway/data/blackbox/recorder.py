"""Black box in the motion loop: collect samples and frames and send them twice a second, without blocking."""

from __future__ import annotations

import threading
import time
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from gateway.data.blackbox.messages import BoxEnd, BoxReady, BoxVerdict
from gateway.data.blackbox.part import ERROR, EXTENDED, FRAME, HEAD, RECEIVED, REMOTE, BoxHeader, pack, width_of
from gateway.data.blackbox.ring_buffer import box_of
from gateway.data.piping import WriterProcess, framed

PROGRAM: Final = "gateway.data.blackbox.recorder_process"
#: Between two parts [s]: half of what a kill may cost.
PART_S: Final = 0.5
#: Number of samples after which a part is sent in any case.
MOST_ROWS: Final = 1024
#: Limit of the data queued for a process that does not read; further parts are dropped.
MOST_BYTES: Final = 64_000_000
#: Time limit for writing the box after standstill [s].
CLOSING_S: Final = 60.0
#: Time limit for the start of the process [s].
STARTING_S: Final = 60.0

Answer = TypeVar("Answer", BoxReady, BoxEnd)


class BoxRecorder:
    """Collects samples and frames and sends them to a separate process that stores them; for one thread.

    Parameters
    ----------
    header : BoxHeader

    Attributes
    ----------
    left_out : int
        Number of parts dropped because the process did not read them in time.
    """

    def __init__(self, header: BoxHeader) -> None:
        self.left_out = 0
        self._box = box_of(header.recording)
        self._rows = np.full((MOST_ROWS, width_of(sum(axes for _, axes in header.arms))), np.nan)
        self._taken = 0
        self._closed = False
        self._frames = bytearray()
        self._said: list[Any] = []
        self._time_s, self._handed_s = 0.0, time.monotonic()
        self._lock = threading.Lock()  # frames arrive from several threads
        self._process = WriterProcess(PROGRAM)
        self._process.send(framed(header))

    def wait_until_kept(self) -> None:
        """Wait until the process stores parts, or has ended; not to be called in the motion loop."""
        self._received(BoxReady, STARTING_S)

    def row(self, time_s: float, sync_index: int) -> NDArray[np.float64]:
        """Append a sample of NaN and return its axis values, to be filled by the caller."""
        with self._lock:
            if self._taken == MOST_ROWS or time.monotonic() - self._handed_s >= PART_S:
                self._hand_on()
            elif self._process.unsent:
                self._process.send(b"")
        row = self._rows[self._taken]
        row[: len(HEAD)] = time.time(), time_s, sync_index
        self._taken += 1
        self._time_s = time_s
        return row[len(HEAD) :]

    def frame(self, message: Any, received: bool) -> None:
        """Append one CAN frame."""
        flags = RECEIVED * received + EXTENDED * message.is_extended_id
        flags += REMOTE * message.is_remote_frame + ERROR * message.is_error_frame
        data = bytes(message.data)
        packed = FRAME.pack(time.time(), message.arbitration_id, flags, min(len(data), 8), data[:8])
        with self._lock:
            if self._closed:  # from a thread that was about to tell of it
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
            self._process.send(framed(BoxVerdict(reason)))
        answer = self._received(BoxEnd, CLOSING_S)
        if answer is not None:
            self._process.end()
            return answer.failed
        if self._process.gone:
            self._process.end()
            return f"{self._box}: the process that writes the black box ended early; the next run writes it"
        self._process.leave()
        return f"{self._box}: the black box is not complete after {CLOSING_S:g} s; writing continues in the background"

    def _received(self, kind: type[Answer], limit_s: float) -> Answer | None:
        """Return the next answer of a type; None if the process has ended or does not answer in time."""
        until_s = time.monotonic() + limit_s
        while time.monotonic() < until_s:
            self._said += self._process.receive()
            while self._said:
                word = self._said.pop(0)
                if isinstance(word, kind):
                    return word
                if isinstance(word, BoxEnd):
                    self._said.append(word)
                    return None
            if self._process.gone:
                return None
            self._process.wait(0.1)
        return None

    def _hand_on(self) -> None:
        """Send the collected part to the process; drop it if the queue is full."""
        self._handed_s = time.monotonic()
        if self._process.unsent_bytes < MOST_BYTES:
            part = pack(self._rows[: self._taken], self._frames, self._time_s, time.time())
            self._process.send(framed(part))
        else:
            self.left_out += 1
        self._rows[: self._taken] = np.nan
        self._taken = 0
        self._frames = bytearray()
