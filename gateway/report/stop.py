"""Page of a stop: the last seconds of the black box per axis, drive states, and bus events; t = 0 is the stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gateway.data.blackbox.box import ArmBox, BlackBox
from gateway.data.blackbox.frame_decoder import (
    BoxDrive,
    DecodedEvent,
    decoded_events,
    drives_of,
    sample_times_s,
    state_spans,
)
from gateway.data.visit import following_error_rad
from gateway.report import notation
from gateway.report.page import Head, page
from gateway.report.svg import Point, limits, line_chart, row_panel

Floats = NDArray[np.float64]

MRAD, DEGREES = 1000.0, 180.0 / np.pi
#: Drawn time before the stop [s].
DRAWN_S = 10.0
#: Time span of the speed difference [s]; over one SYNC, encoder counts dominate.
SPEED_SPAN_S = 0.02
#: Number of bus events shown before and after the stop.
MOST_LINES = 40


def render_stop(box: BlackBox) -> str:
    """Return the HTML page of a stop."""
    drives = drives_of(box)
    time_s = sample_times_s(box)
    reported = decoded_events(box)
    before = [each for each in reported if each.time_s <= 0.0]
    after = [each for each in reported if each.time_s > 0.0]
    shown = before[-MOST_LINES:], after[:MOST_LINES]
    before, after, left_out = *shown, len(reported) - sum(map(len, shown))
    curves = [curves_of(arm, time_s, box.sync_index) for arm in box.arms]
    about = (("recording", box.recording), ("", box.created), ("", box.software))
    return page(
        "stop.html.j2",
        Head(f"Stop: {box.recording}", "Before the stop", about),
        reason=box.reason,
        span_s=notation.plain(float(np.ptp(time_s)) if len(time_s) else 0.0, 1),
        drawn_s=f"{DRAWN_S:g}",
        states=states_figure(box, drives, DRAWN_S) if drives else None,
        arms=[
            (f"Arm {curve.arm}" if len(curves) > 1 else "Axis by axis", _last(curve), axis_figures(curve))
            for curve in curves
        ],
        columns=[[notation.axis(axis + 1) for axis in range(curve.q_rad.shape[1])] for curve in curves],
        before=[_line(each, drives, len(curves)) for each in before],
        after=[_line(each, drives, len(curves)) for each in after],
        left_out=left_out,
        files=(box.path.name, box.path.with_suffix(".blf").name),
    )


def curves_of(arm: ArmBox, time_s: Floats, sync_index: np.ndarray) -> StopCurves:
    """Return the curves of an arm: the last `DRAWN_S`, with gaps at SYNCs without sample.

    Parameters
    ----------
    arm : ArmBox
    time_s : array of shape (n,)
        0 at the stop.
    sync_index : array of shape (n,)
    """
    values, next_to = arm.values, np.diff(sync_index) == 1
    reported = np.full_like(values["q_rad"], np.nan)
    reported[1:][next_to] = values["target_rad"][:-1][next_to]
    drawn = time_s >= -DRAWN_S
    return StopCurves(
        arm.name,
        time_s[drawn],
        sync_index[drawn],
        values["q_rad"][drawn],
        following_error_rad(reported, values["q_rad"])[drawn],
        _speed(values["q_rad"], time_s)[drawn],
        values["joint_torque_nm"][drawn],
        values["modelled_torque_nm"][drawn],
    )


def _speed(q_rad: Floats, time_s: Floats) -> Floats:
    """Return speeds (n, N) [rad/s] over `SPEED_SPAN_S`, at least one SYNC; NaN at the first sample."""
    if not len(time_s):
        return q_rad
    now = np.arange(len(time_s))
    earlier = np.minimum(np.searchsorted(time_s, time_s - SPEED_SPAN_S, side="left"), now - 1)
    known = earlier >= 0
    speed = np.full_like(q_rad, np.nan)
    passed_s = time_s[known] - time_s[earlier[known]]
    speed[known] = (q_rad[known] - q_rad[earlier[known]]) / np.where(passed_s > 0.0, passed_s, np.nan)[:, None]
    return speed


def _last(curves: StopCurves) -> list[tuple[str, list[str]]]:
    """Return the state of the axes at the stop: the last known values."""
    rows = (
        ("position [rad]", curves.q_rad, _place),
        ("position [deg]", DEGREES * curves.q_rad, _place),
        ("speed [rad/s]", curves.speed_rad_s, notation.rounded),
        ("speed [deg/s]", DEGREES * curves.speed_rad_s, notation.rounded),
        ("following error [mrad]", MRAD * curves.error_rad, notation.rounded),
        ("following error [deg]", DEGREES * curves.error_rad, notation.rounded),
        ("torque [Nm]", curves.torque_nm, notation.rounded),
        ("model [Nm]", curves.model_nm, notation.rounded),
    )
    return [(said, [_known_last(column, text) for column in values.T]) for said, values, text in rows]


def _place(angle: float) -> str:
    return notation.plain(angle, 3)


def _known_last(values: Floats, text: Callable[[float], str]) -> str:
    known = values[np.isfinite(values)]
    return text(float(known[-1])) if len(known) else notation.plain(None)


def _line(reported: DecodedEvent, drives: dict[int, BoxDrive], arms: int) -> tuple[str, str, str]:
    """Return time, source, event."""
    time_s = f"{reported.time_s:+.3f}".replace("-", "\N{MINUS SIGN}")
    return time_s, notation.listing([_who(node, drives, arms) for node in reported.nodes]), reported.what


def _who(node: int, drives: dict[int, BoxDrive], arms: int) -> str:
    drive = drives.get(node)
    if drive is None:
        return f"node {node}" if node else "every node"
    name = f"{notation.axis(drive.joint)} (node {node})"
    return f"{drive.arm} {name}" if arms > 1 else name


LEFT = 58.0
STATES_SIZE = (1030.0, 24.0)
#: Number of time intervals per line; the least and largest value of each are drawn.
PIECES = 400
#: Share of the figure after the stop.
AFTER_SHARE = 0.04
#: Least half range of a figure, so that encoder counts at rest are not enlarged.
LEAST_NM, LEAST_MRAD, LEAST_RAD_S = 0.1, 0.1, 0.02
TIME = "time from the stop [s]"
RUNS, FAILED = "operation enabled", frozenset({"fault", "fault reaction active", "no state of CiA 402"})


@dataclass(frozen=True, slots=True, eq=False)
class StopCurves:
    """Last samples of one arm: arrays of shape (n,) and (n, N); time is 0 at the stop."""

    arm: str
    time_s: Floats
    sync_index: NDArray[np.int64]
    q_rad: Floats
    error_rad: Floats
    speed_rad_s: Floats
    torque_nm: Floats
    model_nm: Floats


def axis_figures(curves: StopCurves) -> list[list[tuple[str, Markup]]]:
    """Draw for each axis: torque with model, following error, speed."""
    rows = []
    for axis in range(curves.q_rad.shape[1] if len(curves.time_s) else 0):
        name = notation.axis(axis + 1)
        torque, model = curves.torque_nm[:, axis], curves.model_nm[:, axis]
        first_s = min(float(curves.time_s[0]), -1e-3)
        panels = []
        for label, lines, least in (
            ("torque [Nm]", [(model, "model-line"), (torque, "force")], LEAST_NM),
            ("error [mrad]", [(MRAD * curves.error_rad[:, axis], "force")], LEAST_MRAD),
            ("speed [rad/s]", [(curves.speed_rad_s[:, axis], "force")], LEAST_RAD_S),
        ):
            chart = line_chart(
                f"{name} {label.partition(' [')[0]} over the last seconds before the stop",
                (TIME, f"{name} {label}"),
                [
                    ([time_s for time_s, _ in stretch], [value for _, value in stretch], kind)
                    for values, kind in lines
                    for stretch in courses(curves.time_s, curves.sync_index, values)
                ],
                x_range=(first_s, -AFTER_SHARE * first_s),
                y_range=limits(np.concatenate([values for values, _ in lines]).tolist(), include=(-least, least)),
                left=LEFT,
                vertical=0.0,
            )
            panels.append(("", chart))
        rows.append(panels)
    return rows


def courses(time_s: Floats, sync_index: NDArray[np.int64], values: Floats) -> list[list[Point]]:
    """Draw lines through values (n,), interrupted at SYNCs without value.

    Of many values the least and largest per interval.
    """
    known = np.isfinite(values)
    time_s, sync_index, values = time_s[known], sync_index[known], values[known]
    if not len(values):
        return []
    piece = np.floor((time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-9) * PIECES)
    chosen = np.zeros(len(values), dtype=bool)
    for places in np.split(np.arange(len(values)), np.flatnonzero(np.diff(piece)) + 1):
        chosen[[places[0], places[-1], places[np.argmin(values[places])], places[np.argmax(values[places])]]] = True
    run = np.concatenate([[0], np.cumsum(np.diff(sync_index) != 1)])
    return [
        list(zip(time_s[chosen & (run == part)].tolist(), values[chosen & (run == part)].tolist(), strict=True))
        for part in range(int(run[-1]) + 1)
    ]


def states_figure(box: BlackBox, drives: dict[int, BoxDrive], drawn_s: float) -> Markup | None:
    """Draw the drive states over time, one line per drive; empty while a drive did not respond. None without data."""
    spans = {node: state_spans(box, node) for node in drives}
    received = [span for found in spans.values() for span in found]
    if not received:
        return None
    begin_s = max(-drawn_s, min(min(span.begin_s for span in received), -1e-3))
    end_s = min(max(span.end_s for span in received), -0.25 * begin_s)
    x_range = (begin_s, max(end_s, -AFTER_SHARE * begin_s))
    several = len({drive.arm for drive in drives.values()}) > 1
    names = [
        f"{drive.arm if several else ''} {notation.axis(drive.joint)} (node {node})".strip()
        for node, drive in drives.items()
    ]
    panel = row_panel(names, x_range, TIME, size=STATES_SIZE, left=110.0, count=8)
    for row, node in enumerate(drives):
        for span in spans[node]:
            if span.end_s >= x_range[0] and span.begin_s <= x_range[1]:
                state = span.state.value
                kind = "state-runs" if state == RUNS else "state-failed" if state in FAILED else "state-other"
                panel.box((span.begin_s, span.end_s), (row - 0.32, row + 0.32), kind)
    panel.vertical(0.0, "limit")
    return panel.svg("Drive states before and after the stop")
