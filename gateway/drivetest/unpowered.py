"""Tests of the disabled drives: answers to SDO, to SYNC at several periods, and to a controlword."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from drives import bringup
from drives.busload import cycle_bits_worst, load_percent
from drives.errors import DriveError
from drives.heartbeat import NmtCommand
from drives.objects import OBJECTS
from drives.sdo import ONCE
from gateway.drivetest.bench import DELAYED_SHARE, SyncBench, SyncSeries
from gateway.drivetest.estimates import bracketed_quantile, not_measured, share_figure
from gateway.drivetest.frames import FrameRecord
from gateway.drivetest.sheet import DriveSheet, usable
from gateway.motion.opening import OpenArm

#: SYNC periods [s] and SYNCs of the series in which missed and delayed TPDOs are counted.
PERIODS: Final = ((0.002, 500), (0.004, 500), (0.010, 300))
#: SYNCs of the series at the period of the cell, controlwords, and SDO transfers of each drive.
CELL_SYNCS: Final = 200
CONTROLWORDS: Final = 20
TRANSFERS: Final = 30
#: Bus load up to which a series is run [%].
LOAD_LIMIT_PERCENT: Final = 70.0
#: Quantiles of the time from SYNC to TPDO.
QUANTILES: Final = (("sync_to_tpdo_p05_s", 0.05), ("sync_to_tpdo_s", 0.5), ("sync_to_tpdo_p95_s", 0.95))
#: What is counted, as in the names of the figures.
COUNTED: Final = ("missed_pdo", "late_pdo")


def run_unpowered(opened: OpenArm, sheets: Sequence[DriveSheet], record: FrameRecord) -> None:
    """Run the tests that need no power; results and failures are added to the sheets."""
    group = opened.group
    bench = SyncBench(group.bus, [sheet.drive for sheet in sheets], record)
    try:
        for sheet in usable(sheets):
            _sdo_time(sheet)
        if group.timing.pacing == "real":
            bench.command(NmtCommand.START, 0.1)
            _at_cell_period(bench, sheets, group.timing.period_s)
            _reactions(bench, usable(sheets))
            bench.command(NmtCommand.ENTER_PREOPERATIONAL, 0.02)
            for period_s, count in PERIODS:
                _at_period(opened, usable(sheets), record, period_s, count)
    finally:
        bench.command(NmtCommand.ENTER_PREOPERATIONAL, 0.02)
        for sheet in sheets:
            refused = _with_period(sheet, group.timing.period_s)
            if refused:  # `DriveGroup.enable` refuses such a drive: nothing moves
                sheet.findings.append(f"the interpolation period of the cell was not restored: {refused}")


def _sdo_time(sheet: DriveSheet) -> None:
    """Round trip of an expedited upload."""
    times_s: list[float] = []
    method = f"{TRANSFERS} expedited uploads of 0x1000; request to answer, latency of this computer included"
    try:
        for _ in range(TRANSFERS):
            began_s = time.monotonic()
            sheet.drive.access.read(OBJECTS["device_type"], ONCE)
            times_s.append(time.monotonic() - began_s)
    except DriveError as error:
        sheet.findings.append(f"{len(times_s)} of {TRANSFERS} transfers were answered: {error}")
    sheet.figures.append(bracketed_quantile("sdo_answer_s", [(t, t) for t in times_s], 0.5, 0.0, method))


def _at_cell_period(bench: SyncBench, sheets: Sequence[DriveSheet], period_s: float) -> None:
    """SYNC to TPDO at the period of the cell."""
    for sheet, series in zip(sheets, bench.series(period_s, CELL_SYNCS), strict=True):
        method = (
            f"{CELL_SYNCS} SYNCs at {1000 * period_s:g} ms, axis disabled; time stamps of the frames "
            f"± {1000 * bench.record.resolution_s:g} ms, and the time that this computer took to send each SYNC"
        )
        for name, share in QUANTILES:
            sheet.figures.append(bracketed_quantile(name, series.delays_s, share, bench.record.resolution_s, method))


def _reactions(bench: SyncBench, sheets: Sequence[DriveSheet]) -> None:
    """Controlword to statusword, one drive after the other."""
    method = (
        f"{CONTROLWORDS} controlwords 0x06 and 0x00 by RPDO and SYNC, axis disabled; statusword polled by SDO, whose "
        "round trip limits the interval"
    )
    for sheet in sheets:
        try:
            bounds = bench.reaction(sheet.drive, CONTROLWORDS)
        except DriveError as error:
            sheet.figures.append(not_measured("controlword_to_reaction_s", str(error)))
            sheet.broke(error, "controlword to reaction")
            continue
        figure = bracketed_quantile("controlword_to_reaction_s", bounds, 0.5, bench.record.resolution_s, method)
        sheet.figures.append(figure)


def _at_period(opened: OpenArm, sheets: Sequence[DriveSheet], record: FrameRecord, period_s: float, count: int) -> None:
    """Count missed and delayed TPDOs at one SYNC and interpolation period, for as many drives as the bus takes."""
    name, bus = f"{1000 * period_s:.0f}ms", opened.group.bus
    most = _drives_at_once(sheets, period_s, bus.spec.bitrate_bit_s)
    if not most:
        why = f"the answers of one drive would exceed {LOAD_LIMIT_PERCENT:.0f} % bus load"
        _no_counts(sheets, name, why)
        return
    for first in range(0, len(sheets), most):
        ready: list[DriveSheet] = []
        for sheet in sheets[first : first + most]:
            refused = _with_period(sheet, period_s)
            if refused:
                _no_counts([sheet], name, refused)
            else:
                ready.append(sheet)
        bench = SyncBench(bus, [sheet.drive for sheet in ready], record)
        bench.command(NmtCommand.START, 0.05)
        for sheet, seen in zip(ready, bench.series(period_s, count), strict=True):
            _counted(sheet, name, seen)
        bench.command(NmtCommand.ENTER_PREOPERATIONAL, 0.02)


def _drives_at_once(sheets: Sequence[DriveSheet], period_s: float, bitrate_bit_s: int) -> int:
    """Return how many drives may answer each SYNC within the limit of the bus load."""
    most = max((len(sheet.drive.answers) for sheet in sheets), default=1)
    numbers = range(len(sheets), 0, -1)
    loads = ((n, load_percent(cycle_bits_worst([0, *[8] * (most * n)]), period_s, bitrate_bit_s)) for n in numbers)
    return next((number for number, load in loads if load <= LOAD_LIMIT_PERCENT), 0)


def _no_counts(sheets: Sequence[DriveSheet], name: str, why: str) -> None:
    for sheet in sheets:
        sheet.figures += [not_measured(f"{kind}_{name}", why, "1") for kind in COUNTED]


def _counted(sheet: DriveSheet, name: str, seen: SyncSeries) -> None:
    method = f"SYNCs at {1000 * seen.period_s:g} ms that this computer sent on time, axis disabled"
    delayed = f"{method}; later than {DELAYED_SHARE:g} of the period"
    sheet.figures.append(share_figure(f"missed_pdo_{name}", seen.missed, seen.counted, method))
    sheet.figures.append(share_figure(f"late_pdo_{name}", seen.delayed, seen.counted, delayed))


def _with_period(sheet: DriveSheet, period_s: float) -> str:
    """Set the interpolation period of a drive; return why that is not possible."""
    try:
        bringup.settle_sync_period(sheet.drive.access, period_s)
        bringup.set_interpolation_period(sheet.drive.access, period_s)
    except DriveError as error:
        return str(error)
    return ""
