"""Test of the drives of one arm: timing of their answers and stops, with 95 % intervals, step by step.

`run_test` runs the steps. The disabled drives answer first. Then the stop without the master and the quick stop are
proven as `gateway.check.stop` does. The heartbeat is withheld again with a fault as reaction, and each axis moves
slowly. Every motion runs in the motion loop, with its limits, gate and stops. Whether a stop is permitted is decided by
`gateway.check`. Every other finding is a figure whose whole interval is beyond its limit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from drives.cia402 import State
from drives.errors import ConfigurationRefused, DriveError
from drives.objects import OBJECTS
from drives.proof import StopTrace
from gateway.check.proofs import keep_proof
from gateway.check.stop import planned_stream, prove_stop, without_heartbeat
from gateway.data.visit import ArmSample
from gateway.drivetest.answers import measure_answers, stamp_resolution_s
from gateway.drivetest.estimates import TimeToRest, add_figure, until_rest
from gateway.drivetest.torque_age import NAME as AGE
from gateway.drivetest.torque_age import modulated, torque_age
from gateway.errors import FindingFailed, LimitExceeded, PlanRefused
from gateway.motion.drive_limits import quick_stop_rad_s2
from gateway.motion.opening import OpenArm
from gateway.motion.power import powered
from gateway.motion.setpoints import MotionSetpoints
from gateway.motion.stream import MoveOptions
from gateway.motion.trajectory import Motion
from gateway.result.drive_test import DriveTestReport, TimingFigure

LOSS, FAULT_TIME = "heartbeat_loss_to_standstill_s", "fault_reaction_time_s"
QUICK_TIME, QUICK_ANGLE = "quick_stop_time_s", "quick_stop_angle_rad"
#: Errors that end the test, after which nothing moves any more.
TEST_ENDS: Final = (DriveError, FindingFailed, LimitExceeded, PlanRefused)
#: Keys of the identity in a report, and the names in `drives.values.Identity`.
IDENTITY: Final = {
    "vendor": "vendor_id",
    "product": "product_code",
    "revision": "revision",
    "serial": "serial_number",
    "firmware": "software_version",
    "name": "name",
}
#: 0x6007: reaction of the drive to the lost heartbeat, a fault.
FAULT_OPTION: Final = 1

#: By how much the torque word may be older than the filter that the profile states [s].
AGE_MARGIN_S: Final = 0.002
#: A stop may last this many times the duration of the ramp in the drive, and longer by this [s] and two SYNCs.
RAMP_FACTOR: Final = 2.0
RAMP_MARGIN_S: Final = 0.05


def run_test(
    opened: OpenArm,
    axes: Collection[int],
    tested: dict[int, DriveTestReport],
    options: MoveOptions,
    proof_path: Path,
    folder: Path,
    say: Callable[[str], None],
) -> None:
    """Run every step. Nothing moves any more after a drive, a limit or a failed proof has ended one.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, in its brakes.
    axes : collection of int
        Axes to test, from 0; empty = all.
    tested : dict of int to DriveTestReport
        Filled with the reports by axis.
    options : MoveOptions
    proof_path : Path
        Where the proof that the drives stop without their master is stored.
    folder : Path
        Where the reports are written after each step.
    say : callable
        Takes a remark about progress.

    Raises
    ------
    FindingFailed
        The proof of the stop failed, or a drive failed; a failure of all drives is of the bus or this computer.
    DriveError, LimitExceeded, PlanRefused
        The test ended early, and no drive is named.
    KeyboardInterrupt
        A person stopped the arm.
    """
    group, moved = opened.group, (opened, tested, options)
    for number in sorted(axes or range(len(group.drives))):
        drive = group.drives[number]
        identity = {key: getattr(drive.identity, name, None) for key, name in IDENTITY.items()}
        tested[number] = DriveTestReport(f"J{number + 1}", drive.node_id, identity)
    steps: list[tuple[str, Callable[[], None]]] = [
        ("heartbeat withheld, then quick stop, in slow motions", lambda: _measure_stops(*moved, proof_path)),
        ("heartbeat withheld again: fault reaction", lambda: _measure_fault_reaction(*moved)),
        ("slow motion of each axis: age of the torque word", lambda: _measure_torque_age(*moved)),
    ]
    if group.timing.pacing == "real":
        steps.insert(0, ("SYNC and controlwords with the axes disabled", lambda: measure_answers(group, tested)))
    folder.mkdir(parents=True, exist_ok=True)
    step, why = "", "the answers of the drive do not show a standstill"
    try:
        for step, run in steps:
            say(step)
            run()
            for report in tested.values():
                report.write(folder)
    except TEST_ENDS as error:
        why = f"not measured: the test ended, {step}: {error}"
        failures = [each for each in getattr(error, "failures", (error,)) if isinstance(each, DriveError)]
        by_node = {failure.node: failure for failure in failures if failure.node is not None}
        named = [report for report in tested.values() if report.node in by_node]
        if not named or len(by_node) == len(group.drives):
            raise
        for report in named:
            report.findings.append(f"{step}: {by_node[report.node]}")
        failed = FindingFailed(str(error))
        failed.__notes__ = list(getattr(error, "__notes__", ()))
        raise failed from error
    finally:
        for report in tested.values():
            missing = [name for name in (LOSS, QUICK_TIME, QUICK_ANGLE, FAULT_TIME, AGE) if report.figure(name) is None]
            report.figures += [TimingFigure(name, why) for name in missing]
            report.write(folder)


def _measure_stops(
    opened: OpenArm, tested: Mapping[int, DriveTestReport], options: MoveOptions, proof_path: Path
) -> None:
    """Prove the stop and store the proof; measure the loss of the heartbeat and the quick stop.

    Raises
    ------
    FindingFailed
        A drive did not stop as stated.
    DriveError, LimitExceeded, PlanRefused, KeyboardInterrupt
        As `prove_stop`.
    """
    period_s = opened.group.timing.period_s

    def lost(traces: tuple[StopTrace, ...]) -> None:
        method = "heartbeat withheld in a slow motion; last heartbeat until the speed is below 2 % of that motion"
        for number, report in tested.items():
            _add_stop(opened, report, LOSS, number, traces[number], (-period_s, 0.0), method)

    proof = prove_stop(opened, options, lost)
    keep_proof(proof_path, opened, proof)
    for number, report in tested.items() if proof.quick_stop else ():
        method = "quick stop (controlword 0x02) in a slow motion; SYNC that carries it until the speed is below 2 %"
        rest = _add_stop(opened, report, QUICK_TIME, number, proof.quick_stop[number], (0.0, 0.0), method)
        if rest is not None:
            scale = _joint_per_count(opened, number)
            half = 1.0 + rest.speed_per_s * stamp_resolution_s(opened.group.bus)
            interval = max(0.0, (rest.travel - half) * scale), (rest.most + half) * scale
            method = (
                "joint angle from that SYNC to rest; one count, the time stamp of the SYNC, the peak between two SYNCs"
            )
            report.figures.append(TimingFigure(QUICK_ANGLE, method, sum(interval) / 2.0, interval, 1))
    # an axis that the master had to stop moves the others meanwhile: only it is named
    ignored = {trace.node_id for trace in proof.traces if trace.left_s is None}
    failed = [item for item in proof.items if item.severity == "fail"]
    for report in tested.values():
        if not ignored or report.node in ignored:
            where = f"{report.axis} node {report.node}"
            report.findings += [f"{item.what}; {item.advice}" for item in failed if item.where.split(":")[0] == where]
    if failed:
        raise FindingFailed(f"{failed[0].where}: {failed[0].what}; nothing moves any more")


def _measure_fault_reaction(opened: OpenArm, tested: Mapping[int, DriveTestReport], options: MoveOptions) -> None:
    """Set the reaction to a lost heartbeat to a fault, withhold it in a slow motion, and reset the fault.

    Raises
    ------
    DriveError, LimitExceeded, PlanRefused, KeyboardInterrupt
        As `without_heartbeat`.
    """
    #: What 0x6007 held before, by drive.
    before: dict[int, int] = {}
    option, reason = OBJECTS["abort_connection_option"], "reaction of the drive when the master's heartbeat stops"
    for number, report in tested.items():
        try:
            access = opened.group.drives[number].access
            value = access.read(option)
            access.write(option, FAULT_OPTION, reason)
            before[number] = value
        except (ConfigurationRefused, DriveError) as error:
            report.figures.append(TimingFigure(FAULT_TIME, f"0x6007 = 1: {error}"))
    if not before:
        return
    try:
        traces, _, faults = without_heartbeat(opened, options)
    finally:
        for number, value in before.items():
            opened.group.drives[number].access.write(option, value, reason)
    method = "heartbeat withheld with 0x6007 = 1; from the SYNCs around the fault to rest"
    for number in before:
        report, trace = tested[number], traces[number]
        if report.node in faults:
            report.findings.append(faults[report.node])
        if trace.left_s is not None:
            if trace.state is not State.FAULT:
                report.findings.append("no fault state after the lost heartbeat with 0x6007 = 1")
            _add_stop(opened, report, FAULT_TIME, number, trace, (trace.enabled_s, trace.left_s), method)


def _add_stop(
    opened: OpenArm,
    report: DriveTestReport,
    name: str,
    number: int,
    trace: StopTrace,
    begin_s: tuple[float, float],
    method: str,
) -> TimeToRest | None:
    """Add the time from an event, known between two bounds, to rest; None if the positions do not show it.

    A quick stop and a fault reaction are compared with the ramp that the drive holds (0x6085).
    """
    time_s, count, is_answer = np.array(trace.samples, dtype=float).reshape(-1, 3).T
    rest = until_rest(time_s, count, begin_s[1])
    if rest is None:
        return None
    period_s, slip_s, limit, advice = opened.group.timing.period_s, stamp_resolution_s(opened.group.bus), None, ""
    method = f"{method}; resolution: SYNC period of {1000 * period_s:g} ms"
    if not is_answer.all():
        slip_s += period_s
        method += "; the drive leaves OPERATIONAL: positions were read by SDO"
    ramps_rad_s2 = quick_stop_rad_s2(opened.config, opened.profiles, opened.readings)
    if ramps_rad_s2 is not None and name != LOSS:
        ramp_s = rest.speed_per_s * _joint_per_count(opened, number) / float(ramps_rad_s2[number])
        limit = RAMP_FACTOR * ramp_s + 2.0 * period_s + RAMP_MARGIN_S
        advice = f"its ramp 0x6085 states {1000 * ramp_s:.0f} ms; check 0x605A, 0x605E, 0x6085 and its tuning"
    low_s, high_s = max(0.0, rest.low_s - slip_s), rest.high_s + begin_s[1] - begin_s[0] + slip_s
    add_figure(report, TimingFigure(name, method, (low_s + high_s) / 2.0, (low_s, high_s), 1), limit, advice)
    return rest


def _joint_per_count(opened: OpenArm, number: int) -> float:
    """Return how far the joint turns with one count of the motor [rad]."""
    motor = np.eye(len(opened.config.axis))[number]
    return abs(opened.group.drives[number].scale.count_rad) * float(opened.arm.axes.joint_bound(motor).max())


class _KeptMotion(MotionSetpoints):
    """Motion of one arm whose answers are kept."""

    def __init__(self, start_rad: Sequence[np.ndarray], motion: Motion, kept: list[ArmSample]) -> None:
        super().__init__(start_rad, [motion])
        self._kept = kept

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """Keep the answers to one SYNC."""
        self._kept.append(samples[0])


def _measure_torque_age(opened: OpenArm, tested: Mapping[int, DriveTestReport], options: MoveOptions) -> None:
    """Move each tested axis slowly, forth and back; evaluate the motions once the arm is in its brakes.

    Raises
    ------
    DriveError, LimitExceeded, PlanRefused, KeyboardInterrupt
        As `powered` and `Stream.drive`.
    """
    period_s = opened.group.timing.period_s
    moved: dict[int, list[ArmSample]] = {}
    try:
        with powered(planned_stream(opened, options)) as stream:
            stream.take_over()
            for number, report in tested.items():
                try:
                    motions = modulated(opened.workspace, stream.q_rad[0], number, period_s, options.override)
                except PlanRefused as error:
                    report.figures.append(TimingFigure(AGE, str(error)))
                    continue
                kept = list[ArmSample]()
                for motion in motions:
                    stream.drive(_KeptMotion(stream.q_rad, motion, kept), f"move {report.axis} slowly")
                moved[number] = kept
    finally:
        for number, samples in moved.items():
            answers = [(sample.time_s, sample.readings[number]) for sample in samples]
            rows = [(at_s, one.position_count, one.torque_word) for at_s, one in answers if one is not None]
            limit = opened.group.drives[number].setup.profile.torque.filter_s + AGE_MARGIN_S
            advice = "see the filters of the torque word, and state filter_s in the profile"
            age = torque_age(np.array(rows, dtype=float).reshape(-1, 3), period_s)
            add_figure(tested[number], age, limit, advice)
