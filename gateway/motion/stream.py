"""Set points to the drives, one per SYNC, each answer watched; knows where the arm was last told to be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gateway.motion.arm import Arm, ArmSample
from gateway.motion.trajectory import Motion, MotionLimits, stop
from gateway.motion.watch import Watch

#: Called with what is done, the row and the number of rows, now and then.
Report = Callable[[str, int, int], None]


class Stream:
    """Motion and rest of one enabled arm.

    Parameters
    ----------
    arm : Arm
    watch : Watch
    stop_asked : callable
        Asked at every SYNC; true ends the motion by KeyboardInterrupt.
    report : Report
    report_every : int
        SYNCs between two reports.

    Attributes
    ----------
    q_rad : array of shape (6,)
        Last set point.
    moving : bool
    sync_index : int
        Of the last answer.
    """

    def __init__(
        self, arm: Arm, watch: Watch, stop_asked: Callable[[], bool], report: Report, report_every: int
    ) -> None:
        self.q_rad = np.zeros(6)
        self.moving = False
        self.sync_index = 0
        self._rates = (np.zeros(6), np.zeros(6))
        self._modelled_nm = np.zeros(6)
        self._arm = arm
        self._watch = watch
        self._stop_asked = stop_asked
        self._report = report
        self._report_every = report_every

    def start(self, q_rad: np.ndarray) -> None:
        """Take over an arm that holds joint positions (6,) [rad]."""
        self.q_rad = q_rad
        self._modelled_nm = self._watch.modelled_torque(q_rad[None])[0]

    def move(self, motion: Motion, what: str) -> None:
        """Stream a motion that starts at the last set point and ends at rest.

        Raises
        ------
        LimitExceeded
            The watch has seen a limit left.
        DriveError
            Bus or drive failed.
        KeyboardInterrupt
            A stop was asked for.
        """
        exchange, check, stop_asked = self._arm.exchange, self._watch.check, self._stop_asked
        commands = self._arm.commands(motion.q_rad)
        modelled = self._watch.modelled_torque(motion.q_rad)
        self.moving = bool(commands)
        for row, command in enumerate(commands):
            if row % self._report_every == 0:
                self._report(what, row, len(commands))
            sample = exchange(command)
            self.sync_index = sample.sync_index
            self.q_rad = motion.q_rad[row]
            self._rates = (motion.qd_rad_s[row], motion.qdd_rad_s2[row])
            self._modelled_nm = modelled[row]
            check(sample, self.q_rad, self._modelled_nm)
            if stop_asked():
                raise KeyboardInterrupt
        self.moving = False

    def hold(self, what: str, row: int, rows: int) -> ArmSample:
        """One SYNC of the standing arm; raises as `move`."""
        if row % self._report_every == 0:
            self._report(what, row, rows)
        sample = self._arm.hold()
        self.sync_index = sample.sync_index
        self._watch.check(sample, self.q_rad, self._modelled_nm)
        if self._stop_asked():
            raise KeyboardInterrupt
        return sample

    def stop_softly(self, limits: MotionLimits, period_s: float) -> None:
        """Jerk-limited stop from the last set point; the arm that stands is left alone.

        Raises
        ------
        PlanRefused
            No stop fits the limits.
        DriveError
            Bus or drive failed.
        """
        if not self.moving:
            return
        self.moving = False
        speed, acceleration = self._rates
        for command in self._arm.commands(stop((self.q_rad, speed, acceleration), limits, period_s).q_rad):
            self._arm.exchange(command)
