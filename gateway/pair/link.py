"""Two arms under two SYNCs from one clock: brought up together, moved together, stopped together.

In lockstep one thread serves both buses in turn, and the run is the same every time. By the clock each bus has a thread
of its own, both keep one rhythm, and the time between the two SYNCs is measured.

When a drive of one arm leaves OPERATION ENABLED, falls silent or its bus fails, the other arm is told in the same cycle
and both stop at the same time by the quick stop ramp of their drives.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drives.drive import DriveCommand
from gateway.motion.arm import ArmSample
from gateway.motion.opening import BusOverride, OpenArm, open_arm
from gateway.pair.cell import PairCell
from gateway.pair.gap import instruments_on
from gateway.pair.transform import Floats

#: Until the first common SYNC by the clock [s].
START_S = 0.02


class PairLink:
    """Both arms, connected and configured.

    Parameters
    ----------
    arms : master and slave
    pacing : "lockstep" or "real"

    Attributes
    ----------
    skew_s : time between the two SYNCs of each cycle by the clock, slave after master
    stopped_by : index of the arm whose error stopped both, None while none did
    """

    def __init__(self, arms: tuple[OpenArm, OpenArm], pacing: str) -> None:
        self.arms = arms
        self.skew_s: list[float] = []
        self.stopped_by: int | None = None
        self._real = pacing == "real"
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="pair")
        self._stopping: list[Future[None]] = []
        self._stop_lock = threading.Lock()
        self._enabled = False
        for index, opened in enumerate(arms):
            opened.group.on_stop = lambda index=index: self._stop_other(index)

    # -- up and down -------------------------------------------------------------------------------------------------

    def enable(self) -> tuple[ArmSample, ArmSample]:
        """Power all drives; the arm that is ready first holds its position until the other is.

        Raises
        ------
        DriveError
            What failed; both arms are disabled again.
        """
        ready, failed = [False, False], threading.Event()

        def up(index: int) -> ArmSample:
            arm = self.arms[index].arm
            try:
                sample = arm.enable()
                ready[index] = True
                while not all(ready) and not failed.is_set():
                    sample = arm.hold()
            except BaseException:
                failed.set()
                raise
            return sample

        try:
            samples = self._both(up)
        except BaseException:
            self.disable()
            raise
        self._enabled = True
        if self._real:
            due = time.monotonic() + START_S
            for opened in self.arms:
                opened.group.align(due)
        return samples

    def where(self) -> tuple[Floats, Floats]:
        """Joint positions of both arms in their brakes [rad]."""
        first, second = (opened.arm.where() for opened in self.arms)
        return first, second

    def exchange(
        self, q_rad: tuple[Floats, Floats], offset_nm: tuple[Floats, Floats] | None = None
    ) -> tuple[ArmSample, ArmSample]:
        """One cycle: joint targets (6,) to both arms, what both measured at this SYNC.

        Parameters
        ----------
        q_rad : two arrays of shape (6,)
        offset_nm : two arrays of shape (6,), optional
            Joint torque that the drives add to their own.

        Raises
        ------
        DriveError
            A drive or a bus failed; both arms have been stopped.
        """
        commands = [opened.arm.commands(q[None])[0] for opened, q in zip(self.arms, q_rad, strict=True)]
        if offset_nm is not None:
            given = zip(self.arms, commands, offset_nm, strict=True)
            commands = [_with_offset(opened, plain, nm) for opened, plain, nm in given]
        try:
            if self._real:
                samples = self._both(lambda index: self.arms[index].arm.exchange(commands[index]))
                first, second = (opened.group.sync_sent_s for opened in self.arms)
                self.skew_s.append(second - first)
            else:
                first, second = self.arms
                samples = (first.arm.exchange(commands[0]), second.arm.exchange(commands[1]))
        except BaseException:
            self._wait_stopped()
            raise
        return samples

    def quick_stop(self) -> None:
        """Both arms by the quick stop ramp of their drives, at the same time.

        Raises
        ------
        DriveError
            An axis of which it is not known that it stands.
        """
        self._enabled = False
        self._both(lambda index: self.arms[index].arm.quick_stop())

    def disable(self) -> None:
        """Brakes on, power off, both arms at the same time."""
        self._enabled = False
        self._wait_stopped()
        self._both(lambda index: self.arms[index].arm.disable())

    def close(self) -> None:
        """End the threads."""
        self._wait_stopped()
        self._pool.shutdown()

    # -- inside ------------------------------------------------------------------------------------------------------

    def _both(self, action: Callable[[int], Any]) -> tuple[Any, Any]:
        """Do something with both arms at the same time; the first failure is raised when both have ended."""
        second = self._pool.submit(action, 1)
        failure: BaseException | None = None
        first = result = None
        try:
            first = action(0)
        except BaseException as error:
            failure = error
        try:
            result = second.result()
        except BaseException as error:
            if failure is None:
                raise
            failure.add_note(f"other arm: {error}")
        if failure is not None:
            raise failure
        return first, result

    def _stop_other(self, index: int) -> None:
        """An arm is about to stop because of an error: the other one stops now as well, not when this one stands."""
        with self._stop_lock:
            if not self._enabled:
                return
            self._enabled = False
            self.stopped_by = index
            other = self.arms[1 - index]
            self._stopping.append(self._pool.submit(other.arm.quick_stop))

    def _wait_stopped(self) -> None:
        while self._stopping:
            with contextlib.suppress(Exception):
                self._stopping.pop().result()

    def statistics(self) -> dict[str, Any]:
        """Cycles, incomplete epochs, lateness and skew so far."""
        skew = np.array(self.skew_s) if self.skew_s else np.zeros(1)
        groups = [opened.group.statistics for opened in self.arms]
        return {
            "pacing": "real" if self._real else "lockstep",
            "cycles": [group.cycles for group in groups],
            "incomplete": [group.incomplete for group in groups],
            "late": [group.late for group in groups],
            "skew_s": {
                "median": float(np.median(skew)),
                "p99": float(np.percentile(np.abs(skew), 99)),
                "max": float(np.abs(skew).max()),
            }
            if self._real
            else None,
        }


def _with_offset(opened: OpenArm, commands: list[DriveCommand], joint_nm: Floats) -> list[DriveCommand]:
    offsets = opened.arm.axes.motor_torque(joint_nm).tolist()
    return [replace(command, torque_offset_nm=nm) for command, nm in zip(commands, offsets, strict=True)]


@contextmanager
def open_link(cell: PairCell, ledgers: tuple[Path | None, Path | None] = (None, None)) -> Iterator[PairLink]:
    """Connect and configure both arms; on leaving all drives are disabled and both buses closed.

    Raises
    ------
    ConfigError, DriveError
        As `open_arm`.
    """
    with ExitStack() as opened:
        arms = []
        for arm, spec, ledger in zip(cell.arms, cell.specs, ledgers, strict=True):
            beside = instruments_on(arm.config.bus, cell.config)
            override = BusOverride(spec=spec, ledger=ledger, instruments=beside)
            arms.append(opened.enter_context(open_arm(cell.loaded, override, arm.config.name)))
        link = PairLink((arms[0], arms[1]), cell.pacing)
        opened.callback(link.close)
        yield link
