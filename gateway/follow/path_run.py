"""Drive a path with each setting, one after the other; the brakes are on afterwards, also after an error."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager

import numpy as np

from drives.errors import DriveError
from drives.exchange import Pacing
from gateway.acquire.plan import travel_limits
from gateway.acquire.route import path_to
from gateway.acquire.start_posture import refuse_start
from gateway.follow.fed_arm import FedArm
from gateway.follow.path import FollowPath, check_path
from gateway.follow.settings import Setting
from gateway.follow.track import Recorder, Track
from gateway.motion.arm import Arm
from gateway.motion.arms import Arms
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions, Stream
from gateway.motion.trajectory import straight
from gateway.motion.workspace import Workspace

#: Duration of the ramps of the offsets, at rest [s].
RAMP_S = 0.8
#: Factor by which the ramp down is faster after a requested stop: the brakes wait for it.
STOPPED_QUICKER = 2.0
#: Rest with the offsets on [s]: the integral parts of the drives' controllers adapt.
SETTLE_S = 1.0
#: Recorded rest after the path [s].
REST_S = 0.3
#: Length of the last segment to the start [rad], equal for all settings and with the offsets on: friction and the
#: drives' integral parts then have the state of a motion, not of the ramp of the offsets.
LEAD_RAD = 0.06

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
    lead = _lead(workspace, path.start_rad)
    start_rad = arm.where()
    refuse_start(workspace, start_rad, arm.name)
    transfers = [path_to(workspace, begin, lead) for begin in (start_rad, path.end_rad)]
    run = _Run(arm, workspace, path, progress, options, pacing)
    with run.under_power():
        return tuple(run.drive(setting, transfers[min(number, 1)], number) for number, setting in enumerate(settings))


def _lead(workspace: Workspace, start_rad: np.ndarray) -> np.ndarray:
    """Return the start of the last short segment to the path's start: above it on every joint if allowed."""
    above = start_rad + LEAD_RAD
    return above if workspace.path_clear(above[None], start_rad[None])[0] else start_rad


class _Run:
    """Run with one enabled arm, and its progress."""

    def __init__(
        self,
        arm: Arm,
        workspace: Workspace,
        path: FollowPath,
        progress: Progress,
        options: MoveOptions | None,
        pacing: Pacing,
    ) -> None:
        self._path = path
        self._report_progress = progress
        self._arm = FedArm(arm, path.period_s, RAMP_S)
        self._limits = travel_limits(workspace)
        self._pass = ("", 0.0)
        self._stream = Stream(Arms((self._arm,), pacing), (workspace,), path.period_s, options, self._progress)

    def _progress(self, what: str, row: int, _rows: int) -> None:
        name, done_s = self._pass
        self._report_progress(f"{name}: {what}" if name else what, done_s + max(row, 0) * self._path.period_s)

    @contextmanager
    def under_power(self) -> Generator[None]:
        """Enable the arm and hold until the drives carry the torque of the brakes; offsets are zero on exit."""
        try:
            with powered(self._stream):
                self._stream.take_over()
                try:
                    yield
                except BaseException as failure:
                    self._ease_out(failure)
                    raise
        finally:
            self._arm.ramp.cut("the run has ended")

    def _ease_out(self, failure: BaseException) -> None:
        """Report the state of the offsets at a stop; ramp them down if the arm came to rest along its path."""
        ramp = self._arm.ramp
        self._arm.recorder = None
        if not ramp.gain:
            return
        when = "during the ramp of the offsets" if not ramp.resting else "with the offsets on"
        failure.add_note(f"stopped {when} (at {100 * ramp.gain:.0f} %): they were brought to zero")
        if isinstance(failure, Exception) or self._stream.moving or self._stream.urgent:
            return
        try:
            ramp.fall(STOPPED_QUICKER)
            while not ramp.resting:
                self._arm.hold()
        except DriveError as error:
            failure.add_note(f"while ramping the offsets down: {error}")

    def drive(self, setting: Setting, points: Sequence[np.ndarray], number: int) -> Track:
        """Drive one pass: move near the start, ramp the offsets up, move to the start, follow the path, ramp down."""
        begun_s = number * self._path.duration_s
        self._pass = (setting.name, begun_s)
        self._arm.use(setting.law)
        for point in points:
            self._move(point)
        self._stream.stand(REST_S, "rest")
        self._ease(self._arm.ramp.rise)
        self._stream.stand(SETTLE_S, "settle")
        self._move(self._path.start_rad)
        self._stream.stand(SETTLE_S, "settle")
        self._arm.recorder = recorder = Recorder(setting.name, self._path.period_s)
        for motion in self._path.motions:
            self._stream.move([motion], "follow the path")
            self._stream.stand(self._path.dwell_s, "rest")
            begun_s += motion.duration_s + self._path.dwell_s
            self._pass = (setting.name, begun_s)
        self._stream.stand(REST_S, "rest")
        self._arm.recorder = None
        self._ease(self._arm.ramp.fall)
        return recorder.track()

    def _move(self, point: np.ndarray) -> None:
        motion = straight(self._stream.q_rad[0], point, self._limits, self._path.period_s)
        self._stream.move([motion], "to the start of the path")

    def _ease(self, change: Callable[[], None]) -> None:
        change()
        row = 0
        while not self._arm.ramp.resting:
            self._stream.hold("ease the offsets", row, 1)
            row += 1
