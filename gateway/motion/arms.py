"""Several arms, each on its own bus: enabled, driven with one SYNC per cycle from one clock, and stopped together.

One thread serves all buses. In lockstep it does so in turn, and a run is the same every time. In real time setpoints
are sent on all buses, then all SYNCs at the instant of one clock, then answers are collected; the time between the
SYNCs is measured. Each arm is enabled and stopped in a thread of its own.

All arms stop in the same cycle with the quick stop ramps of their drives if a drive leaves OPERATION ENABLED or stops
responding, or if a bus fails.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np

from drives.drive import DriveCommand
from drives.errors import DriveError, NotStoodDown, StopRequested
from drives.exchange import Pacing
from drives.gate import ArmState
from gateway.data.visit import ArmSample
from gateway.motion.arm import Arm

Result = TypeVar("Result")

#: Real time: lead time of the first common SYNC [s].
_START_S: Final = 0.02
#: In lockstep, time between two SYNCs of an arm that waits for another one [s]: nothing else paces it, and if
#: both are in one simulation, the drives of the other arm would detect a lost heartbeat.
_PAUSE_S: Final = 0.01
#: Number of stored skews for the quantiles.
_KEPT: Final = 100_000


def _each(jobs: Sequence[Callable[[], Result]]) -> tuple[Result, ...]:
    """Run the jobs and return their results; when all have ended, raise the first cause with the others as notes.

    Arms stopped by another arm are not a cause. Failures while stopping of every arm are kept: with one of them the
    state of the arms is not known.
    """
    results: list[Result] = []
    failures: list[BaseException] = []
    for job in jobs:
        try:
            results.append(job())
        except BaseException as error:
            failures.append(error)
    if not failures:
        return tuple(results)
    first_hand = [error for error in failures if not isinstance(error, StopRequested)]
    first_hand.sort(key=lambda error: isinstance(error, NotStoodDown))
    cause = (first_hand or failures)[0]
    for error in failures:
        if error is not cause and isinstance(error, DriveError) and isinstance(cause, DriveError):
            cause.while_stopping += error.while_stopping
    for error in first_hand:
        if error is not cause:
            cause.add_note(f"another arm: {error}")
    raise cause


class Arms:
    """Group of arms driven with one SYNC per cycle from one clock.

    Parameters
    ----------
    arms : sequence of Arm
        Connected and configured, brakes on.
    pacing : "lockstep" or "real"

    Attributes
    ----------
    members : tuple of Arm
    skew_s : deque of float
        Real time: time between the SYNCs of the first and the last arm, per cycle.
    enabled : bool
        All arms follow `exchange`.
    """

    def __init__(self, arms: Sequence[Arm], pacing: Pacing) -> None:
        self.members = tuple(arms)
        self.real = pacing == "real"
        self.skew_s: deque[float] = deque(maxlen=_KEPT)
        # each further arm may be enabling or disabling while each arm is being stopped
        self._pool = ThreadPoolExecutor(2 * len(arms) - 1, thread_name_prefix="arm") if len(arms) > 1 else None
        self._stopping: list[Future[None]] = []
        self._lock = threading.Lock()
        self.enabled = False
        if len(arms) > 1:
            for index, arm in enumerate(self.members):
                arm.drives.on_stop = lambda index=index: self._stop_others(index)

    @property
    def names(self) -> str:
        """Names of all arms, joined with "and"."""
        return " and ".join(f"'{arm.name}'" for arm in self.members)

    def where(self) -> tuple[np.ndarray, ...]:
        """Return the joint positions [rad] of every arm with its brakes on."""
        return tuple(arm.where() for arm in self.members)

    def enable(self, stop_requested: Callable[[], bool]) -> tuple[ArmSample, ...]:
        """Power all drives; an arm that is ready holds its position until all are ready.

        Raises
        ------
        DriveError
            A drive failed or a stop was requested; all arms are disabled again.
        """
        ready, failed = [False] * len(self.members), threading.Event()

        def given_up() -> bool:
            return failed.is_set() or stop_requested()

        def up(index: int) -> ArmSample:
            arm = self.members[index]
            try:
                sample = arm.enable(given_up)
                ready[index] = True
                while not all(ready) and not given_up():
                    held = arm.hold()
                    # setpoints begin at the returned positions: a drive that left one SYNC unanswered has none
                    sample = held if held.complete else sample
                    if not self.real:
                        failed.wait(_PAUSE_S)
            except BaseException:
                failed.set()
                raise
            return sample

        try:
            samples = self._all(up)
        except BaseException:
            self.disable()
            raise
        self.enabled = True
        if self.real and len(self.members) > 1:
            due = time.monotonic() + _START_S
            for arm in self.members:
                arm.drives.align(due)
        return samples

    def exchange(self, commands: Sequence[Sequence[DriveCommand]]) -> tuple[ArmSample, ...]:
        """Exchange one cycle: send targets to every arm, return what every arm measured at this SYNC.

        Raises
        ------
        DriveError
            A drive or a bus failed; all arms have been stopped, or are being stopped by the motion loop.
        """
        return self._cycle(commands)

    def hold(self) -> tuple[ArmSample, ...]:
        """Exchange one cycle with the last targets; raises as `exchange`."""
        return self._cycle([None] * len(self.members))

    def quick_stop(self) -> None:
        """Stop all arms at the same time with the quick stop ramps of their drives.

        Raises
        ------
        DriveError
            The standstill of an axis is not confirmed.
        """
        self.enabled = False
        self._all(lambda index: self.members[index].quick_stop())

    def disable(self) -> None:
        """Apply the brakes and disable the drives of all arms at the same time."""
        self.enabled = False
        self._wait_stopped()
        self._all(lambda index: self.members[index].disable())

    def gate(self) -> ArmState:
        """Read the drives of all arms, as one record."""
        states = self._all(lambda index: self.members[index].drives.gate())
        return ArmState.of({arm.name: state for arm, state in zip(self.members, states, strict=True)})

    def close(self) -> None:
        """Shut down the threads."""
        self._wait_stopped()
        if self._pool is not None:
            self._pool.shutdown()

    # -- inside ------------------------------------------------------------------------------------------------------

    def _cycle(self, commands: Sequence[Sequence[DriveCommand] | None]) -> tuple[ArmSample, ...]:
        """Exchange one cycle; None = the last targets of an arm.

        Real time: each part of the SYNC is executed for all arms before the next part.
        """
        pairs = list(zip(self.members, commands, strict=True))
        try:
            if not self.real or len(pairs) == 1:
                return tuple(arm.hold() if targets is None else arm.exchange(targets) for arm, targets in pairs)
            for arm, targets in pairs:
                arm.drives.begin(targets)
            first, *others = [arm.drives for arm in self.members]
            at_s = first.prepare(None)
            for each in others:
                each.prepare(at_s)
            for arm in self.members:
                arm.drives.sync()
            epochs = [arm.drives.gather() for arm in self.members]
            self.skew_s.append(others[-1].sync_sent_s - first.sync_sent_s)
            checks = zip(self.members, epochs, strict=True)
            return _each([lambda arm=arm, epoch=epoch: arm.checked(epoch) for arm, epoch in checks])
        except BaseException:
            self._abandon()
            self._wait_stopped()
            raise

    def _abandon(self) -> None:
        for arm in self.members:
            arm.drives.abandon()

    def _all(self, action: Callable[[int], Result]) -> tuple[Result, ...]:
        """Call a function for all arms at the same time; the first failure is raised when all calls have ended."""
        if self._pool is None:
            return (action(0),)
        others = [self._pool.submit(action, index) for index in range(1, len(self.members))]
        return _each([lambda: action(0), *(other.result for other in others)])

    def _stop_others(self, index: int) -> None:
        """Stop the other arms at once when one arm is about to stop because of an error."""
        with self._lock:
            if not self.enabled or self._pool is None:
                return
            self.enabled = False
            self._abandon()  # an arm in the middle of a SYNC could not be stopped by another thread
            for other, arm in enumerate(self.members):
                if other != index:
                    self._stopping.append(self._pool.submit(arm.quick_stop))

    def _wait_stopped(self) -> None:
        while self._stopping:
            with contextlib.suppress(Exception):
                self._stopping.pop().result()
