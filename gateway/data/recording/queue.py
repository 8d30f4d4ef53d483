"""Queue between the motion loop and the process that writes the recording: the loop never waits for a disk."""

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

#: Visits that may wait for the disk before the loop is to stop.
CAPACITY = 8
#: Until the process that writes must be there.
START_TIMEOUT_S = 60.0
#: Between two words about what is still to be written.
TELL_S = 0.5

ADVICE = "look in the system's log whether it ran out of memory"


def _silent(waiting: int) -> None:
    del waiting


class VisitQueue:
    """Takes visits and periods in the motion loop and has them written by a process of its own; for one thread.

    The process is started here, before there is power, and ended by `close`. It outlives a master that is killed until
    it has written what it was given.

    Parameters
    ----------
    path : Path
    header : RecordingHeader
    arm : ArmHeader
    earlier : Recording or None
        The file's content so far, to go on with; None = the file must not exist.
    capacity : int
        Visits that may wait for the disk before the loop is to stop.
    write : callable, optional
        Puts the content in the place of the file, in the process that writes (it is pickled).

    Attributes
    ----------
    visits : int
        Taken in so far.
    failed : InputError or None
        The first write that went wrong: the loop is to stop. The visits are held and are part of every later write.

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
        """Visits that are not on disk yet, as far as is known here."""
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """Whether the loop is to stop: so many visits are not on disk yet."""
        return len(self._waiting) >= self._capacity

    def add(self, arm: str, visit: Measured) -> Measured:
        """Take a visit or a period in; never waits.

        Returns
        -------
        Visit or Period
            With its number; its time runs on from the visits before.

        Raises
        ------
        InputError
            Twice the capacity is waiting.
        """
        if len(self._waiting) >= 2 * self._capacity:
            raise InputError(
                f"{self.path}: {len(self._waiting)} visits wait for the disk and no more are taken; record on a faster "
                "disk"
            )
        stored = self._numbering.next(visit)
        frame = framed(Keep(arm, stored))
        self._waiting[stored.number] = (stored, frame)
        self._process.send(frame)
        self.visits += 1
        return stored

    def written(self) -> tuple[Visit | Period, ...]:
        """Visits and periods that have reached the disk since the last call, in their order; never waits."""
        self._listen()
        visits, self._written = tuple(self._written), []
        return visits

    def finish(
        self,
        arm: str,
        status: str,
        reason: str,
        statistics: dict[str, Any],
        tell: Callable[[int], None] = _silent,
    ) -> None:
        """Store how the run ended (`success`, `abort`, `fail`) and wait until everything is on disk; not in the loop.

        What was waiting is returned by `written` afterwards.

        Parameters
        ----------
        tell : callable, optional
            Called with the number of visits that are still to be written, every half second.

        Raises
        ------
        InputError
            Not everything could be written; what is on disk is whole.
        """
        if self._process.gone:
            self._again()
        answer = self._asked(Finish(0, arm, status, reason, statistics), tell)
        if answer is None:
            self._again()
            answer = self._asked(Finish(0, arm, status, reason, statistics), tell)
        if answer is None:
            raise self._ended()
        if answer.failed:
            raise InputError(answer.failed)

    def close(self) -> None:
        """Have everything that is waiting written, and end the process; not in the loop."""
        while self._process.unsent:
            self._process.wait(TELL_S)
            self._listen()
        self._process.hang_up()
        while not self._process.gone:
            self._process.wait(TELL_S)
            self._listen()
        self._process.end()

    def _asked(self, finish: Finish, tell: Callable[[int], None]) -> Finished | None:
        """Its answer; None if it has ended."""
        self._questions += 1
        self._process.send(framed(replace(finish, question=self._questions)))
        told_s = time.monotonic()
        while not self._process.gone and (self._answer is None or self._answer.question != self._questions):
            self._process.wait(TELL_S)
            self._listen()
            if time.monotonic() - told_s >= TELL_S:
                told_s = time.monotonic()
                tell(self.waiting)
        answer, self._answer = self._answer, None
        return answer if answer is not None and answer.question == self._questions else None

    def _started(self, start: Start) -> WriterProcess:
        process = WriterProcess(PROGRAM)
        try:
            process.send(framed(start))
            until_s = time.monotonic() + START_TIMEOUT_S
            while not process.gone and time.monotonic() < until_s:
                process.wait(TELL_S)
                for message in process.receive():
                    if isinstance(message, Ready) and message.refused:
                        raise InputError(message.refused)
                    return process
            raise InputError(f"{self.path}: the process that is to write it does not start; {ADVICE}")
        except BaseException:
            process.kill()
            raise

    def _again(self) -> None:
        """Start the process anew, with what it took with it: it was killed."""
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
            f"{self.path}: the process that writes it has ended before its time; {self.waiting} visits were not on "
            f"disk yet; {ADVICE}"
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
