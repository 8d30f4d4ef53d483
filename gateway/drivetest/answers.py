"""Answers of disabled drives in NMT state OPERATIONAL, in real time: to SYNC at several periods, and to controlwords.

`measure_answers` runs these tests; it energises nothing.
"""

from __future__ import annotations

import time
from collections import defaultdict
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
#: A time stamp that is older than this was taken by another clock [s].
OLDEST_S: Final = 10.0

#: Limits. A drive that needs longer from controlword to statusword delays every stop by that [s].
REACTION_LIMIT_S: Final = 0.02
#: Delay of the answer to SYNC, in SYNC periods.
ANSWER_SHARE: Final = 0.2


def stamp_resolution_s(bus: Bus) -> float:
    """Return by how much a time stamp may be wrong, to either side [s]: taken by the kernel or the sender, or here."""
    return 0.0001 if bus.stamped else 0.001


def measure_answers(group: DriveGroup, tested: Mapping[int, DriveTestReport]) -> None:
    """Measure the answers of some drives to SYNC and to controlwords that energise nothing.

    The interpolation period of the cell and NMT state PRE-OPERATIONAL are restored in every case.

    Parameters
    ----------
    group : DriveGroup
        Configured, disabled.
    tested : mapping of int to DriveTestReport
        Axes to test, from 0; figures and findings are added to their reports.

    Raises
    ------
    FindingFailed
        A drive does not react to controlwords.
    """
    bus, period_s, reacting = group.bus, group.timing.period_s, list(tested)
    #: Monotonic times at which frames of each identifier were on the bus; without a valid time stamp, of their arrival.
    times_s: defaultdict[int, list[float]] = defaultdict(list)
    resolution_s, stamped = stamp_resolution_s(bus), bus.stamped

    def take(frame: Frame, received: bool) -> None:
        now_s, age_s = time.monotonic(), time.time() - frame.timestamp
        back_s = age_s if received and stamped and 0.0 < age_s < OLDEST_S else 0.0
        times_s[frame.arbitration_id].append(now_s - back_s)

    bus.add_tap(take)
    try:
        seen, refused = _answers(group, reacting, times_s, period_s, CELL_SYNCS)
        method = (
            f"{CELL_SYNCS} SYNCs at {1000 * period_s:g} ms, axis disabled; time stamps of the frames ± "
            f"{1000 * resolution_s:g} ms, and the time that this computer took to send each SYNC"
        )
        for number, answers in seen.items():
            for name, share in QUANTILES:
                figure = quantile_figure(name, answers.delays_s, share, resolution_s, method)
                limit = ANSWER_SHARE * period_s if name == "sync_to_tpdo_s" else None
                advice = "see the event and inhibit time of its TPDO, and the load of the bus"
                add_figure(tested[number], figure, limit, advice)
        for number, why in refused.items():
            tested[number].figures.extend(TimingFigure(name, why) for name, _ in QUANTILES)
        method = (
            f"{CONTROLWORDS} controlwords 0x06 and 0x00 by RPDO and SYNC, axis disabled; statusword polled by SDO, "
            "whose round trip limits the interval"
        )
        _nmt(group, NmtCommand.START, reacting, 0.1)
        for number, report in tested.items():
            try:
                bounds = _reactions(bus, group.drives[number])
            except DriveError as error:
                reacting.remove(number)
                report.findings.append(f"controlword to reaction: {error}")
                add_figure(report, TimingFigure("controlword_to_reaction_s", str(error)))
                continue
            figure = quantile_figure("controlword_to_reaction_s", bounds, 0.5, resolution_s, method)
            advice = "it delays every stop: see the cycle time and the filters of the drive"
            add_figure(report, figure, REACTION_LIMIT_S, advice)
        _nmt(group, NmtCommand.ENTER_PREOPERATIONAL, list(tested), 0.02)
        for counted_s, count in PERIODS:
            seen, refused = _answers(group, reacting, times_s, counted_s, count)
            method = f"SYNCs at {1000 * counted_s:g} ms that this computer sent on time, axis disabled"
            late = f"{method}; later than {DELAYED_SHARE:g} of the period"
            advice = "see its cable, the load of the bus, and the inhibit time of its TPDO"
            for kind, counter, text in (("missed_pdo", "missed", method), ("late_pdo", "delayed", late)):
                name = f"{kind}_{1000 * counted_s:.0f}ms"
                figures = [share_figure(name, getattr(one, counter), one.counted, text) for one in seen.values()]
                shares = [figure.value or 0.0 for figure in figures]
                for place, (number, figure) in enumerate(zip(seen, figures, strict=True)):
                    # a period that is shorter than that of the cell is not required of a drive
                    limit = permitted_share(shares, place) if counted_s >= period_s else None
                    add_figure(tested[number], figure, limit, advice)
                for number, why in refused.items():
                    add_figure(tested[number], TimingFigure(name, why))
        if failed := [tested[number] for number in tested if number not in reacting]:
            names = ", ".join(f"{report.axis} node {report.node}" for report in failed)
            raise FindingFailed(f"{names}: no reaction to a controlword; nothing moves")
    finally:
        bus.remove_tap(take)
        _nmt(group, NmtCommand.ENTER_PREOPERATIONAL, list(tested), 0.02)
        for number, report in tested.items():
            refusal = _set_period(group.drives[number], period_s)
            if refusal:  # `DriveGroup.enable` refuses such a drive: nothing moves
                report.findings.append(f"the interpolation period of the cell was not restored: {refusal}")


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
    group: DriveGroup, axes: Sequence[int], times_s: Mapping[int, list[float]], period_s: float, count: int
) -> tuple[dict[int, SyncAnswers], dict[int, str]]:
    """Send SYNCs in real time at one SYNC and interpolation period, to as many drives at once as the bus takes.

    Parameters
    ----------
    group : DriveGroup
    axes : sequence of int
        Their drives are NMT PRE-OPERATIONAL, before and after.
    times_s : mapping
        Filled with the times of the frames of each identifier.
    period_s, count : float, int
        SYNC period and number of SYNCs.

    Returns
    -------
    answers : dict of int to SyncAnswers
    refused : dict of int to str
        Why a drive was not measured at this period.
    """
    bus = group.bus
    tpdos = max((len(group.drives[number].answers) for number in axes), default=1)
    most = len(axes)
    while (
        most
        and load_percent(cycle_bits_worst([0, *[8] * (tpdos * most)]), period_s, bus.spec.bitrate_bit_s)
        > LOAD_LIMIT_PERCENT
    ):
        most -= 1
    if not most:
        return {}, dict.fromkeys(axes, f"the answers of one drive would exceed {LOAD_LIMIT_PERCENT:.0f} % bus load")
    seen: dict[int, SyncAnswers] = {}
    refused: dict[int, str] = {}
    for first in range(0, len(axes), most):
        batch = axes[first : first + most]
        refused |= {number: why for number in batch if (why := _set_period(group.drives[number], period_s))}
        ready = [number for number in batch if number not in refused]
        if not ready:
            continue
        _nmt(group, NmtCommand.START, ready, 0.1)
        clock, sent_s = SyncClock(bus, period_s), list[tuple[float, float]]()
        with RealTime():
            for _ in range(count):
                due_s = clock.wait()
                sent_s.append(_sync(bus))
                clock.sent(due_s)
        bus.listen(2.0 * period_s)
        _nmt(group, NmtCommand.ENTER_PREOPERATIONAL, ready, 0.02)
        came_s = [times_s[group.drives[number].answers[0][0]] for number in ready]
        seen |= zip(ready, count_answers(np.array(sent_s), came_s, period_s), strict=True)
    return seen, refused


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


def _set_period(drive: Cia402Drive, period_s: float) -> str:
    """Set the interpolation period of a drive; return why that is not possible, else an empty text."""
    try:
        bringup.settle_sync_period(drive, period_s)
        bringup.set_interpolation_period(drive, period_s)
    except DriveError as error:
        return str(error)
    return ""
