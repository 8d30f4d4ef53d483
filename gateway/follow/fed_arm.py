"""An arm with velocity and torque offsets beside every target, and the record of the motion.

A target that goes out with SYNC n is reached one period later: the drive moves evenly from the target before to this
one. The offsets are those of the middle of that segment: mean position, difference quotient as velocity. The
acceleration is the change of velocity from the segment before to the segment after.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from drives.cia402 import State, decode_state
from drives.drive import DriveCommand
from gateway.data.sample import ArmSample
from gateway.errors import LimitExceeded
from gateway.feedforward.law import FeedforwardLaw
from gateway.feedforward.ramp import Ramp
from gateway.follow.track import Recorder
from gateway.motion.arm import Arm

Six = list[float]
NOTHING = [0.0] * 6


class FedRow(list[DriveCommand]):
    """Targets of one SYNC with the motion they belong to: position, velocity and acceleration between two targets."""

    __slots__ = ("q_rad", "state")

    def __init__(self, motor_rad: Six, q_rad: np.ndarray, state: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        super().__init__(map(DriveCommand, motor_rad))
        self.q_rad = q_rad
        self.state = state


class FedArm(Arm):
    """An arm with feedforward.

    Parameters
    ----------
    arm : Arm
        Whose drives were set up with feedforward.
    period_s : float
        SYNC period.
    ramp_s : float
        Time in which the offsets are eased in or out.

    Attributes
    ----------
    ramp : Ramp
    recorder : Recorder or None
        Takes every SYNC while it is set.
    """

    def __init__(self, arm: Arm, period_s: float, ramp_s: float) -> None:
        super().__init__(arm.name, arm.drives, arm.axes, arm.known)
        self.ramp = Ramp(period_s, ramp_s)
        self.recorder: Recorder | None = None
        self._law: FeedforwardLaw | None = None
        self._period_s = period_s
        self._enabled = False
        self._last = np.zeros(6)
        self._rate = np.zeros(6)
        self._sense = list(NOTHING)

    def use(self, law: FeedforwardLaw | None) -> None:
        """Take another law; only while no offset is given, so before the arm is moved to where it is to be fed."""
        if self.ramp.gain:
            raise ValueError("the offsets must be eased out before another law is used")
        self._law = law

    def enable(self, stop_requested: Callable[[], bool] = lambda: False) -> ArmSample:
        """Power the drives; no offset is given yet."""
        sample = super().enable(stop_requested)
        self._last, self._rate = sample.q_rad, np.zeros(6)
        self._see(sample)
        return sample

    def disable(self) -> None:
        """Brakes on, power off; the drives' frames carry no offset from now on."""
        self._enabled = False
        super().disable()

    def quick_stop(self) -> None:
        """Stop by the drives' own ramp, without offsets from the first frame."""
        self.ramp.cut("the arm was stopped")
        super().quick_stop()

    def command(
        self, q_rad: np.ndarray, ahead_rad: np.ndarray | None = None, offset_nm: np.ndarray | None = None
    ) -> FedRow:
        """Targets (6,) with their motion, from the target that went out last to this one, and on to the one ahead.

        Raises
        ------
        ValueError
            An offset beside the feedforward.
        """
        if offset_nm is not None:
            raise ValueError("an arm that is fed forward takes no other offset")
        rate = (q_rad - self._last) / self._period_s
        after = np.zeros(6) if ahead_rad is None else (ahead_rad - q_rad) / self._period_s
        state = (0.5 * (self._last + q_rad), rate, (after - self._rate) / (2.0 * self._period_s))
        return FedRow(self.axes.motor_position(q_rad).tolist(), q_rad, state)

    def exchange(self, commands: Sequence[DriveCommand]) -> ArmSample:
        """One SYNC with targets of `commands` and their offsets.

        Raises
        ------
        LimitExceeded
            A torque offset beyond its limit: no frame was sent, and no offset is given any more.
        """
        if not isinstance(commands, FedRow):
            return self._see(super().exchange(commands))
        before, self._last = self._last, commands.q_rad
        fed = self._fed(commands, before)
        self._rate = commands.state[1]
        sample = self._see(super().exchange(fed))
        if self.recorder is not None:
            self.recorder.add(before, sample)
        return sample

    def hold(self) -> ArmSample:
        """One SYNC at the last target; gravity goes on being carried."""
        still = np.zeros(6)
        motor = self.axes.motor_position(self._last).tolist()
        return self.exchange(FedRow(motor, self._last, (self._last, still, still)))

    def _fed(self, row: FedRow, before: np.ndarray) -> Sequence[DriveCommand]:
        gain = self.ramp.step(enabled=self._enabled)
        begun = time.perf_counter()
        if self._law is not None:
            self._sense = self._law.sense(self._sense, (self._last - before).tolist())
        if self._law is None or gain == 0.0:
            if self.recorder is not None:
                self.recorder.fed(NOTHING, NOTHING, 0.0)
            return row
        mean, rate, change = row.state
        velocity, torque = self._law.offsets(mean.tolist(), rate.tolist(), change.tolist(), self._sense)
        velocity = [gain * value for value in velocity]
        torque = [gain * value for value in torque]
        excess = self._law.excess(torque)
        took_s = time.perf_counter() - begun
        if excess is not None:
            self.ramp.cut("a torque offset has reached its limit")
            axis, value = excess
            raise LimitExceeded(
                f"arm '{self.name}', axis {axis + 1}: the feedforward asks for {value:.2f} Nm at the motor, its "
                f"limit is {self._law.limits_nm[axis]:.2f} Nm: stopped, offsets zero; check load and torque_limit_nm",
                joint=axis + 1,
            )
        if self.recorder is not None:
            self.recorder.fed(velocity, torque, took_s)
        return [
            DriveCommand(target.position_rad, nm, rad_s)
            for target, nm, rad_s in zip(row, torque, velocity, strict=True)
        ]

    def _see(self, sample: ArmSample) -> ArmSample:
        """Note whether the drives are in OPERATION ENABLED; one that did not answer was seen before."""
        states = [decode_state(reading.statusword) for reading in sample.readings if reading is not None]
        self._enabled = all(state is State.OPERATION_ENABLED for state in states)
        return sample
