"""Drive a path under each setting, one after the other, and leave the arm in its brakes whatever happens."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drives.errors import DriveError
from gateway.acquire.plan import travel_limits
from gateway.acquire.poses import RestPose
from gateway.acquire.route import find_route
from gateway.errors import LimitExceeded, PlanRefused
from gateway.follow.fed_arm import FedArm
from gateway.follow.path import FollowPath, check_path
from gateway.follow.settings import Setting
from gateway.follow.track import Recorder, Track
from gateway.motion.arm import Arm
from gateway.motion.contact import TAKE_OVER_S
from gateway.motion.stream import Stream
from gateway.motion.trajectory import straight
from gateway.motion.watch import Watch
from gateway.motion.workspace import Workspace

#: Time in which the offsets are eased in and out, at rest.
RAMP_S = 0.8
#: Rest with the offsets on: the drives' integral parts give back what the offsets now carry.
SETTLE_S = 1.0
#: Rest after the path, still recorded.
REST_S = 0.3
#: The start is reached along the same short way under every setting, with the offsets on: friction and the drives'
#: integral parts are then where a motion leaves them, not where easing the offsets in has pushed them.
LEAD_RAD = 0.06
PROGRESS_S = 0.25

#: Called with what is done and the share of the whole that is done.
Tell = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class FollowStation:
    """What a run works with.

    Attributes
    ----------
    arm : Arm
        Connected, set up with feedforward, not enabled.
    workspace : Workspace
    stop_asked : callable
        Asked at every SYNC; true stops the arm.
    tell : Tell
    """

    arm: Arm
    workspace: Workspace
    stop_asked: Callable[[], bool]
    tell: Tell


def follow(station: FollowStation, path: FollowPath, settings: Sequence[Setting]) -> tuple[Track, ...]:
    """One pass of the path per setting; on return, and after any error, the brakes are on and the offsets zero.

    Raises
    ------
    PlanRefused
        The path leaves the workspace, or no checked way leads to its start; nothing was enabled.
    LimitExceeded
        A limit was left, or an offset reached its limit; the arm was stopped.
    DriveError
        Bus or drive failed; the arm was stopped.
    KeyboardInterrupt
        A stop was asked for; the arm was stopped.
    """
    check_path(path, station.workspace)
    lead = _lead(station.workspace, path.start_rad)
    ways = [way(station.workspace, station.arm.where(), lead), way(station.workspace, path.end_rad, lead)]
    run = _Run(station, path)
    failure: BaseException | None = None
    try:
        run.start()
        return tuple(run.drive(setting, ways[min(number, 1)], number) for number, setting in enumerate(settings))
    except BaseException as error:
        failure = error
        raise
    finally:
        run.make_safe(failure)


def way(workspace: Workspace, start_rad: np.ndarray, end_rad: np.ndarray) -> list[np.ndarray]:
    """Points of a checked way, the end included.

    Raises
    ------
    PlanRefused
        The arm stands where it may not stand, or no such way was found.
    """
    reason = workspace.why_not(start_rad)
    if reason is not None:
        raise PlanRefused(f"the arm stands at {_angles(start_rad)}: {reason}; move it clear with the drives' own tool")
    route = find_route(workspace, [RestPose(1, tuple(end_rad.tolist()), "fit")], start_rad, 0.0)
    if not route.legs:
        raise PlanRefused(
            f"no way that keeps the limits leads from {_angles(start_rad)} to the start of the path at "
            f"{_angles(end_rad)}; move the arm elsewhere or open the keep_out boxes"
        )
    return [*(np.array(point) for point in route.legs[0].via_rad), end_rad]


def _lead(workspace: Workspace, start_rad: np.ndarray) -> np.ndarray:
    """Where the last short way to the start begins: above it on every joint where that is allowed, else the start."""
    above = start_rad + LEAD_RAD
    return above if workspace.path_clear(above[None], start_rad[None])[0] else start_rad


def _angles(q_rad: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.3f}" for value in q_rad) + "] rad"


class _Run:
    """One enabled arm and where it is in the job."""

    def __init__(self, station: FollowStation, path: FollowPath) -> None:
        period_s = path.period_s
        self._path = path
        self._workspace = station.workspace
        self._tell = station.tell
        self._arm = FedArm(station.arm, period_s, RAMP_S)
        watch = Watch(station.arm.name, station.workspace, period_s)
        every = max(1, round(PROGRESS_S / period_s))
        self._stream = Stream(self._arm, watch, station.stop_asked, self._progress, every)
        self._limits = travel_limits(station.workspace)
        self._pass = ("", 0.0)

    def _progress(self, what: str, row: int, rows: int) -> None:
        name, done_s = self._pass
        self._tell(f"{name}: {what}" if name else what, done_s + row * self._path.period_s)
        del rows

    def start(self) -> None:
        """Enable, and stand until the drives carry what the brakes carried."""
        self._stream.start(self._arm.enable().q_rad)
        self._hold(TAKE_OVER_S, "open the brakes")

    def drive(self, setting: Setting, points: Sequence[np.ndarray], number: int) -> Track:
        """One pass: near the start without offsets, ease in, to the start, path, ease out."""
        begun_s = number * self._path.duration_s
        self._pass = (setting.name, begun_s)
        self._arm.use(setting.law)
        for point in points:
            self._move(point)
        self._hold(REST_S, "rest")
        self._ease(self._arm.ramp.rise)
        self._hold(SETTLE_S, "settle")
        self._move(self._path.start_rad)
        self._hold(SETTLE_S, "settle")
        self._arm.recorder = recorder = Recorder(setting.name, self._path.period_s)
        for motion in self._path.motions:
            self._stream.move(motion, "follow the path")
            self._hold(self._path.dwell_s, "rest")
            begun_s += motion.duration_s + self._path.dwell_s
            self._pass = (setting.name, begun_s)
        self._hold(REST_S, "rest")
        self._arm.recorder = None
        self._ease(self._arm.ramp.fall)
        return recorder.track()

    def _move(self, point: np.ndarray) -> None:
        motion = straight(self._stream.q_rad, point, self._limits, self._path.period_s)
        self._stream.move(motion, "to the start of the path")

    def _hold(self, seconds: float, what: str) -> None:
        rows = int(np.ceil(seconds / self._path.period_s - 1e-9))
        for row in range(rows):
            self._stream.hold(what, row, rows)

    def _ease(self, change: Callable[[], None]) -> None:
        change()
        row = 0
        while not self._arm.ramp.resting:
            self._stream.hold("ease the offsets", row, 1)
            row += 1

    def make_safe(self, failure: BaseException | None) -> None:
        """Stop, offsets to zero, brakes on, whatever the stop does; an error on the way joins the one under way."""
        gain = self._arm.ramp.gain
        if failure is not None and gain:
            when = "while the offsets were being eased" if not self._arm.ramp.resting else "with the offsets on"
            failure.add_note(f"stopped {when} (at {100 * gain:.0f} %): they were brought to zero")
        stop = self._arm.quick_stop if isinstance(failure, DriveError | LimitExceeded) else self._stop_softly
        try:
            _attempt(stop, failure)
        finally:
            self._arm.ramp.cut("the run has ended")
            _attempt(self._arm.disable, failure)

    def _stop_softly(self) -> None:
        """Jerk-limited stop with the offsets on, then ease them out; by the drives' own ramp where that fails."""
        self._arm.recorder = None
        try:
            self._stream.stop_softly(self._limits, self._path.period_s)
            self._arm.ramp.fall()
            while not self._arm.ramp.resting:
                self._arm.hold()
        except BaseException:
            self._arm.quick_stop()
            raise


def _attempt(action: Callable[[], None], failure: BaseException | None) -> None:
    try:
        action()
    except Exception as error:
        if failure is None:
            raise
        failure.add_note(f"while stopping: {error}")
