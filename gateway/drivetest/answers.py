"""Answers of disabled drives in NMT state OPERATIONAL, in real time: to SYNC at several periods, and to controlwords.

`measure_answers` runs these tests; it energises nothing. `FrameRecord` stores the frames of the bus with their times.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from drives import bringup
from drives.bus import SYNC_ID, Bus, Frame
from drives.busload import LOAD_LIMIT_PERCENT, cycle_bits_worst, load_percent
from drives.cia402 import DISABLE_VOLTAGE, SHUTDOWN, State, decode_state
from drives.clock import SyncClock
from drives.drive import Cia402Drive
from drives.errors import DriveError, TransitionTimeout
from drives.group import DriveGroup
from drives.heartbeat import NmtCommand, send_nmt
from drives.objects import OBJECTS
from drives.realtime import RealTime
from drives.sdo import ONCE
from gateway.drivetest.estimates import (
    DELAYED_SHARE,
    SyncAnswers,
    add_figure,
    count_answers,
    permitted_share,
    quantile_figure,
    share_figure,
)
from gateway.errors import FindingFailed
from gateway.result.drive_test import DriveTestReport, TimingFigure

#: Quantiles of the time from SYNC to TPDO.
QUANTILES: Final = (("sync_to_tpdo_p05_s", 0.05), ("sync_to_tpdo_s", 0.5), ("sync_to_tpdo_p95_s", 0.95))
#: SYNC periods [s] and SYNCs of the series in which missed and delayed TPDOs are counted.
PERIODS: Final = ((0.002, 500), (0.004, 500), (0.010, 300))
#: SYNCs of the series at the period of the cell, and controlwords to each drive.
CELL_SYNCS: Final = 200
CONTROLWORDS: Final = 20
#: How long a controlword may take to show in the statusword; a drive that needs longer is not moved [s].
LONGEST_REACTION_S: Final = 0.5
#: Half-width of the error of a time stamp [s]: by the kernel or the sender, and where the adapter gives none.
STAMP_S: Final = 0.0001
UNSTAMPED_S: Final = 0.001
#: A time stamp that is older than this was taken by another clock [s].
OLDEST_S: Final = 10.0

#: Limits. A drive that needs longer from controlword to statusword delays every stop by that [s].
REACTION_LIMIT_S: Final = 0.02
#: Delay of the answer to SYNC, in SYNC periods.
ANSWER_SHARE: Final = 0.2


class FrameRecord:
    """Frames received and sent on a bus, with the monotonic time [s] at which each was on the bus.

    Parameters
    ----------
    bus : Bus

    Attributes
    ----------
    resolution_s : float
        By how much these times may be wrong, to either side.
    """

    def __init__(self, bus: Bus) -> None:
        self.resolution_s = STAMP_S if bus.stamped else UNSTAMPED_S
        self._frames: list[tuple[int, bytes, float]] = []
        self._stamped = bus.stamped

    def take(self, frame: Frame, received: bool) -> None:
        """Add a frame; the time of one that was sent, or has no valid time stamp, is the present."""
        now_s, age_s = time.monotonic(), time.time() - frame.timestamp
        back_s = age_s if received and self._stamped and 0.0 < age_s < OLDEST_S else 0.0
        self._frames.append((frame.arbitration_id, bytes(frame.data), now_s - back_s))

    def of(self, can_id: int, since_s: float) -> list[tuple[bytes, float]]:
        """Return data and time of the frames with an id since a time."""
        return [(data, at_s) for number, data, at_s in self._frames if number == can_id and at_s >= since_s]


def measure_answers(group: DriveGroup, tested: Mapping[int, DriveTestReport], frames: FrameRecord) -> None:
    """Measure the answers of some drives to SYNC and to controlwords that energise nothing.

    The interpolation period of the cell and NMT state PRE-OPERATIONAL are restored in every case.

    Parameters
    ----------
    group : DriveGroup
        Configured, disabled.
    tested : mapping of int to DriveTestReport
        Axes to test, from 0; figures and findings are added to their reports.
    frames : FrameRecord
        Takes the frames of the bus of the group.

    Raises
    ------
    FindingFailed
        A drive does not react to controlwords.
    """
    bus, drives, axes, period_s = group.bus, group.drives, list(tested), group.timing.period_s
    try:
        _nmt(group, NmtCommand.START, axes, 0.1)
        method = (
            f"{CELL_SYNCS} SYNCs at {1000 * period_s:g} ms, axis disabled; time stamps of the frames ± "
            f"{1000 * frames.resolution_s:g} ms, and the time that this computer took to send each SYNC"
        )
        for number, seen in _answers(group, axes, frames, period_s, CELL_SYNCS).items():
            for name, share in QUANTILES:
                figure = quantile_figure(name, seen.delays_s, share, frames.resolution_s, method)
                limit = ANSWER_SHARE * period_s if name == "sync_to_tpdo_s" else None
                advice = "see the event and inhibit time of its TPDO, and the load of the bus"
                add_figure(tested[number], figure, limit, advice)
        method = (
            f"{CONTROLWORDS} controlwords 0x06 and 0x00 by RPDO and SYNC, axis disabled; statusword polled by SDO, "
            "whose round trip limits the interval"
        )
        failed: list[int] = []
        for number, report in tested.items():
            try:
                bounds = _reactions(bus, drives[number])
            except DriveError as error:
                failed.append(number)
                report.findings.append(f"controlword to reaction: {error}")
                add_figure(report, TimingFigure.not_measured("controlword_to_reaction_s", str(error)))
                continue
            figure = quantile_figure("controlword_to_reaction_s", bounds, 0.5, frames.resolution_s, method)
            advice = "it delays every stop: see the cycle time and the filters of the drive"
            add_figure(report, figure, REACTION_LIMIT_S, advice)
        _nmt(group, NmtCommand.ENTER_PREOPERATIONAL, axes, 0.02)
        for counted_s, count in PERIODS:
            reacting = {number: tested[number] for number in axes if number not in failed}
            _count_pdos(group, reacting, frames, counted_s, count)
        if failed:
            names = ", ".join(f"{tested[number].axis} node {tested[number].node}" for number in failed)
            raise FindingFailed(f"{names}: no reaction to a controlword; nothing moves")
    finally:
        _nmt(group, NmtCommand.ENTER_PREOPERATIONAL, axes, 0.02)
        for number, report in tested.items():
            refused = _set_period(drives[number], period_s)
            if refused:  # `DriveGroup.enable` refuses such a drive: nothing moves
                report.findings.append(f"the interpolation period of the cell was not restored: {refused}")


def _nmt(group: DriveGroup, command: NmtCommand, axes: Sequence[int], wait_s: float) -> None:
    """Send an NMT command to the drives of some axes and listen."""
    for number in axes:
        send_nmt(group.bus, command, group.drives[number].node_id)
    group.bus.listen(wait_s)


def _sync(bus: Bus) -> tuple[float, float]:
    """Send one SYNC; return the monotonic times before and after."""
    frame = bus.prepare(SYNC_ID, 0)
    before_s = time.monotonic()
    bus.send_frame(frame)
    return before_s, time.monotonic()


def _answers(
    group: DriveGroup, axes: Sequence[int], frames: FrameRecord, period_s: float, count: int
) -> dict[int, SyncAnswers]:
    """Send SYNCs in real time; return the answers of each of these axes, whose drives are NMT OPERATIONAL."""
    clock, sent_s = SyncClock(group.bus, period_s), list[tuple[float, float]]()
    with RealTime():
        for _ in range(count):
            due_s = clock.wait()
            sent_s.append(_sync(group.bus))
            clock.sent(due_s)
    group.bus.listen(2.0 * period_s)
    ids = [group.drives[number].answers[0][0] for number in axes]
    answers_s = [[at_s for _, at_s in frames.of(can_id, sent_s[0][0])] for can_id in ids]
    return dict(zip(axes, count_answers(np.array(sent_s), answers_s, period_s), strict=True))


def _reactions(bus: Bus, drive: Cia402Drive) -> list[tuple[float, float]]:
    """Measure the time from the SYNC that makes a controlword effective until the statusword shows its state.

    The commands are SHUTDOWN and DISABLE VOLTAGE in turn: neither energises the axis.

    Returns
    -------
    list of (float, float)
        Bounds of each trial [s]: the last poll that showed the old state, the first that showed the new one.

    Raises
    ------
    TransitionTimeout
        The statusword does not follow.
    """

    def command(controlword: int) -> tuple[float, float]:
        """Send a controlword with the present position, then SYNC; return the times of that SYNC."""
        drive.hold(drive.access.read(drive.setup.profile.position.object))
        drive.pack(controlword)
        bus.send_frame(drive.frames[0])
        return _sync(bus)

    bounds: list[tuple[float, float]] = []
    commands = ((SHUTDOWN, State.READY_TO_SWITCH_ON), (DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED))
    try:
        for word, target in commands * (CONTROLWORDS // 2):
            before_s, after_s = command(word)
            least_s, asked_s = 0.0, time.monotonic()
            while decode_state(drive.access.read(OBJECTS["statusword"], ONCE)) is not target:
                least_s, asked_s = max(0.0, asked_s - after_s), time.monotonic()
                if asked_s > after_s + LONGEST_REACTION_S:
                    what = f"does not reach {target} within {LONGEST_REACTION_S} s of the controlword"
                    advice = "read its error history 0x1003"
                    raise TransitionTimeout(what, node=drive.node_id, index=0x6041, advice=advice)
            bounds.append((least_s, time.monotonic() - before_s))
    finally:
        command(DISABLE_VOLTAGE)
        bus.listen(0.005)
    return bounds


def _count_pdos(
    group: DriveGroup, tested: Mapping[int, DriveTestReport], frames: FrameRecord, period_s: float, count: int
) -> None:
    """Count missed and delayed TPDOs at one SYNC and interpolation period, for as many drives as the bus takes.

    Only at the period of the cell or a longer one, a share above the limit is a finding.
    """
    axes, name, bitrate = list(tested), f"{1000 * period_s:.0f}ms", group.bus.spec.bitrate_bit_s
    tpdos = max((len(group.drives[number].answers) for number in axes), default=1)
    most = len(axes)
    while most and load_percent(cycle_bits_worst([0, *[8] * (tpdos * most)]), period_s, bitrate) > LOAD_LIMIT_PERCENT:
        most -= 1
    why = f"the answers of one drive would exceed {LOAD_LIMIT_PERCENT:.0f} % bus load"
    refused = {} if most else dict.fromkeys(axes, why)
    seen: dict[int, SyncAnswers] = {}
    for first in range(0, len(axes) if most else 0, max(most, 1)):
        batch = axes[first : first + most]
        refused |= {number: why for number in batch if (why := _set_period(group.drives[number], period_s))}
        ready = [number for number in batch if number not in refused]
        if ready:
            _nmt(group, NmtCommand.START, ready, 0.05)
            seen |= _answers(group, ready, frames, period_s, count)
            _nmt(group, NmtCommand.ENTER_PREOPERATIONAL, ready, 0.02)
    method = f"SYNCs at {1000 * period_s:g} ms that this computer sent on time, axis disabled"
    delayed = f"{method}; later than {DELAYED_SHARE:g} of the period"
    missed = [share_figure(f"missed_pdo_{name}", each.missed, each.counted, method) for each in seen.values()]
    late = [share_figure(f"late_pdo_{name}", each.delayed, each.counted, delayed) for each in seen.values()]
    for figures in (missed, late):
        shares = [figure.value or 0.0 for figure in figures]
        for drive, (number, figure) in enumerate(zip(seen, figures, strict=True)):
            limit = permitted_share(shares, drive) if period_s >= group.timing.period_s else None
            advice = "see its cable, the load of the bus, and the inhibit time of its TPDO"
            add_figure(tested[number], figure, limit, advice)
    for number, why in refused.items():
        for kind in ("missed_pdo", "late_pdo"):
            add_figure(tested[number], TimingFigure.not_measured(f"{kind}_{name}", why))


def _set_period(drive: Cia402Drive, period_s: float) -> str:
    """Set the interpolation period of a drive; return why that is not possible, else an empty text."""
    try:
        bringup.settle_sync_period(drive, period_s)
        bringup.set_interpolation_period(drive, period_s)
    except DriveError as error:
        return str(error)
    return ""
