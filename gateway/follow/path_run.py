"""Drive a path with each setting, one after the other; the brakes are on afterwards, also after an error.

Arm with velocity and torque offsets added to every target, and the record of the motion.

A target sent with SYNC n is reached one period later: the drive moves uniformly from the previous target to this one.
The offsets are those of the middle of that segment: mean position, difference quotient as velocity. The acceleration is
the change of velocity from the previous segment to the next one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from drives.cia402 import State, decode_state
from drives.drive import DriveCommand
from drives.errors import DriveError
from drives.exchange import Pacing
from gateway.acquire.plan import travel_limits
from gateway.acquire.route import path_to
from gateway.data.visit import ArmSample
from gateway.errors import LimitExceeded
from gateway.feedforward.law import FeedforwardLaw
from gateway.feedforward.ramp import Ramp
from gateway.follow.path import FollowPath, check_path
from gateway.follow.settings import Setting
from gateway.follow.track import Recorder, Track
from gateway.motion.arm import Arm
from gateway.motion.arms import Arms
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions, Stream
from gateway.motion.trajectory import straight
from gateway.motion.workspace import Workspace, refuse_start

Six = list[float]
NOTHING = [0.0] * 6
#: Duration of the ramps of the offsets, at rest [s].
RAMP_S = 0.8
#: Factor by which the ramp down is faster after a requested stop: the brakes wait for it.
STOPPED_QUICKER = 2.0
#: Rest with the offsets on [s]: the integral parts of the drives' controllers adapt.
SETTLE_S = 1.0
#: Recorded rest after the path [s].
REST_S = 0.3
#: Length of the last segment to the start [rad], from above it on every joint where that is allowed. It is equal for
#: all settings and with the offsets on: friction and the drives' integral parts have the state of a motion.
LEAD_RAD = 0.06


class FedRow(list[DriveCommand]):
    """Targets of one SYNC with their motion: position, velocity and acceleration between two targets."""

    __slots__ = ("q_rad", "state")

    def __init__(self, motor_rad: Six, q_rad: np.ndarray, state: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        super().__init__(map(DriveCommand, motor_rad))
        self.q_rad = q_rad
        self.state = state


class FedArm(Arm):
    """Arm with feedforward offsets.

    Parameters
    ----------
    arm : Arm
        Arm whose drives are configured for feedforward.
    period_s : float
        SYNC period.
    ramp_s : float
        Duration of the ramp of the offsets.

    Attributes
    ----------
    ramp : Ramp
    recorder : Recorder or None
        Records every SYNC while it is set.
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
        """Use another feedforward law; only while all offsets are zero."""
        if self.ramp.gain:
            raise ValueError("the offsets must be ramped down before another law is used")
        self._law = law

    def enable(self, stop_requested: Callable[[], bool] = lambda: False) -> ArmSample:
        """Power the drives with zero offsets."""
        sample = super().enable(stop_requested)
        self._last, self._rate = sample.q_rad, np.zeros(6)
        self._see(sample)
        return sample

    def disable(self) -> None:
        """Apply the brakes and disable the drives; offsets are zero from now on."""
        self._enabled = False
        super().disable()

    def quick_stop(self) -> None:
        """Stop with the quick stop ramps of the drives, with zero offsets from the first frame."""
        self.ramp.cut("the arm was stopped")
        super().quick_stop()

    def command(
        self, q_rad: np.ndarray, ahead_rad: np.ndarray | None = None, offset_nm: np.ndarray | None = None
    ) -> FedRow:
        """Return the targets (6,) with their motion, from the last sent target over this one to the next.

        Raises
        ------
        ValueError
            Another offset is requested in addition to the feedforward.
        """
        if offset_nm is not None:
            raise ValueError("an arm with feedforward accepts no other torque offset")
        rate = (q_rad - self._last) / self._period_s
        after = np.zeros(6) if ahead_rad is None else (ahead_rad - q_rad) / self._period_s
        state = (0.5 * (self._last + q_rad), rate, (after - self._rate) / (2.0 * self._period_s))
        return FedRow(self.axes.motor_position(q_rad).tolist(), q_rad, state)

    def exchange(self, commands: Sequence[DriveCommand]) -> ArmSample:
        """Exchange one SYNC with targets of `commands` and their offsets.

        Raises
        ------
        LimitExceeded
            A torque offset exceeds its limit: no frame was sent, and the offsets are switched off.
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
        """Exchange one SYNC with the last target; gravity remains compensated."""
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
                f"arm '{self.name}', axis {axis + 1}: the feedforward requires {value:.2f} Nm at the motor, its "
                f"limit is {self._law.limits_nm[axis]:.2f} Nm; check load and torque_limit_nm",
                joint=axis + 1,
            )
        if self.recorder is not None:
            self.recorder.fed(velocity, torque, took_s)
        return [
            DriveCommand(target.position_rad, nm, rad_s)
            for target, nm, rad_s in zip(row, torque, velocity, strict=True)
        ]

    def _see(self, sample: ArmSample) -> ArmSample:
        """Note whether the drives are in OPERATION ENABLED; a missing answer leaves the last known state."""
        states = [decode_state(reading.statusword) for reading in sample.readings if reading is not None]
        self._enabled = all(state is State.OPERATION_ENABLED for state in states)
        return sample


#: Called with the present step and the completed share of the run.
Progress = Callable[[str, float], None]


def follow(
    arm: Arm,
    workspace: Workspace,
    path: FollowPath,
    settings: Sequence[Setting],
    progress: Progress,
    options: MoveOptions | None = None,
    pacing: Pacing = "lockstep",
) -> tuple[Track, ...]:
    """Drive one pass of the path per setting; after return or an error, the brakes are on and the offsets are zero.

    Parameters
    ----------
    arm : Arm
        Connected, configured with feedforward, not enabled.
    workspace : Workspace
    path : FollowPath
    settings : sequence of Setting
    progress : Progress
    options : MoveOptions, optional
    pacing : "lockstep" or "real"

    Raises
    ------
    PlanRefused
        The path leaves the workspace, or no checked path leads to its start; no drive was enabled.
    LimitExceeded
        A limit was exceeded, or an offset reached its limit; the arm was stopped.
    DriveError
        Bus or drive failed; the arm was stopped.
    KeyboardInterrupt
        A stop was requested; the arm was stopped.
    """
    check_path(path, workspace)
    above_rad = path.start_rad + LEAD_RAD
    lead = above_rad if workspace.path_clear(above_rad[None], path.start_rad[None])[0] else path.start_rad
    start_rad = arm.where()
    refuse_start(workspace, start_rad, arm.name)
    transfers = [path_to(workspace, begin, lead) for begin in (start_rad, path.end_rad)]
    fed, limits, tracks = FedArm(arm, path.period_s, RAMP_S), travel_limits(workspace), list[Track]()
    name, done_s = "", 0.0

    def report(what: str, row: int, _rows: int) -> None:
        progress(f"{name}: {what}" if name else what, done_s + max(row, 0) * path.period_s)

    stream = Stream(Arms((fed,), pacing), (workspace,), path.period_s, options, report)

    def move(point_rad: np.ndarray) -> None:
        stream.move([straight(stream.q_rad[0], point_rad, limits, path.period_s)], "to the start of the path")

    def ease(change: Callable[[], None]) -> None:
        change()
        row = 0
        while not fed.ramp.resting:
            stream.hold("ease the offsets", row, 1)
            row += 1

    try:
        with powered(stream):
            # the drives carry the torque of the brakes before anything moves
            stream.take_over()
            try:
                for number, setting in enumerate(settings):
                    name, done_s = setting.name, number * path.duration_s
                    fed.use(setting.law)
                    for point_rad in transfers[min(number, 1)]:
                        move(point_rad)
                    stream.stand(REST_S, "rest")
                    ease(fed.ramp.rise)
                    stream.stand(SETTLE_S, "settle")
                    move(path.start_rad)
                    stream.stand(SETTLE_S, "settle")
                    fed.recorder = recorder = Recorder(setting.name, path.period_s)
                    for motion in path.motions:
                        stream.move([motion], "follow the path")
                        stream.stand(path.dwell_s, "rest")
                        done_s += motion.duration_s + path.dwell_s
                    stream.stand(REST_S, "rest")
                    fed.recorder = None
                    ease(fed.ramp.fall)
                    tracks.append(recorder.track())
            except BaseException as failure:
                _ease_out(stream, fed, failure)
                raise
    finally:
        fed.ramp.cut("the run has ended")
    return tuple(tracks)


def _ease_out(stream: Stream, fed: FedArm, failure: BaseException) -> None:
    """Report the state of the offsets at a stop; ramp them down if the arm came to rest along its path."""
    ramp = fed.ramp
    fed.recorder = None
    if not ramp.gain:
        return
    when = "during the ramp of the offsets" if not ramp.resting else "with the offsets on"
    failure.add_note(f"stopped {when} (at {100 * ramp.gain:.0f} %): they were brought to zero")
    if isinstance(failure, Exception) or stream.moving or stream.urgent:
        return
    try:
        ramp.fall(STOPPED_QUICKER)
        while not ramp.resting:
            fed.hold()
    except DriveError as error:
        failure.add_note(f"while ramping the offsets down: {error}")
