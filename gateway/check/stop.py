"""Test on the machine that the drives stop on loss of the master: a slow motion without heartbeat.

The motion loop sends the setpoints of the test as those of any other motion. A stop request, a limit and contact are
handled at every SYNC; a test that was stopped raises the error of the stop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from drives.cia402 import State, decode_state
from drives.errors import DriveError
from drives.objects import OBJECTS
from drives.proof import StopTest, StopTrace
from gateway.acquire.plan import travel_limits
from gateway.data.visit import ArmSample
from gateway.errors import PlanRefused
from gateway.motion.arms import Arms
from gateway.motion.opening import OpenArm
from gateway.motion.power import powered
from gateway.motion.setpoints import MotionSetpoints
from gateway.motion.stream import MoveOptions, Stream
from gateway.motion.trajectory import Motion, straight
from gateway.motion.workspace import Workspace, inside_from, widened
from gateway.result.result import Finding

#: Speed of every joint while the heartbeat is withheld [rad/s], and its largest travel [rad].
SPEED_RAD_S: Final = 0.05
TRAVEL_RAD: Final = 0.1
#: Ratio of the duration of the motion to the longest heartbeat time.
BEYOND_S: Final = 0.5
#: Largest travel [rad, joint] after a drive has left OPERATION ENABLED.
COAST_RAD: Final = 0.05
#: A drive that is commanded to stop by its ramp is at rest within this time at the speed of the proof [s].
QUICK_STOP_S: Final = 0.5
#: Share of the heartbeat time before which a stop must have another cause.
EARLY: Final = 0.4
#: Error codes caused by the loss of the heartbeat (CiA 301, table 26: 0x81xx communication).
COMMUNICATION_CLASS: Final = 0x81


@dataclass(frozen=True, slots=True)
class StopProof:
    """Reaction of the drives of an arm to the loss of their master.

    Attributes
    ----------
    arm : str
    traces : tuple of StopTrace, one per axis
    moved_rad, coast_rad : tuples of floats, one per axis
        Joint angle from the last heartbeat to rest, and from the last SYNC in OPERATION ENABLED to rest.
    items : tuple of Finding
    quick_stop : tuple of StopTrace
        Reaction of the drives to a quick stop; empty if not tested.
    override : float
        Speed override at which it was made.
    """

    arm: str
    traces: tuple[StopTrace, ...]
    moved_rad: tuple[float, ...]
    coast_rad: tuple[float, ...]
    items: tuple[Finding, ...]
    quick_stop: tuple[StopTrace, ...] = ()
    override: float = 1.0

    @property
    def passed(self) -> bool:
        """Return True if every drive stopped as stated."""
        return not any(item.severity == "fail" for item in self.items)

    def as_json(self) -> dict[str, Any]:
        """Return the proof as plain values."""
        drives = [
            {each.name: getattr(trace, each.name) for each in fields(trace) if each.name != "samples"}
            | {"state": str(trace.state), "moved_joint_rad": moved, "coast_joint_rad": coast}
            for trace, moved, coast in zip(self.traces, self.moved_rad, self.coast_rad, strict=True)
        ]
        return {"arm": self.arm, "drives": drives}


def slow_motion(
    arm: str, workspace: Workspace, start_rad: np.ndarray, consumer_s: float, period_s: float, override: float = 1.0
) -> Motion:
    """Return a slow motion of all joints that lasts longer than the heartbeat time, inside all limits.

    A joint outside its range moves towards it.

    Parameters
    ----------
    arm : str
        Name, for messages.
    workspace : Workspace
    start_rad : array of shape (N,)
        Present posture.
    consumer_s : float
        Longest heartbeat time of the drives.
    period_s : float
        SYNC period.
    override : float
        Speed override.

    Raises
    ------
    PlanRefused
        The arm is in a posture that is not allowed, or has no free space around it.
    """
    if inside_from(workspace, start_rad, arm) is not None:
        workspace = widened(workspace, start_rad)
    lasts_s = consumer_s + 2.0 * BEYOND_S
    speed = override * min(SPEED_RAD_S, TRAVEL_RAD / lasts_s, float(workspace.speed_rad_s.min()))
    for scale in (1.0, 0.5):
        for signs in _directions(workspace, start_rad):
            target = start_rad + scale * speed * lasts_s * signs
            if workspace.path_clear(start_rad[None], target[None])[0]:
                return straight(start_rad, target, travel_limits(workspace, scale * speed), period_s)
    raise PlanRefused(
        f"arm '{arm}' has no free space for {speed * lasts_s:.2f} rad on every joint in its present posture; "
        "move it to a free posture with the drive's own tool, away from limits and obstacles: the stop of its drives"
        " must be tested before anything else moves"
    )


def _directions(workspace: Workspace, start_rad: np.ndarray) -> Iterator[np.ndarray]:
    """Return the signs to try: away from the nearer limit, back, then others."""
    inward = np.where(start_rad > (workspace.lower_rad + workspace.upper_rad) / 2, -1.0, 1.0)
    yield inward
    yield -inward
    axes = workspace.robot.axes
    flips = np.random.default_rng(0).permutation(2**axes - 2) + 1
    for flip in flips:
        yield np.where(flip >> np.arange(axes) & 1, -inward, inward)


def prove_stop(
    opened: OpenArm,
    options: MoveOptions | None = None,
    lost: Callable[[tuple[StopTrace, ...]], None] = lambda _traces: None,
) -> StopProof:
    """Move slowly, withhold the heartbeat and monitor every drive; repeat with a quick stop; then move back.

    Faults are reset as by `without_heartbeat`. If a drive did not stop as stated, nothing moves any more. An arm that
    was outside its joint range does not move back there.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, brakes on.
    options : MoveOptions, optional
    lost : callable
        Takes the traces of the loss of the heartbeat, before the quick stop.

    Raises
    ------
    PlanRefused
        No free motion is possible.
    LimitExceeded, DriveError, KeyboardInterrupt
        The arm was stopped.
    """
    options = options or MoveOptions()
    start_rad = opened.arm.where()
    traces, speed_rad_s, left = without_heartbeat(opened, options)
    lost(traces)
    proof = replace(_judge(opened, traces, speed_rad_s, left), override=options.override)
    if not proof.passed:
        return proof
    test, _ = _stopped_slowly(opened, options, opened.group.try_quick_stop, goes_on=False)
    stopped = test.traces()
    proof = replace(proof, items=(*proof.items, *_quick_stop_items(opened, stopped)), quick_stop=stopped)
    if opened.workspace.path_into_range(start_rad) is None:
        go_slowly(opened, options, start_rad)
    return proof


class _SlowMotion(MotionSetpoints):
    """Slow motion during which a test begins once the arm has reached its speed.

    Parameters
    ----------
    opened : OpenArm
    stream : Stream
        Under power.
    motion : Motion
    begin : callable
        Starts the test.
    goes_on : bool
        True if the setpoints continue to the end of the motion; else they end at the start of the test.
    """

    def __init__(
        self, opened: OpenArm, stream: Stream, motion: Motion, begin: Callable[[], StopTest], goes_on: bool
    ) -> None:
        speed = np.abs(motion.qd_rad_s).max(axis=1)
        #: Sample index at the start of the test, and largest speed.
        self._steady = int(np.argmax(speed >= 0.99 * speed.max()))
        self.speed_rad_s = float(speed.max())
        rows = len(motion) if goes_on else self._steady + 1
        sent = {name: getattr(motion, name)[:rows] for name in ("q_rad", "qd_rad_s", "qdd_rad_s2")}
        super().__init__(stream.q_rad, [replace(motion, **sent)])
        #: True where a drive (row) turns a joint (column).
        self._turns = np.array([opened.arm.axes.joint_bound(motor) > 0.0 for motor in np.eye(len(opened.config.axis))])
        self._stream, self._begin = stream, begin
        self.test: StopTest | None = None

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """Start the test at full speed only; an arm that is being stopped does not start it."""
        if self.test is None and rate == 1.0 and at >= self._steady:
            self.test = self._begin()
        self.excuse()

    def excuse(self) -> None:
        """Stop comparing the joints of drives that stop as intended with their setpoints."""
        test = self.test
        if test is not None:
            stops = [test.held_count(axis) is not None for axis in range(len(self._turns))]
            self._stream.excuse(0, np.asarray(self._turns[stops].any(axis=0)))


def without_heartbeat(opened: OpenArm, options: MoveOptions) -> tuple[tuple[StopTrace, ...], float, dict[int, str]]:
    """Move slowly, withhold the heartbeat and monitor every drive; return traces, speed [rad/s] and remaining faults.

    A communication fault of a drive that was enabled when the heartbeat was withheld is reset, also after a test that
    was interrupted. A fault from before, one that comes too early for a lost heartbeat, and any other fault remain; in
    an interrupted test they are notes of its error.
    """
    tests: list[StopTest] = []

    def begin() -> StopTest:
        tests.append(opened.group.withhold_heartbeat())
        return tests[0]

    try:
        test, speed_rad_s = _stopped_slowly(opened, options, begin, goes_on=True)
    except BaseException as error:
        if tests:
            for node, what in _reset_provoked(opened, tests[0].traces()).items():
                error.add_note(f"node {node}: {what}")
        raise
    return test.traces(), speed_rad_s, _reset_provoked(opened, test.traces())


def _stopped_slowly(
    opened: OpenArm, options: MoveOptions, begin: Callable[[], StopTest], *, goes_on: bool
) -> tuple[StopTest, float]:
    """Move slowly, start a test and continue until it has ended; return the test and the speed [rad/s]."""
    consumer_s = max(profile.heartbeat.consumer_ms for profile in opened.profiles) / 1000.0
    motion = slow_motion(
        opened.arm.name,
        opened.workspace,
        opened.arm.where(),
        consumer_s,
        opened.group.timing.period_s,
        options.override,
    )
    with powered(planned_stream(opened, options)) as stream:
        stream.take_over()
        slow = _SlowMotion(opened, stream, motion, begin, goes_on)
        stream.drive(slow, "move slowly")
        test = slow.test
        if test is None:
            raise PlanRefused(f"arm '{opened.arm.name}' did not reach its speed: repeat the test of the stop")
        while not test.done:
            stream.hold("monitor the stop of the drives", 0, 1)
            slow.excuse()
    return test, slow.speed_rad_s


def go_slowly(opened: OpenArm, options: MoveOptions, target_rad: np.ndarray) -> None:
    """Move the arm to joint positions (N,) [rad] at the speed of the test, on the straight path if it is clear.

    Raises
    ------
    PlanRefused
        The straight path is not clear.
    """
    begin, workspace = opened.arm.where(), opened.workspace
    if not workspace.path_clear(begin[None], target_rad[None])[0]:
        raise PlanRefused(f"arm '{opened.arm.name}' does not move back: no straight path back is inside the limits")
    with powered(planned_stream(opened, options)) as stream:
        stream.take_over()
        limits = travel_limits(workspace, options.override * SPEED_RAD_S)
        stream.move([straight(stream.q_rad[0], target_rad, limits, opened.group.timing.period_s)], "go back")


def _quick_stop_items(opened: OpenArm, traces: tuple[StopTrace, ...]) -> list[Finding]:
    """Return how each drive has stopped by a quick stop, one line per axis."""
    items = []
    coast = opened.arm.axes.joint_bound(np.array([trace.coast_rad for trace in traces]))
    for joint, (trace, coast_rad) in enumerate(zip(traces, coast.tolist(), strict=True), start=1):
        where = f"J{joint} node {trace.node_id}:{OBJECTS['quick_stop_deceleration']}"
        rest_ms = 1000.0 * trace.rest_s
        seen = f"quick stop: at rest after {rest_ms:.0f} ms and {coast_rad:.4f} rad"
        if not trace.stood:
            advice = "check quick stop option 0x605A, ramp 0x6085 and the brake"
            items.append(Finding("fail", where, "quick stop: it did not come to rest", advice))
        elif trace.rest_s > QUICK_STOP_S or coast_rad > COAST_RAD:
            advice = f"{1000 * QUICK_STOP_S:.0f} ms and {COAST_RAD} rad are allowed: make ramp 0x6085 steeper"
            items.append(Finding("fail", where, seen, advice))
        else:
            items.append(Finding("ok", where, seen))
    return items


def planned_stream(opened: OpenArm, options: MoveOptions) -> Stream:
    """Return the stream of a motion that is planned at the speed override: nothing slows it further."""
    timing, planned = opened.group.timing, replace(options, override=1.0, first_done=None)
    return Stream(Arms((opened.arm,), timing.pacing), (opened.workspace,), timing.period_s, planned)


def _reset_provoked(opened: OpenArm, traces: tuple[StopTrace, ...]) -> dict[int, str]:
    """Reset the faults that the withheld heartbeat explains; return the remaining faults by node."""
    left: dict[int, str] = {}
    for drive, trace in zip(opened.group.drives, traces, strict=True):
        try:
            if decode_state(drive.statusword()) is not State.FAULT:
                continue
            code = drive.access.read(OBJECTS["error_code"])
            if code >> 8 != COMMUNICATION_CLASS or _is_early(trace):
                left[drive.node_id] = f"stays in FAULT, error code 0x{code:04X}, which no lost heartbeat explains"
                continue
            drive.reset_fault()
        except DriveError as error:
            left[drive.node_id] = str(error)
    return left


def _is_early(trace: StopTrace) -> bool:
    """Return whether a drive stopped too early for a lost heartbeat."""
    return trace.left_s is not None and trace.left_s < EARLY * trace.stated_s


def _judge(opened: OpenArm, traces: tuple[StopTrace, ...], speed_rad_s: float, left: dict[int, str]) -> StopProof:
    moved, coast = (
        opened.arm.axes.joint_bound(np.array([getattr(trace, name) for trace in traces])).tolist()
        for name in ("moved_rad", "coast_rad")
    )
    what = f"heartbeat withheld at {speed_rad_s:.3f} rad/s on every joint"
    items = [Finding("info", f"arm {opened.config.name}", what)]
    axes = zip(opened.profiles, traces, moved, coast, strict=True)
    for joint, (profile, trace, moved_rad, coast_rad) in enumerate(axes, start=1):
        where = f"J{joint} node {trace.node_id}"
        watched = OBJECTS[profile.loss_objects[0]]
        items.append(_judged(f"{where}:{watched}", trace, moved_rad, coast_rad))
        if trace.node_id in left:
            advice = "find and remove the cause, then reset it at the drive"
            items.append(Finding("fail", where, left[trace.node_id], advice))
    return StopProof(opened.config.name, traces, tuple(moved), tuple(coast), tuple(items))


def _judged(where: str, trace: StopTrace, moved_rad: float, coast_rad: float) -> Finding:
    """Return how a drive has reacted to the loss of the master."""
    stated = f"{1000 * trace.stated_s:.0f} ms are stated"
    seen = f"left OPERATION ENABLED after {1000 * (trace.left_s or 0.0):.0f} ms ({stated})"
    path = f"{moved_rad:.4f} rad from the last heartbeat to rest, {coast_rad:.4f} rad of them after it had left"
    if trace.left_s is None:
        what = f"continued to move without the master's heartbeat; {stated}; the master stopped it"
        advice = (
            "the drive ignores the loss of the master: do not move this arm; check 0x1016 (or 0x100C and 0x100D) and"
            " 0x6007, and its firmware"
        )
        return Finding("fail", where, what, advice)
    if not trace.in_time:
        advice = "lower consumer_ms of its profile, or correct what the profile states"
        return Finding("fail", where, f"{seen}: too late, {path}", advice)
    if _is_early(trace):
        advice = "another cause has stopped it; find the cause, then repeat the test of the stop"
        return Finding("fail", where, f"{seen}: too early for a lost heartbeat", advice)
    if not trace.stood:
        advice = "check brake and quick stop ramp (0x6085), and the brake's delay"
        return Finding("fail", where, f"{seen}, but did not come to rest: {path}", advice)
    if coast_rad > COAST_RAD:
        advice = "the brake closes too slowly or the ramp is too flat: check 0x605A, 0x6085 and the brake's delay"
        return Finding("fail", where, f"{seen}, {path}; {COAST_RAD} rad are allowed", advice)
    return Finding("ok", where, f"{seen}, {trace.state}: {path}")
