"""Findings from the figures of a drive: what is beyond a limit with certainty, and is not common to all drives."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Final

from gateway.check.brakes import STEP_RAD
from gateway.drivetest.powered import BRAKE
from gateway.drivetest.sheet import DriveSheet
from gateway.drivetest.torque_age import NAME as AGE
from gateway.drivetest.unpowered import COUNTED, PERIODS
from gateway.result.drive_test import TimingFigure

#: A drive that needs longer from controlword to statusword delays every stop by that [s].
REACTION_LIMIT_S: Final = 0.02
#: Largest delay of the answer to SYNC, and of its spread above that of the other drives, in SYNC periods.
ANSWER_SHARE: Final = 0.2
SPREAD_SHARE: Final = 0.1
#: Largest share of TPDOs that are missed, or delayed, above that of the other drives.
LOST_SHARE: Final = 0.005
#: By how much the torque word may be older than the filter that the profile states [s].
AGE_MARGIN_S: Final = 0.002
#: Largest SDO answer as a share of the timeout of the profile.
SDO_SHARE: Final = 0.5
#: Drives from which on one is compared with the others.
_COMPARED: Final = 3


def judge(sheets: Sequence[DriveSheet], period_s: float) -> None:
    """Add the findings of every drive to its sheet.

    Parameters
    ----------
    sheets : sequence of DriveSheet
        With all figures.
    period_s : float
        SYNC period of the cell.
    """
    for sheet in sheets:
        others = [other for other in sheets if other is not sheet] if len(sheets) >= _COMPARED else []
        _reactions(sheet, period_s)
        _spread(sheet, others, period_s)
        for counted_s, _ in PERIODS:
            if counted_s >= period_s:
                _lost(sheet, others, f"{1000 * counted_s:.0f}ms")


def _interval(sheet: DriveSheet, name: str) -> tuple[float, float] | None:
    figure = sheet.figure(name)
    return None if figure is None else figure.interval


def _beyond(sheet: DriveSheet, name: str, limit: float, what: str, advice: str) -> None:
    """Add a finding if the whole interval of a figure is beyond its limit."""
    figure, interval = sheet.figure(name), _interval(sheet, name)
    if figure is not None and interval is not None and interval[0] > limit:
        sheet.findings.append(f"{what} is {_text(figure)}; at most {_value(limit, figure.unit)} is allowed; {advice}")


def _text(figure: TimingFigure) -> str:
    low, high = figure.interval or (0.0, 0.0)
    ends = f"{_value(low, figure.unit)} to {_value(high, figure.unit)}"
    return f"{_value(figure.value or 0.0, figure.unit)} ({ends})"


def _value(value: float, unit: str) -> str:
    if unit == "s":
        return f"{1000.0 * value:.3g} ms"
    return f"{100.0 * value:.2g} %" if unit == "1" else f"{value:.4g} {unit}"


def _reactions(sheet: DriveSheet, period_s: float) -> None:
    profile = sheet.drive.setup.profile
    advice = "it delays every stop: see the cycle time and the filters of the drive"
    _beyond(sheet, "controlword_to_reaction_s", REACTION_LIMIT_S, "time from controlword to reaction", advice)
    advice = "see the event and inhibit time of its TPDO, and the load of the bus"
    _beyond(sheet, "sync_to_tpdo_s", ANSWER_SHARE * period_s, "time from SYNC to TPDO", advice)
    advice = "see the filters of the torque word, and state filter_s in the profile"
    _beyond(sheet, AGE, profile.torque.filter_s + AGE_MARGIN_S, "age of the torque word", advice)
    advice = "see whether another tool uses its SDO channel, or raise timeout_s of the profile"
    _beyond(sheet, "sdo_answer_s", SDO_SHARE * profile.sdo.timeout_s, "time of an SDO answer", advice)
    if not any("brake" in text for text in sheet.findings):
        _beyond(sheet, BRAKE, STEP_RAD, "drop in the brake", "repair the brake, or raise the delay of the brake")


def _spread(sheet: DriveSheet, others: Sequence[DriveSheet], period_s: float) -> None:
    """Spread of the time from SYNC to TPDO, above that of the other drives: what they share is bus or computer."""
    own = _spread_of(sheet)
    if own is None or not others:
        return
    common_s = median([each[1] for other in others if (each := _spread_of(other)) is not None] or [0.0])
    if own[0] > common_s + SPREAD_SHARE * period_s:
        sheet.findings.append(
            f"time from SYNC to TPDO varies by at least {_value(own[0], 's')} between its 5 % and 95 % quantiles, that "
            f"of the other drives by {_value(common_s, 's')}; see the cycle of the drive's own clock and its load"
        )


def _spread_of(sheet: DriveSheet) -> tuple[float, float] | None:
    """Return least and largest spread within the intervals of both quantiles."""
    low, high = _interval(sheet, "sync_to_tpdo_p05_s"), _interval(sheet, "sync_to_tpdo_p95_s")
    return None if low is None or high is None else (max(0.0, high[0] - low[1]), high[1] - low[0])


def _lost(sheet: DriveSheet, others: Sequence[DriveSheet], period: str) -> None:
    for kind, what in zip(COUNTED, ("missed", "delayed"), strict=True):
        figure, interval = sheet.figure(f"{kind}_{period}"), _interval(sheet, f"{kind}_{period}")
        known = [each.value for other in others if (each := other.figure(f"{kind}_{period}")) is not None]
        common = median([value for value in known if value is not None] or [0.0])
        if figure is not None and interval is not None and interval[0] > max(LOST_SHARE, common):
            sheet.findings.append(
                f"{what} TPDOs at {period.replace('ms', ' ms')}: {_text(figure)} of the SYNCs; see its cable, the load "
                "of the bus, and the inhibit time of its TPDO"
            )
