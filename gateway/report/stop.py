"""Page of a stop: the last seconds of the black box per axis, and bus events; t = 0 is the stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gateway.data.blackbox.box import ArmBox, BlackBox
from gateway.data.blackbox.frame_decoder import BoxDrive, DecodedEvent, decoded_events, drives_of, sample_times_s
from gateway.data.sample import following_error_rad
from gateway.report import notation, stop_figures
from gateway.report.page import Head, page
from gateway.report.stop_figures import Floats, StopCurves

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
    before, after, left_out = _lines(decoded_events(box))
    curves = [curves_of(arm, time_s, box.sync_index) for arm in box.arms]
    about = (("recording", box.recording), ("", box.created), ("", box.software))
    return page(
        "stop.html.j2",
        Head(f"Stop: {box.recording}", "Before the stop", about),
        reason=box.reason,
        span_s=notation.plain(float(np.ptp(time_s)) if len(time_s) else 0.0, 1),
        drawn_s=f"{DRAWN_S:g}",
        states=stop_figures.states_figure(box, drives, DRAWN_S) if drives else None,
        arms=[
            (f"Arm {curve.arm}" if len(curves) > 1 else "Axis by axis", _last(curve), stop_figures.axis_figures(curve))
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


def _lines(reported: Sequence[DecodedEvent]) -> tuple[list[DecodedEvent], list[DecodedEvent], int]:
    """Return the events closest to the stop, before and after it, and the number of others."""
    before = [each for each in reported if each.time_s <= 0.0]
    after = [each for each in reported if each.time_s > 0.0]
    shown = before[-MOST_LINES:], after[:MOST_LINES]
    return *shown, len(reported) - sum(map(len, shown))


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
