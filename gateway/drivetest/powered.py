"""Tests under power: loss of the heartbeat, quick stop, fault reaction, age of the torque word, drop in the brake.

The arm moves by the checks of the gateway (`gateway.check.stop`, `gateway.check.brakes`), with their limits and stops.
This module adds no motion of its own but the slow one that `torque_age` describes. It evaluates what the drives
answered and what was on the bus.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from drives.bus import HEARTBEAT_BASE
from drives.cia402 import QUICK_STOP, State, decode_state
from drives.errors import ConfigurationRefused, DriveError
from drives.heartbeat import MASTER_NODE_ID
from drives.objects import OBJECTS
from drives.proof import STILL_S, StopTrace
from gateway.check.brakes import AskSupport, try_brakes
from gateway.check.proofs import keep_proof
from gateway.check.stop import motion_station, prove_stop, without_heartbeat
from gateway.drivetest.estimates import not_measured
from gateway.drivetest.frames import FrameRecord
from gateway.drivetest.motion_record import MotionRecord, PowerRun
from gateway.drivetest.sheet import DriveSheet
from gateway.drivetest.standstill import PositionTrack, Standstill, first_after
from gateway.drivetest.torque_age import NAME as AGE
from gateway.drivetest.torque_age import modulated, torque_age
from gateway.errors import FindingFailed, LimitExceeded, PlanRefused
from gateway.motion.drive_limits import quick_stop_rad_s2
from gateway.motion.opening import OpenArm
from gateway.motion.power import powered
from gateway.motion.stream import MoveOptions, Stream
from gateway.result.drive_test import TimingFigure

#: 0x6007: reaction of the drive to the lost heartbeat, a fault.
_FAULT_OPTION: Final = 1
#: A stop may last this many times the duration of the ramp in the drive, and longer by this [s] and two SYNCs.
RAMP_FACTOR: Final = 2.0
RAMP_MARGIN_S: Final = 0.05
LOSS, QUICK_TIME, QUICK_ANGLE = "heartbeat_loss_to_standstill_s", "quick_stop_time_s", "quick_stop_angle_rad"
FAULT_TIME, BRAKE = "fault_reaction_time_s", "brake_drop_rad"


class PoweredTests:
    """Tests under power of one arm; results and failures are added to the sheets.

    Parameters
    ----------
    opened : OpenArm
    sheets : sequence of DriveSheet
    record : FrameRecord
    options : MoveOptions
    proof : Path
        Where the proof that the drives stop without their master is kept.
    ask : callable
        As `try_brakes`.

    Attributes
    ----------
    error : Exception or None
        Why the test ended early, if no tested drive has failed.
    """

    def __init__(
        self,
        opened: OpenArm,
        sheets: Sequence[DriveSheet],
        record: FrameRecord,
        options: MoveOptions,
        proof: Path,
        ask: AskSupport,
    ) -> None:
        self._opened, self._sheets, self._record = opened, tuple(sheets), record
        self._options, self._proof, self._ask = options, proof, ask
        self._motion = MotionRecord(opened)
        self._stopped_by = "not measured"
        self.error: Exception | None = None
        self._ramp_rad_s2 = quick_stop_rad_s2(opened.config, opened.profiles, opened.readings)
        options.observers.add(self._motion)

    def phases(self) -> list[tuple[str, Callable[[], None]]]:
        """Return the tests in their order, each with its description."""
        return [
            ("heartbeat withheld, then quick stop, in slow motions", self._stops),
            ("heartbeat withheld again: fault reaction", self._fault_reaction),
            ("slow motion of each axis: age of the torque word", self._torque_age),
            ("brakes", self._brakes),
        ]

    def run(self, say: Callable[[str], None], write: Callable[[], None]) -> None:
        """Run the tests; nothing moves any more after one that was stopped by a drive, a limit or a failed proof."""
        left = self.phases()
        while left:
            text, phase = left.pop(0)
            say(text)
            try:
                phase()
            except (DriveError, FindingFailed, LimitExceeded, PlanRefused) as error:
                self._failed(error, text)
                break
            finally:
                write()
        self._fill()

    def _failed(self, error: Exception, during: str) -> None:
        """Name the drives that failed. A failure of all drives at once is one of the bus or of this computer."""
        failures = [each for each in getattr(error, "failures", (error,)) if isinstance(each, DriveError)]
        by_node = {each.node: each for each in failures if each.node is not None}
        if len(by_node) < len(self._opened.group.drives):
            for sheet in self._sheets:
                own = by_node.get(sheet.drive.node_id)
                if own is not None:
                    sheet.broke(own, during)
        if not any(sheet.broken for sheet in self._sheets):
            self.error = error
        self._stopped_by = f"not measured: the test ended, {during}: {error}"

    def _fill(self) -> None:
        """State why a figure is missing."""
        for sheet in self._sheets:
            names = {figure.name for figure in sheet.figures}
            for name in (LOSS, QUICK_TIME, QUICK_ANGLE, FAULT_TIME, AGE, BRAKE):
                if name not in names:
                    unit = "rad" if name.endswith("_rad") else "s"
                    sheet.figures.append(not_measured(name, self._stopped_by, unit))

    # -- stops -------------------------------------------------------------------------------------------------------

    def _stops(self) -> None:
        """Prove the stop; figures of the loss of the heartbeat and of the quick stop."""
        try:
            proof = prove_stop(self._opened, self._options)
        except BaseException:
            self._evaluate_stops(len(self._motion.runs) - 1)  # the run that was interrupted shows no stop
            raise
        keep_proof(self._proof, self._opened, proof)
        self._evaluate_stops(len(self._motion.runs))
        self._by_sdo(LOSS, self._sheets, proof.traces, since_fault=False)
        # an axis that the master had to stop moves the others meanwhile: only it is judged
        ignored = {trace.node_id for trace in proof.traces if trace.left_s is None}
        for item in proof.items:
            for sheet in self._sheets:
                if ignored and sheet.drive.node_id not in ignored:
                    continue
                if item.severity == "fail" and f"node {sheet.drive.node_id}" in item.where:
                    sheet.findings.append(f"{item.what}; {item.advice}")
        if not proof.passed:
            failed = next(item for item in proof.items if item.severity == "fail")
            raise FindingFailed(f"{failed.where}: {failed.what}; nothing moves any more")

    def _evaluate_stops(self, complete: int) -> None:
        for number, evaluate in enumerate((self._loss, self._quick_stop)[:complete]):
            self._each_run(number, evaluate)

    def _each_run(self, number: int, evaluate: Callable[[DriveSheet, PowerRun, PositionTrack], None]) -> None:
        """Evaluate a run under power for each drive."""
        run = self._motion.runs[number]
        for sheet in self._sheets:
            track = run.track(sheet.number)
            if track is not None:
                evaluate(sheet, run, track)

    def _loss(self, sheet: DriveSheet, run: PowerRun, track: PositionTrack) -> None:
        last_s = self._last_heartbeat(run)
        method = "heartbeat withheld in a slow motion; last heartbeat until the speed is below 2 % of that motion"
        self._timed(sheet, LOSS, track, (run.at(last_s), run.at(last_s)), method)

    def _last_heartbeat(self, run: PowerRun) -> float:
        """Return when the last heartbeat of the master was sent before the one gap of a run."""
        end_s = run.sent_s[-1]
        beats = [frame.at_s for frame in self._record.of(HEARTBEAT_BASE + MASTER_NODE_ID, run.began_s)]
        beats = [at_s for at_s in beats if at_s <= end_s]
        return beats[int(np.argmax(np.diff([*beats, end_s])))] if beats else run.began_s

    def _quick_stop(self, sheet: DriveSheet, run: PowerRun, track: PositionTrack) -> None:
        own = self._record.of(sheet.drive.commands[0].cob_id, run.began_s)
        commanded = first_after([f.at_s for f in own if int.from_bytes(f.data[:2], "little") == QUICK_STOP], 0.0)
        sync_s = None if commanded is None else first_after(run.sent_s, commanded)
        if sync_s is None:
            return
        sync_s = run.at(sync_s)
        method = "quick stop (controlword 0x02) in a slow motion; SYNC that carries it until the speed is below 2 %"
        rest = self._timed(sheet, QUICK_TIME, track, (sync_s, sync_s), method)
        if rest is None:
            return
        scale, half = self._joint_per_count(sheet), 1.0 + rest.speed_per_s * self._record.resolution_s
        interval = (max(0.0, (rest.travel - half) * scale), (rest.most + half) * scale)
        method = "joint angle from that SYNC to rest; one count, the time stamp of the SYNC, the peak between two SYNCs"
        value = (rest.travel + rest.most) / 2.0 * scale
        sheet.figures.append(TimingFigure(QUICK_ANGLE, value, interval, "rad", 1, method))

    @property
    def _period_s(self) -> float:
        return self._opened.group.timing.period_s

    def _joint_per_count(self, sheet: DriveSheet) -> float:
        """Return how far the joint turns with one count of the motor [rad]."""
        motor = np.eye(len(self._opened.config.axis))[sheet.number]
        per_motor = float(self._opened.arm.axes.joint_bound(motor).max())
        return abs(sheet.drive.scale.count_rad) * per_motor

    def _timed(
        self, sheet: DriveSheet, name: str, track: PositionTrack, begin_s: tuple[float, float], method: str
    ) -> Standstill | None:
        """Add the time from an event, known between two bounds, until rest."""
        rest = track.until_rest(begin_s[1]) if track.at_s[-3] > begin_s[1] else None
        if rest is None:
            sheet.figures.append(not_measured(name, f"{method}: it did not come to rest"))
            return None
        slip_s = self._record.resolution_s
        low, high = max(0.0, rest.low_s - slip_s), rest.high_s + begin_s[1] - begin_s[0] + slip_s
        if name in (QUICK_TIME, FAULT_TIME):
            self._compare_with_ramp(sheet, name, low, rest.speed_per_s * self._joint_per_count(sheet))
        text = f"{method}; resolution: SYNC period of {1000 * self._period_s:g} ms"
        sheet.figures.append(TimingFigure(name, (low + high) / 2.0, (low, high), "s", 1, text))
        return rest

    def _compare_with_ramp(self, sheet: DriveSheet, name: str, low_s: float, speed_rad_s: float) -> None:
        """Compare a stop with the ramp that the drive holds (0x6085)."""
        if self._ramp_rad_s2 is None:
            return
        stated_s = speed_rad_s / float(self._ramp_rad_s2[sheet.number])
        if low_s > RAMP_FACTOR * stated_s + 2.0 * self._period_s + RAMP_MARGIN_S:
            what = "quick stop" if name == QUICK_TIME else "fault reaction"
            sheet.findings.append(
                f"{what} lasts at least {1000 * low_s:.0f} ms, its ramp 0x6085 states {1000 * stated_s:.0f} ms; check "
                "0x605A, 0x605E, 0x6085 and the tuning of the drive"
            )

    def _by_sdo(self, name: str, sheets: Sequence[DriveSheet], traces: Sequence[StopTrace], since_fault: bool) -> None:
        """Bounds for drives that left NMT state OPERATIONAL (0x1029): their positions were read by SDO."""
        for sheet in sheets:
            trace = traces[sheet.number]
            if sheet.figure(name) is not None or trace.left_s is None or not trace.stood:
                continue
            sheet.figures = [figure for figure in sheet.figures if figure.name != name]
            high = trace.rest_s + STILL_S + self._period_s - (trace.enabled_s if since_fault else 0.0)
            low = 0.0 if since_fault else trace.enabled_s
            method = "heartbeat withheld in a slow motion; the drive leaves OPERATIONAL: positions were read by SDO"
            sheet.figures.append(TimingFigure(name, (low + high) / 2.0, (low, high), "s", 1, method))

    # -- fault reaction ----------------------------------------------------------------------------------------------

    def _fault_reaction(self) -> None:
        """Set the reaction to a lost heartbeat to a fault, withhold it in a slow motion, and reset the fault."""
        ready: list[DriveSheet] = []
        for sheet in self._sheets:
            try:
                self._abort_connection(sheet, _FAULT_OPTION)
                ready.append(sheet)
            except (ConfigurationRefused, DriveError) as error:
                sheet.figures.append(not_measured(FAULT_TIME, f"0x6007 = 1: {error}"))
        if not ready:
            return
        number = len(self._motion.runs)
        try:
            traces, _, left = without_heartbeat(self._opened, self._options)
        finally:
            for sheet in ready:
                self._abort_connection(sheet, sheet.drive.setup.profile.heartbeat.abort_connection)
        self._each_run(number, partial(self._fault_time, left=left, ready=ready))
        self._by_sdo(FAULT_TIME, ready, traces, since_fault=True)

    def _abort_connection(self, sheet: DriveSheet, option: int) -> None:
        reason = "reaction of the drive when the master's heartbeat stops"
        sheet.drive.access.write(OBJECTS["abort_connection_option"], option, reason)

    def _fault_time(
        self,
        sheet: DriveSheet,
        run: PowerRun,
        track: PositionTrack,
        left: dict[int, str],
        ready: Sequence[DriveSheet],
    ) -> None:
        bounds = track.left_enabled()
        if sheet not in ready or bounds is None:
            return
        faults = {State.FAULT, State.FAULT_REACTION_ACTIVE}
        row = [each[sheet.number] for each in run.rows]
        states = {decode_state(reading.statusword) for reading in row if reading is not None}
        shown = ", ".join(str(state) for state in states & faults) or "no fault state"
        if State.FAULT not in states:
            sheet.findings.append(f"{shown} after the lost heartbeat with 0x6007 = 1")
        if stays := left.get(sheet.drive.node_id, ""):
            sheet.findings.append(stays)
        seen = [frame.at_s for frame in self._record.emergencies(sheet.drive.node_id, run.began_s)]
        emcy_s = first_after([run.at(at_s) for at_s in seen], bounds[0])
        begin_s = (emcy_s, emcy_s) if emcy_s is not None and emcy_s <= bounds[1] else bounds
        method = (
            "heartbeat withheld with 0x6007 = 1; from the emergency message, or the SYNCs around the fault, to rest"
        )
        self._timed(sheet, FAULT_TIME, track, begin_s, method)

    # -- torque ------------------------------------------------------------------------------------------------------

    def _torque_age(self) -> None:
        """Move each tested axis slowly, forth and back; evaluate the motions once the arm is in its brakes."""
        moved: list[tuple[DriveSheet, PowerRun, slice]] = []
        try:
            self._move_each(moved)
        finally:
            for sheet, run, rows in moved:
                known = zip(run.time_s[rows], (row[sheet.number] for row in run.rows[rows]), strict=True)
                seen = [(at_s, each.position_count, each.torque_word) for at_s, each in known if each is not None]
                sheet.figures.append(torque_age(np.array(seen, dtype=float).reshape(-1, 3), self._period_s))

    def _move_each(self, moved: list[tuple[DriveSheet, PowerRun, slice]]) -> None:
        """Move one axis after the other; add each finished motion to `moved`."""
        opened = self._opened
        with powered(Stream(motion_station(opened, self._options))) as stream:
            stream.take_over()
            run = self._motion.runs[-1]
            for sheet in self._sheets:
                began = len(run.time_s)
                try:
                    motions = modulated(opened.workspace, stream.q_rad[0], sheet.number, self._period_s)
                except PlanRefused as error:
                    sheet.figures.append(not_measured(AGE, str(error)))
                    continue
                for motion in motions:
                    stream.move([motion], f"move {sheet.axis} slowly")
                moved.append((sheet, run, slice(began, len(run.time_s))))

    # -- brakes ------------------------------------------------------------------------------------------------------

    def _brakes(self) -> None:
        """Let each brake hold its axis; one that was not tested counts when all axes at rest are disabled."""
        number = len(self._motion.runs)
        items = try_brakes(self._opened, self._options, self._ask)
        disabled_rad = self._opened.arm.brake_drop_rad()
        run = self._motion.runs[number]
        for sheet in self._sheets:
            own = [item for item in items if item.where == f"{sheet.axis} node {sheet.drive.node_id}"]
            sheet.findings += [f"{item.what}; {item.advice}" for item in own if item.severity == "fail"]
            count_rad, track = self._joint_per_count(sheet), run.track(sheet.number)
            counts = None if track is None else track.largest_drop()
            if counts is None and any(item.severity == "fail" for item in items):
                # the axis of that brake moved the whole arm
                sheet.figures.append(not_measured(BRAKE, "another brake failed, no further one was tested", "rad"))
                continue
            if counts is None:
                drop_rad, method = (
                    float(disabled_rad[sheet.number]),
                    "displacement after all axes at rest were disabled",
                )
            else:
                drop_rad, method = counts * count_rad, "axis held by its brake alone, up to 1 s; largest drop"
            interval = (max(0.0, drop_rad - 2.0 * count_rad), drop_rad + count_rad)
            method += "; one count, and one more that noise adds to the largest of many readings"
            sheet.figures.append(TimingFigure(BRAKE, drop_rad, interval, "rad", 1, method))
