"""Test of the drives of one arm: timing of their answers and stops, with 95 % intervals, phase by phase.

`DriveTestRun` is the job. It measures the answers of the disabled drives, and proves the stop as `gateway.check.stop`
does. Then it withholds the heartbeat once more with a fault as reaction, and moves each axis slowly. Every motion runs
in the motion loop, with its limits, gate and stops. Whether a stop is permitted is decided by `gateway.check`. Every
other finding is a figure whose whole interval is beyond its limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from drives.bus import EMCY_BASE, HEARTBEAT_BASE
from drives.cia402 import QUICK_STOP, State, decode_state
from drives.errors import ConfigurationRefused, DriveError
from drives.heartbeat import MASTER_NODE_ID
from drives.objects import OBJECTS
from drives.proof import StopTrace
from drives.standstill import STILL_S
from drives.values import DriveReading
from gateway.check.proofs import keep_proof
from gateway.check.stop import planned_stream, prove_stop, without_heartbeat
from gateway.drivetest.answers import FrameRecord, measure_answers
from gateway.drivetest.estimates import Standstill, add_figure, stop_figure, until_rest
from gateway.drivetest.torque_age import NAME as AGE
from gateway.drivetest.torque_age import modulated, torque_age
from gateway.errors import FindingFailed, LimitExceeded, PlanRefused
from gateway.motion.drive_limits import quick_stop_rad_s2
from gateway.motion.observer import Observed, Observer
from gateway.motion.opening import OpenArm
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions
from gateway.result.drive_test import DriveTestReport, TimingFigure

LOSS, FAULT_TIME = "heartbeat_loss_to_standstill_s", "fault_reaction_time_s"
QUICK_TIME, QUICK_ANGLE = "quick_stop_time_s", "quick_stop_angle_rad"
#: 0x6007: reaction of the drive to the lost heartbeat, a fault.
FAULT_OPTION: Final = 1
#: Answers of a drive in a motion below which its stop is not evaluated.
LEAST_ANSWERS: Final = 10

#: By how much the torque word may be older than the filter that the profile states [s].
AGE_MARGIN_S: Final = 0.002
#: A stop may last this many times the duration of the ramp in the drive, and longer by this [s] and two SYNCs.
RAMP_FACTOR: Final = 2.0
RAMP_MARGIN_S: Final = 0.05
#: Errors that end the test of a drive, after which nothing moves any more.
TEST_ENDS: Final = (DriveError, FindingFailed, LimitExceeded, PlanRefused)


@dataclass(slots=True, eq=False)
class PowerRun:
    """Answers of all drives while they were under power once, by SYNC.

    Attributes
    ----------
    began_s : float
        When power was requested (monotonic).
    sent_s, time_s : lists of float
        When each SYNC was sent, monotonic and in the time of the motion. In lockstep that is SYNC index times period.
    readings : list of tuples of DriveReading or None
    """

    began_s: float
    sent_s: list[float] = field(default_factory=list[float])
    time_s: list[float] = field(default_factory=list[float])
    readings: list[tuple[DriveReading | None, ...]] = field(default_factory=list[tuple[DriveReading | None, ...]])

    def at(self, sent_s: float) -> float:
        """Return the time of the motion at a monotonic time."""
        return float(np.interp(sent_s, self.sent_s, self.time_s))

    def answers(self, axis: int, since: int = 0, end: int | None = None) -> np.ndarray:
        """Return time [s], position [counts], torque word and statusword (K, 4) of an axis in a range of SYNCs."""
        seen = [
            (time_s, reading.position_count, reading.torque_word, reading.statusword)
            for time_s, row in zip(self.time_s[since:end], self.readings[since:end], strict=True)
            if (reading := row[axis]) is not None
        ]
        return np.array(seen, dtype=float).reshape(-1, 4)


class MotionRecord(Observer):
    """Observer of the motion loop that stores the answers of every run under power.

    Parameters
    ----------
    opened : OpenArm
    """

    def __init__(self, opened: OpenArm) -> None:
        self.runs: list[PowerRun] = []
        self._group = opened.group

    def began(self, *_arms: object) -> None:
        """Begin a run."""
        self.runs.append(PowerRun(time.monotonic()))

    def sampled(self, observed: Observed) -> None:
        """Store the answers of one SYNC."""
        run, sample = self.runs[-1], observed.samples[0]
        run.sent_s.append(self._group.sync_sent_s)
        run.time_s.append(sample.time_s)
        run.readings.append(sample.readings)


class DriveTestRun:
    """Test of the drives of an opened arm.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, in its brakes.
    numbers : collection of int
        Axes to test, from 0.
    folder : Path
        Where the reports are written after each phase.
    say : callable
        Takes a remark about progress.

    Attributes
    ----------
    reports : list of DriveTestReport
        Of the tested drives, in the order of the axes.
    is_explained : bool
        True unless the test ended early by an error that no report names.
    """

    def __init__(self, opened: OpenArm, numbers: Collection[int], folder: Path, say: Callable[[str], None]) -> None:
        self._opened, self._group, self._folder, self._say = opened, opened.group, folder, say
        self._period_s = opened.group.timing.period_s
        self._ramp_rad_s2 = quick_stop_rad_s2(opened.config, opened.profiles, opened.readings)
        self._frames, self._motion = FrameRecord(opened.group.bus), MotionRecord(opened)
        #: Reports by axis, from 0.
        self._tested: dict[int, DriveTestReport] = {}
        keys = {"vendor": "vendor_id", "product": "product_code", "revision": "revision", "serial": "serial_number"}
        keys |= {"firmware": "software_version", "name": "name"}
        for number in sorted(numbers):
            drive = opened.group.drives[number]
            identity = {key: getattr(drive.identity, name, None) for key, name in keys.items()}
            self._tested[number] = DriveTestReport(f"J{number + 1}", drive.node_id, identity)
        self.reports = list(self._tested.values())
        self.is_explained = True

    def write(self) -> None:
        """Write one file per drive."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for report in self.reports:
            report.write(self._folder)

    def run(self, options: MoveOptions, proof: Path) -> None:
        """Run every phase. Nothing moves any more after a drive, a limit or a failed proof has ended one.

        Parameters
        ----------
        options : MoveOptions
        proof : Path
            Where the proof that the drives stop without their master is stored.

        Raises
        ------
        DriveError, FindingFailed, LimitExceeded, PlanRefused
            The test ended early; it is a finding of the drives that it names, else not `is_explained`.
        KeyboardInterrupt
            A person stopped the arm.
        """
        options.observers.add(self._motion)
        phases: list[tuple[str, Callable[[], None]]] = [
            ("heartbeat withheld, then quick stop, in slow motions", lambda: self._measure_stops(options, proof)),
            ("heartbeat withheld again: fault reaction", lambda: self._measure_fault_reaction(options)),
            ("slow motion of each axis: age of the torque word", lambda: self._measure_torque_age(options)),
        ]
        if self._group.timing.pacing == "real":
            text = "SYNC and controlwords with the axes disabled"
            phases.insert(0, (text, lambda: measure_answers(self._group, self._tested, self._frames)))
        text, why = "", "the answers of the drive do not show a standstill"
        self._group.bus.add_tap(self._frames.take)
        try:
            for text, phase in phases:
                self._say(text)
                phase()
                self.write()
        except TEST_ENDS as error:
            why = f"not measured: the test ended, {text}: {error}"
            failures = [each for each in getattr(error, "failures", (error,)) if isinstance(each, DriveError)]
            by_node = {failure.node: failure for failure in failures if failure.node is not None}
            named = [report for report in self.reports if report.node in by_node]
            # one of all drives is of the bus or this computer
            self.is_explained = bool(named) and len(by_node) < len(self._group.drives)
            for report in named if self.is_explained else ():
                report.findings.append(f"{text}: {by_node[report.node]}")
            raise
        finally:
            self._group.bus.remove_tap(self._frames.take)
            for report in self.reports:
                for name in (LOSS, QUICK_TIME, QUICK_ANGLE, FAULT_TIME, AGE):
                    if report.figure(name) is None:
                        add_figure(report, TimingFigure.not_measured(name, why))
            self.write()

    # -- stops -------------------------------------------------------------------------------------------------------

    def _measure_stops(self, options: MoveOptions, path: Path) -> None:
        """Prove the stop and store the proof; measure the loss of the heartbeat and the quick stop.

        Raises
        ------
        FindingFailed
            A drive did not stop as stated.
        """
        traces: tuple[StopTrace, ...] = ()
        try:
            proof = prove_stop(self._opened, options)
            traces = proof.traces
            keep_proof(path, self._opened, proof)
        finally:
            complete = self._motion.runs if traces else self._motion.runs[:-1]  # an interrupted run shows no stop
            for number in self._tested:
                for run in complete[:1]:
                    self._measure_loss(number, run, traces)
                for run in complete[1:2]:
                    self._measure_quick_stop(number, run)
        # an axis that the master had to stop moves the others meanwhile: only it is named
        ignored = {trace.node_id for trace in proof.traces if trace.left_s is None}
        failed = [item for item in proof.items if item.severity == "fail"]
        for report in self.reports:
            if not ignored or report.node in ignored:
                own = [item for item in failed if item.where.partition(":")[0] == f"{report.axis} node {report.node}"]
                report.findings += [f"{item.what}; {item.advice}" for item in own]
        if failed:
            raise FindingFailed(f"{failed[0].where}: {failed[0].what}; nothing moves any more")

    def _measure_loss(self, number: int, run: PowerRun, traces: Sequence[StopTrace]) -> None:
        """Add the time from the last heartbeat of the master, before the one gap of a run, to rest."""
        end_s = run.sent_s[-1]
        beats = [at_s for _, at_s in self._frames.of(HEARTBEAT_BASE + MASTER_NODE_ID, run.began_s) if at_s <= end_s]
        last_s = run.at(beats[int(np.argmax(np.diff([*beats, end_s])))] if beats else run.began_s)
        method = "heartbeat withheld in a slow motion; last heartbeat until the speed is below 2 % of that motion"
        if self._add_stop(LOSS, number, run, (last_s, last_s), method) is None and traces:
            self._add_stop_by_sdo(LOSS, number, traces[number])

    def _measure_quick_stop(self, number: int, run: PowerRun) -> None:
        """Add time and angle from the SYNC that carries the quick stop to rest."""
        words = self._frames.of(self._group.drives[number].commands[0].cob_id, run.began_s)
        stops = [at_s for data, at_s in words if int.from_bytes(data[:2], "little") == QUICK_STOP]
        syncs = [sent_s for sent_s in run.sent_s if stops and sent_s >= stops[0]]
        if not syncs:
            return
        begin_s = run.at(syncs[0])
        method = "quick stop (controlword 0x02) in a slow motion; SYNC that carries it until the speed is below 2 %"
        rest = self._add_stop(QUICK_TIME, number, run, (begin_s, begin_s), method)
        if rest is None:
            return
        scale, half = self._joint_per_count(number), 1.0 + rest.speed_per_s * self._frames.resolution_s
        low, high = max(0.0, (rest.travel - half) * scale), (rest.most + half) * scale
        method = "joint angle from that SYNC to rest; one count, the time stamp of the SYNC, the peak between two SYNCs"
        add_figure(self._tested[number], stop_figure(QUICK_ANGLE, low, high, method))

    def _measure_fault_reaction(self, options: MoveOptions) -> None:
        """Set the reaction to a lost heartbeat to a fault, withhold it in a slow motion, and reset the fault."""
        #: What 0x6007 held before, by drive.
        ready: dict[int, int] = {}
        option = OBJECTS["abort_connection_option"]
        reason = "reaction of the drive when the master's heartbeat stops"
        for number, report in self._tested.items():
            try:
                access = self._group.drives[number].access
                before = access.read(option)
                access.write(option, FAULT_OPTION, reason)
                ready[number] = before
            except (ConfigurationRefused, DriveError) as error:
                add_figure(report, TimingFigure.not_measured(FAULT_TIME, f"0x6007 = 1: {error}"))
        if not ready:
            return
        try:
            traces, _, left = without_heartbeat(self._opened, options)
        finally:
            for number, before in ready.items():
                self._group.drives[number].access.write(option, before, reason)
        run = self._motion.runs[-1]
        method = (
            "heartbeat withheld with 0x6007 = 1; from the emergency message, or the SYNCs around the fault, to rest"
        )
        for number in ready:
            report, answers = self._tested[number], run.answers(number)
            states = [decode_state(int(word)) for word in answers[:, 3]]
            enabled = np.flatnonzero([state is State.OPERATION_ENABLED for state in states])
            if report.node in left:
                report.findings.append(left[report.node])
            rest: Standstill | None = None
            if len(enabled) and enabled[-1] < len(states) - 1:
                if State.FAULT not in states:
                    report.findings.append("no fault state after the lost heartbeat with 0x6007 = 1")
                last_s, first_s = answers[enabled[-1] : enabled[-1] + 2, 0].tolist()
                times_s = [run.at(at_s) for _, at_s in self._frames.of(EMCY_BASE + report.node, run.began_s)]
                begin_s = next(((at_s, at_s) for at_s in times_s if last_s <= at_s <= first_s), (last_s, first_s))
                rest = self._add_stop(FAULT_TIME, number, run, begin_s, method)
            if rest is None:
                self._add_stop_by_sdo(FAULT_TIME, number, traces[number])

    def _add_stop(
        self, name: str, number: int, run: PowerRun, begin_s: tuple[float, float], method: str
    ) -> Standstill | None:
        """Add the time from an event, known between two bounds, to rest; None if the answers do not show it.

        A quick stop and a fault reaction are compared with the ramp that the drive holds (0x6085).
        """
        time_s, count = run.answers(number)[:, :2].T
        rest = until_rest(time_s, count, begin_s[1]) if len(time_s) >= LEAST_ANSWERS else None
        if rest is None:
            return None
        slip_s, limit, advice = self._frames.resolution_s, None, ""
        if self._ramp_rad_s2 is not None and name != LOSS:
            ramp_s = rest.speed_per_s * self._joint_per_count(number) / float(self._ramp_rad_s2[number])
            limit = RAMP_FACTOR * ramp_s + 2.0 * self._period_s + RAMP_MARGIN_S
            advice = f"its ramp 0x6085 states {1000 * ramp_s:.0f} ms; check 0x605A, 0x605E, 0x6085 and its tuning"
        low, high = max(0.0, rest.low_s - slip_s), rest.high_s + begin_s[1] - begin_s[0] + slip_s
        text = f"{method}; resolution: SYNC period of {1000 * self._period_s:g} ms"
        add_figure(self._tested[number], stop_figure(name, low, high, text), limit, advice)
        return rest

    def _add_stop_by_sdo(self, name: str, number: int, trace: StopTrace) -> None:
        """Add the bounds of a stop of a drive that left NMT state OPERATIONAL: its positions were read by SDO."""
        if trace.left_s is None or not trace.stood:
            return
        high_s = trace.rest_s + STILL_S + self._period_s
        low_s, high_s = (0.0, high_s - trace.enabled_s) if name == FAULT_TIME else (trace.enabled_s, high_s)
        method = "heartbeat withheld in a slow motion; the drive leaves OPERATIONAL: positions were read by SDO"
        add_figure(self._tested[number], stop_figure(name, low_s, high_s, method))

    def _joint_per_count(self, number: int) -> float:
        """Return how far the joint turns with one count of the motor [rad]."""
        motor = np.eye(len(self._opened.config.axis))[number]
        return abs(self._group.drives[number].scale.count_rad) * float(self._opened.arm.axes.joint_bound(motor).max())

    # -- torque ------------------------------------------------------------------------------------------------------

    def _measure_torque_age(self, options: MoveOptions) -> None:
        """Move each tested axis slowly, forth and back; evaluate the motions once the arm is in its brakes."""
        moved: list[tuple[int, PowerRun, int, int]] = []
        try:
            with powered(planned_stream(self._opened, options)) as stream:
                stream.take_over()
                run = self._motion.runs[-1]
                for number, report in self._tested.items():
                    began = len(run.time_s)
                    try:
                        here = self._opened.workspace, stream.q_rad[0], number, self._period_s
                        motions = modulated(*here, options.override)
                    except PlanRefused as error:
                        add_figure(report, TimingFigure.not_measured(AGE, str(error)))
                        continue
                    for motion in motions:
                        stream.move([motion], f"move {report.axis} slowly")
                    moved.append((number, run, began, len(run.time_s)))
        finally:
            for number, run, began, ended in moved:
                limit = self._group.drives[number].setup.profile.torque.filter_s + AGE_MARGIN_S
                advice = "see the filters of the torque word, and state filter_s in the profile"
                age = torque_age(run.answers(number, began, ended)[:, :3], self._period_s)
                add_figure(self._tested[number], age, limit, advice)


def axes_named(names: Sequence[str], count: int) -> frozenset[int]:
    """Return the axes (from 0) of names such as `J2`; all of them without a name.

    Raises
    ------
    ValueError
        No axis has this name.
    """
    known = {f"J{number + 1}": number for number in range(count)}
    wrong = [name for name in names if name.upper() not in known]
    if wrong:
        raise ValueError(f"'{wrong[0]}' is not an axis of this arm: give one of {', '.join(known)}")
    return frozenset(known[name.upper()] for name in names) or frozenset(known.values())
