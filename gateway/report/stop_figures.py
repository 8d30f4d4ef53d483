"""Figures of the last seconds before a stop: torque, following error, speed of each axis, drive states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gateway.data.blackbox.box import BlackBox
from gateway.data.blackbox.frame_decoder import BoxDrive, state_spans
from gateway.report import notation
from gateway.report.svg import Panel, Point, limits

Floats = NDArray[np.float64]

WIDTH, HEIGHT, LEFT = 330.0, 170.0, 58.0
STATES_WIDTH, ROW_PX = 1030.0, 24.0
#: Number of time intervals per line; the least and largest value of each are drawn.
PIECES = 400
#: Share of the figure after the stop.
AFTER_SHARE = 0.04
MRAD = 1000.0
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
        drawn = (
            (f"{name} torque [Nm]", [(model, "model-line"), (torque, "force")], LEAST_NM),
            (f"{name} error [mrad]", [(MRAD * curves.error_rad[:, axis], "force")], LEAST_MRAD),
            (f"{name} speed [rad/s]", [(curves.speed_rad_s[:, axis], "force")], LEAST_RAD_S),
        )
        rows.append([_panel(curves, *each) for each in drawn])
    return rows


def _panel(curves: StopCurves, label: str, lines: list[tuple[Floats, str]], least: float) -> tuple[str, Markup]:
    first_s = min(float(curves.time_s[0]), -1e-3)
    y_range = limits(np.concatenate([values for values, _ in lines]).tolist(), include=(-least, least))
    panel = Panel(WIDTH, HEIGHT, (first_s, -AFTER_SHARE * first_s), y_range, left=LEFT)
    panel.y_axis(label)
    panel.x_axis(TIME, 4)
    panel.segment((0.0, y_range[0]), (0.0, y_range[1]), "limit")
    for values, kind in lines:
        for stretch in courses(curves.time_s, curves.sync_index, values):
            panel.polyline(stretch, kind)
    return "", panel.svg(f"{label.partition(' [')[0]} over the last seconds before the stop")


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
    height = ROW_PX * len(drives) + 50.0
    x_range = (begin_s, max(end_s, -AFTER_SHARE * begin_s))
    panel = Panel(STATES_WIDTH, height, x_range, (len(drives) - 0.5, -0.5), left=110.0, top=8.0)
    panel.x_axis(TIME, 8)
    several = len({drive.arm for drive in drives.values()}) > 1
    for row, (node, drive) in enumerate(drives.items()):
        who = f"{drive.arm} {notation.axis(drive.joint)}" if several else notation.axis(drive.joint)
        panel.text(panel.left - 8, panel.y(row) + 4, f"{who} (node {node})", "name end")
        for span in spans[node]:
            if span.end_s >= x_range[0] and span.begin_s <= x_range[1]:
                panel.box((span.begin_s, span.end_s), (row - 0.32, row + 0.32), _kind(span.state.value))
    panel.segment((0.0, len(drives) - 0.5), (0.0, -0.5), "limit")
    return panel.svg("Drive states before and after the stop")


def _kind(state: str) -> str:
    return "state-runs" if state == RUNS else "state-failed" if state in FAILED else "state-other"
