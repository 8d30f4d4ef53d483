"""Queue between the motion loop and the process that writes the recording, so that the loop never waits for a disk."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from gateway.data.period import Measured, Period
from gateway.data.piping import WriterProcess, framed
from gateway.data.recording.pipe import PROGRAM, Failed, Finish, Finished, Keep, Ready, Start, Written
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import ArmHeader, Numbering, RecordingHeader, Write, write_recording
from gateway.data.visit import Visit
from gateway.errors import InputError

#: Number of unwritten visits at which the motion loop must stop.
CAPACITY = 8
#: Time limit for the start of the writer process.
START_TIMEOUT_S = 60.0
#: Between two words about what is still to be written.
NOTIFY_S = 0.5

ADVICE = "check the system log for lack of memory"


def _silent(waiting: int) -> None:
    del waiting


class VisitQueue:
    """Accepts visits and periods in the motion loop and sends them to a writer process; for one thread.

    The process is started here, before the drives are enabled, and ended by `close`. If the master is killed, the
    process first writes what it has received.

    Parameters
    ----------
    path : Path
    header : RecordingHeader
    arm : ArmHeader
    earlier : Recording or None
        The file's content so far, to go on with; None = the file must not exist.
    capacity : int
        Number of unwritten visits at which the loop must stop.
    write : callable, optional
        Replaces the file by the content; called in the writer process (pickled).

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
        path: Path,
        header: RecordingHeader,
        arm: ArmHeader,
        earlier: Recording | None,
        capacity: int = CAPACITY,
        write: Write = write_recording,
    ) -> None:
        self.path = path
        self.visits = 0
        self.failed: InputError | None = None
        self._start = Start(path, header, arm, earlier, write)
        self._capacity = capacity
        self._numbering = Numbering(earlier)
        self._waiting: dict[int, tuple[Visit | Period, bytes]] = {}
        self._written: list[Visit | Period] = []
        self._questions = 0
        self._answer: Finished | None = None
        self._process = self._started(self._start)

    @property
    def waiting(self) -> int:
        """Number of visits not yet confirmed as written."""
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """Return whether the loop must stop because too many visits are not yet written."""
        return len(self._waiting) >= self._capacity

    def add(self, arm: str, visit: Measured) -> Measured:
        """Queue a visit or a period; does not block.

        Returns
        -------
        Visit or Period
            With its number; its time runs on from the visits before.

        Raises
        ------
        InputError
            Twice the capacity is not yet written.
        """
        if len(self._waiting) >= 2 * self._capacity:
            raise InputError(
                f"{self.path}: {len(self._waiting)} visits are not yet written, the queue is full; record on a "
                "faster disk"
            )
        stored = self._numbering.next(visit)
        frame = framed(Keep(arm, stored))
        self._waiting[stored.number] = (stored, frame)
        self._process.send(frame)
        self.visits += 1
        return stored

    def written(self) -> tuple[Visit | Period, ...]:
        """Return the visits and periods written since the last call, in order; does not block."""
        self._listen()
        visits, self._written = tuple(self._written), []
        return visits

    def finish(
        self,
        arm: str,
        status: str,
        reason: str,
        statistics: dict[str, Any],
        notify: Callable[[int], None] = _silent,
    ) -> None:
        """Store the result of the run (`success`, `abort`, `fail`) and wait until all is on disk; not for the motion
        loop.

        The visits written meanwhile are returned by the next call of `written`.

        Parameters
        ----------
        notify : callable, optional
            Called every half second with the number of visits not yet written.

        Raises
        ------
        InputError
            Not everything could be written; the file on disk is consistent.
        """
        if self._process.gone:
            self._again()
        answer = self._asked(Finish(0, arm, status, reason, statistics), notify)
        if answer is None:
            self._again()
            answer = self._asked(Finish(0, arm, status, reason, statistics), notify)
        if answer is None:
            raise self._ended()
        if answer.failed:
            raise InputError(answer.failed)

    def close(self) -> None:
        """Write all queued visits and end the process; not to be called in the motion loop."""
        while self._process.unsent:
            self._process.wait(NOTIFY_S)
            self._listen()
        self._process.close_pipe()
        while not self._process.gone:
            self._process.wait(NOTIFY_S)
            self._listen()
        self._process.end()

    def _asked(self, finish: Finish, notify: Callable[[int], None]) -> Finished | None:
        """Return the answer of the process; None if it has ended."""
        self._questions += 1
        self._process.send(framed(replace(finish, question=self._questions)))
        reported_s = time.monotonic()
        while not self._process.gone and (self._answer is None or self._answer.question != self._questions):
            self._process.wait(NOTIFY_S)
            self._listen()
            if time.monotonic() - reported_s >= NOTIFY_S:
                reported_s = time.monotonic()
                notify(self.waiting)
        answer, self._answer = self._answer, None
        return answer if answer is not None and answer.question == self._questions else None

    def _started(self, start: Start) -> WriterProcess:
        process = WriterProcess(PROGRAM)
        try:
            process.send(framed(start))
            until_s = time.monotonic() + START_TIMEOUT_S
            while not process.gone and time.monotonic() < until_s:
                process.wait(NOTIFY_S)
                for message in process.receive():
                    if isinstance(message, Ready) and message.refused:
                        raise InputError(message.refused)
                    return process
            raise InputError(f"{self.path}: the process that writes the recording does not start; {ADVICE}")
        except BaseException:
            process.kill()
            raise

    def _again(self) -> None:
        """Restart the killed process with the visits that it had not written."""
        self._process.end()
        earlier = read(self.path) if self.path.exists() else None
        there = (
            set() if earlier is None else {each.number for arm in earlier.arms for each in (*arm.visits, *arm.periods)}
        )
        for number in there.intersection(self._waiting):
            self._written.append(self._waiting.pop(number)[0])
        self._process = self._started(replace(self._start, earlier=earlier))
        for _, frame in self._waiting.values():
            self._process.send(frame)

    def _ended(self) -> InputError:
        return InputError(
            f"{self.path}: the process that writes it ended early; {self.waiting} visits were not yet written; {ADVICE}"
        )

    def _listen(self) -> None:
        for message in self._process.receive():
            if isinstance(message, Written):
                for number in [number for number in self._waiting if number <= message.number]:
                    self._written.append(self._waiting.pop(number)[0])
            elif isinstance(message, Failed):
                self.failed = self.failed or InputError(message.reason)
            elif isinstance(message, Finished):
                self._answer = message
        if self._process.gone and self._waiting and self.failed is None:
            self.failed = self._ended()
