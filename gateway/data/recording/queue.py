"""Queue between the motion loop and the process that writes the recording, so that the loop never waits for a disk."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from drives.child_process import ADVICE, ENDED
from gateway.data.disk import Disk
from gateway.data.period import Measured, Period
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import (
    UNFINISHED,
    ArmHeader,
    Numbering,
    RecordingHeader,
    RecordingWriter,
    Write,
    open_recording,
    write_recording,
)
from gateway.data.visit import Visit
from gateway.errors import InputError

#: Number of unwritten visits at which the motion loop must stop.
CAPACITY = 8
#: Polling interval while only the disk is awaited [s].
PAUSE_S = 0.001


class VisitQueue:
    """Accepts visits and periods in the motion loop and sends them to the process that writes; for one thread.

    The file is opened here, before the drives are enabled, and closed by `close`. If the master is killed, the
    process first writes what it has received.

    Parameters
    ----------
    disk : Disk
    path : Path
    header : RecordingHeader
    arm : ArmHeader
    earlier : Recording or None
        The file's content so far, to go on with; None = the file must not exist.
    patient : bool
        Wait for the disk after each visit: in lockstep, where no time passes on the bus.
    capacity : int
        Number of unwritten visits at which the loop must stop.
    write : callable, optional
        Replaces the file by the content; called in the process (pickled).

    Attributes
    ----------
    visits : int
        Number accepted so far.
    failed : InputError or None
        First write error: the loop must stop. The visits are kept and included in every later write.

    Raises
    ------
    InputError
        The file exists, was made with another cell, is written by another run, or cannot be written; the process does
        not start.
    """

    def __init__(
        self,
        disk: Disk,
        path: Path,
        header: RecordingHeader,
        arm: ArmHeader,
        earlier: Recording | None,
        patient: bool = False,
        capacity: int = CAPACITY,
        write: Write = write_recording,
    ) -> None:
        self.path = path
        self.visits = 0
        self.failed: InputError | None = None
        self._arm, self._patient, self._capacity = arm.name, patient, capacity
        self._numbering = Numbering(earlier)
        self._waiting: dict[int, Visit | Period] = {}
        self._file = disk.open(open_recording, path, header, arm, earlier, write)
        if self._file.failure is not None:
            raise self._error(self._file.failure)

    @property
    def waiting(self) -> int:
        """Number of visits not yet confirmed as written."""
        return sum(number > self._file.confirmed for number in self._waiting)

    def add(self, arm: str, visit: Measured) -> Measured:
        """Queue a visit or a period; does not block, unless it is patient.

        Returns
        -------
        Visit or Period
            With its number; its time runs on from the visits before.

        Raises
        ------
        InputError
            Twice the capacity is not yet written.
        """
        if self.waiting >= 2 * self._capacity:
            raise InputError(
                f"{self.path}: {self.waiting} visits are not yet written, the queue is full; record on a faster disk"
            )
        stored = self._numbering.next(visit)
        self._waiting[self._file.put(RecordingWriter.store, arm, stored)] = stored
        self.visits += 1
        while self._patient and self.waiting and self._check() is None:
            time.sleep(PAUSE_S)
        return stored

    def written(self) -> tuple[Visit | Period, ...]:
        """Return the visits and periods written since the last call, in order; does not block."""
        self._check()
        numbers = [number for number in self._waiting if number <= self._file.confirmed]
        return tuple(self._waiting.pop(number) for number in numbers)

    def trouble(self) -> InputError | None:
        """Return the reason if the disk cannot be written or is too slow."""
        if self._check() is None and self.waiting >= self._capacity:
            return InputError(
                f"{self.path}: {self.waiting} visits wait for the disk, which is too slow; no visit is lost; free the"
                " disk or record to another disk, then continue with --resume"
            )
        return self.failed

    def flush(self) -> None:
        """Block until everything is on disk."""
        if self.visits:
            self.finish("abort", UNFINISHED, {})

    def finish(self, status: str, reason: str, statistics: dict[str, Any]) -> None:
        """Store the result of the run (`success`, `abort`, `fail`) and wait until all is on disk; not for the motion
        loop. A process that has ended is started again.

        The visits written meanwhile are returned by the next call of `written`.

        Raises
        ------
        InputError
            Not everything could be written; the file on disk is consistent.
        """
        self._file.put(RecordingWriter.finish, self._arm, status, reason, statistics)
        if not self._file.settle():
            raise self._ended()
        if self._file.failure is not None:
            raise self._error(self._file.failure)

    def close(self) -> None:
        """Wait until all queued visits are on disk and close the file; not to be called in the motion loop."""
        self._file.close(again=False)

    def _check(self) -> InputError | None:
        """Take the answers of the process; return the first error, `failed`."""
        self._file.disk.pump()
        if self.failed is None and self._file.first_failure is not None:
            self.failed = self._error(self._file.first_failure)
        elif self.failed is None and self._file.disk.gone and self.waiting:
            self.failed = self._ended()
        return self.failed

    def _error(self, failure: OSError) -> InputError:
        text = failure.strerror or str(failure)
        return InputError(text if text.startswith(str(self.path)) else f"{self.path}: cannot be written: {text}")

    def _ended(self) -> InputError:
        return InputError(f"{self.path}: {ENDED}; {self.waiting} visits were not yet written; {ADVICE}")
