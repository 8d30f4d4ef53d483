"""Test of the holding brakes: one axis at a time is disabled and monitored while the drives hold the other axes.

A failed brake must not let the axis drop. The test begins with a short time, and the drive holds the axis again at the
first SYNC beyond the limit. After a failure the arm stays under power until an operator has supported it, because its
next stop would rely on that brake.

A stop request that arrives while an axis drops is handled later: once the drive holds the axis again and, after a
failed brake, once the arm is supported.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from drives.errors import DriveError
from drives.proof import BrakeTest
from gateway.check.stop import planned_stream
from gateway.data.visit import ArmSample
from gateway.errors import LimitExceeded
from gateway.motion.opening import OpenArm
from gateway.motion.power import BRAKE_DROP_RAD, powered
from gateway.motion.stops import StopKind
from gateway.motion.stream import MoveOptions, Stream
from gateway.result.result import Finding

#: Successive test times of each axis [s]; in the last one the voltage is disabled as well.
WATCH_S: Final = (0.05, 0.2, 1.0)
#: Largest movement in one test time [rad] at which the next one follows.
STEP_RAD: Final = 0.002
#: Largest holding torque at which a brake is tested, as a share of the torque limit of the axis.
GRAVITY_SHARE: Final = 0.25
#: Duration of the torque measurement with all brakes open [s], and the share of its SYNCs that must be answered.
MEASURE_S: Final = 0.2
MEASURED_SHARE: Final = 0.5
#: A requested stop waits for so many SYNCs, in which the drive holds the axis again that is on its brake; if
#: it has moved farther than this [rad, joint], until the drive holds it.
LOOK_SYNCS: Final = 2
LETS_GO_RAD: Final = 0.0003
#: Longest time until an axis is at rest before its brake is tested [s].
REST_S: Final = 1.0
#: Time for which an arm is held under power after a brake has failed, if no operator can confirm the support [s].
SUPPORT_S: Final = 10.0

#: Prompts the operator, and returns a function that reports whether the action is done; None = no operator is present.
AskSupport = Callable[[str], Callable[[], bool] | None]


def try_brakes(opened: OpenArm, options: MoveOptions, ask: AskSupport = lambda _text: None) -> list[Finding]:
    """Test the brake of each axis in turn.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, brakes on, in a posture with little gravity torque on the axes.
    options : MoveOptions
    ask : callable
        Asks the operator to support an arm whose brake has failed, while it is held under power.

    Returns
    -------
    list of Finding
        One per axis. An axis that needs too much holding torque in this posture, or whose torque is unknown, is
        reported as not tested. All axes are disabled at the same time after the last test. After a failed brake no
        other brake is tested.

    Raises
    ------
    DriveError, LimitExceeded, KeyboardInterrupt
        The arm was stopped.
    """
    items: list[Finding] = []
    found: list[Finding] = []
    try:
        with powered(planned_stream(opened, options)) as stream:
            stream.take_over()
            for axis in range(len(opened.config.axis)):
                items.append(_too_heavy(opened, stream, axis) or _try_brake(opened, stream, axis, ask, found))
                if found:
                    break
    except DriveError as error:
        items = [item for item in items if item not in found] + _after(opened, error, found)
    except KeyboardInterrupt as stop:
        for item in found:
            stop.add_note(f"{item.where}: {item.what}; {item.advice}")
        raise
    return items


def _after(opened: OpenArm, error: DriveError, found: list[Finding]) -> list[Finding]:
    """Return the finding that explains why a stop was not confirmed; raise the error if there is none."""
    if found:
        return [replace(found[0], what=f"{found[0].what}; then: {error}")]
    # an axis that goes on dropping once all are disabled is not at rest
    drops = opened.arm.brake_drop_rad()
    if drops.max() <= BRAKE_DROP_RAD:
        raise error
    axis = int(np.argmax(drops))
    return [_failed(_where(opened, axis), float(drops[axis]), "when all axes were disabled")]


def _where(opened: OpenArm, axis: int) -> str:
    """Return the name of an axis in messages."""
    return f"J{axis + 1} node {opened.config.axis[axis].node_id}"


def _too_heavy(opened: OpenArm, stream: Stream, axis: int) -> Finding | None:
    """Return the reason why a brake is not tested: the holding torque of its drive, measured with all brakes open."""
    samples: list[tuple[ArmSample, ...]] = []
    stream.stand(MEASURE_S, "measure the torque at rest", samples.append)
    measured = np.array([sample.joint_torque_nm[axis] for (sample,) in samples])
    torque_nm, limit_nm = measured[np.isfinite(measured)], float(opened.workspace.torque_nm[axis])
    advice = f"move it to a posture with at most {GRAVITY_SHARE:.0%} and test again"
    if len(torque_nm) < max(1.0, MEASURED_SHARE * len(measured)) or not limit_nm > 0.0:
        advice = "find out why the drive reports no torque (0x6077), then test the brakes again"
        what = "its brake was not tested: the torque of its drive is not known"
        return Finding("warn", _where(opened, axis), what, advice)
    share = float(np.abs(torque_nm).max()) / limit_nm
    if share > GRAVITY_SHARE:
        what = f"its brake was not tested: its drive needs {share:.0%} of its torque limit in this posture"
        return Finding("warn", _where(opened, axis), what, advice)
    return None


def _try_brake(opened: OpenArm, stream: Stream, axis: int, ask: AskSupport, found: list[Finding]) -> Finding:
    """Disable the drive of an axis for increasing times and monitor its brake; then check all joints again.

    A failure is added to `found` before anything else is done.
    """
    where, moved_rad = _where(opened, axis), 0.0
    #: largest rotation of each joint per radian of this motor
    turns = opened.arm.axes.joint_bound(np.eye(len(opened.config.axis))[axis])
    for number, seconds in enumerate(WATCH_S):
        test, stopped = _released(opened, stream, axis, turns, seconds, number == len(WATCH_S) - 1)
        moved_rad, fell_rad = test.moved_rad * float(turns.max()), test.farthest_rad * float(turns.max())
        how = f"within {test.released_syncs * stream.period_s:.2f} s, and is held by its drive again"
        if test.beyond_limit or moved_rad > BRAKE_DROP_RAD:
            found.append(_failed(where, fell_rad, how))
        elif moved_rad > STEP_RAD and number < len(WATCH_S) - 1:
            found.append(_failed(where, fell_rad, how, STEP_RAD))
        elif stopped is not None:
            what = f"sank by {fell_rad:.4f} rad in its brake before the requested stop, and is held by its drive again"
            advice = "its brake may not hold: support the arm before its axes are disabled, then test this brake again"
            found.append(Finding("fail", where, what, advice))
        if found:
            _hold_until_supported(stream, ask, found[0], stopped is not None)
        if stopped is not None:
            raise stopped
        if found:
            break
    stream.excuse(0, np.zeros(len(turns), dtype=bool))
    held = f"its brake held it for {WATCH_S[-1]:g} s: it moved by {moved_rad:.4f} rad"
    return found[0] if found else Finding("ok", where, held)


def _failed(where: str, moved_rad: float, how: str, allowed_rad: float = BRAKE_DROP_RAD) -> Finding:
    what = f"sank by {moved_rad:.4f} rad in its brake {how}; {allowed_rad} rad are allowed"
    return Finding("fail", where, what, "this brake does not hold: do not power this arm before it is repaired")


def _released(
    opened: OpenArm, stream: Stream, axis: int, turns: np.ndarray, seconds: float, disables_voltage: bool
) -> tuple[BrakeTest, BaseException | None]:
    """Disable the drive of an axis for a time; the drive holds the axis again at the end, or when it has moved too far.

    The second value is the cause of a stop request that has not been raised because the axis was moving.
    """
    group, period_s = opened.group, stream.period_s
    for _ in range(math.ceil(REST_S / period_s)):
        if group.is_at_rest:
            break
        stream.hold("come to rest", 0, 1)
    stream.excuse(0, turns > 0.0)
    test = group.release(axis, BRAKE_DROP_RAD / float(turns.max()), disables_voltage)
    rows = math.ceil(seconds / period_s)
    stopped: BaseException | None = None
    try:
        while (test.released_syncs < rows or not test.is_watched) and not test.beyond_limit:
            stream.hold("monitor the brake", min(test.released_syncs, rows), rows)
        test.enable_again()
        while not test.held:
            stream.hold("hold the axis again", 0, 1)
    except (DriveError, LimitExceeded):
        raise
    except BaseException as cause:
        # what the axis has done since the last answer shows in the next one, while its drive takes hold again
        test.enable_again()
        for _ in range(LOOK_SYNCS):
            stream.hold("hold the axis again before the stop", 0, 1, heed=False)
        if test.farthest_rad * float(turns.max()) <= LETS_GO_RAD:
            raise
        while not test.held:
            stream.hold("hold the axis again before the stop", 0, 1, heed=False)
        stopped = cause
    return test, stopped


def _hold_until_supported(stream: Stream, ask: AskSupport, item: Finding, stopping: bool) -> None:
    """Hold the arm under power until it is supported: once its axes are disabled, only the failed brake carries it.

    `stopping`: a stop was already requested. A quick stop ends this after `SUPPORT_S`; a request that becomes one ends
    it at once.
    """
    done = ask(
        f"{item.where} {item.what}. The arm is held under power. Support it, or lower it to a position where it"
        " cannot fall. Its axes are then disabled."
    )
    rows, urgent, desk = math.ceil(SUPPORT_S / stream.period_s), stream.urgent, stream.options.desk
    row = 0
    while (row < rows if done is None else not done()) and not (stopping and urgent and row >= rows):
        wish = desk.look()
        if stopping and not urgent and wish is not None and wish.kind is StopKind.QUICK_STOP:
            return
        stream.hold("hold the arm until it is supported", row, rows, heed=not stopping)
        row += 1
