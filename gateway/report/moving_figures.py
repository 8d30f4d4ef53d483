"""Figures of a moving identification: friction over speed, one period of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

from markupsafe import Markup

from gateway.report import notation
from gateway.report.moving_section import DrawnPeriod, Floats, FrictionView
from gateway.report.svg import Panel, limits

WIDTH, HEIGHT = 330.0, 170.0
LEFT = 52.0


def sliding_figure(view: FrictionView) -> tuple[str, Markup]:
    """Draw friction over speed in both directions, with its 95 % band and measured samples."""
    fastest = view.speed_rad_s[-1]
    half = view.half_nm or (0.0,) * len(view.torque_nm)
    top = [value + more for value, more in zip(view.torque_nm, half, strict=True)]
    y_range = limits([*top, *(-value for value in top), *(y for _, y in view.points)], include=(0.0,))
    panel = Panel(WIDTH, 200.0, limits((-fastest, fastest, *(x for x, _ in view.points)), pad=0.03), y_range, left=LEFT)
    name = notation.axis(view.joint)
    panel.y_axis(f"{name} friction [Nm]")
    panel.x_axis("joint speed [rad/s]", 4)
    for x, y in view.points:
        panel.dot(x, y, "dot faint", "", 1.8)
    for sense in (-1.0, 1.0):
        speed = [sense * value for value in view.speed_rad_s]
        if view.half_nm:
            low, high = (
                [sense * (value + side * more) for value, more in zip(view.torque_nm, half, strict=True)]
                for side in (-1.0, 1.0)
            )
            panel.area(speed, low, high, "confidence")
        panel.polyline(list(zip(speed, (sense * value for value in view.torque_nm), strict=True)), "curve")
    return "", panel.svg(f"Friction of {name} over its speed")


def period_figures(period: DrawnPeriod) -> list[list[tuple[str, Markup]]]:
    """Draw for each measured axis over time: position, torque with model, residual."""
    return [[_position(period, axis), _torque(period, axis), _residual(period, axis)] for axis in period.joints]


def _panel(period: DrawnPeriod, values: Sequence[float], label: str) -> Panel:
    panel = Panel(WIDTH, HEIGHT, (0.0, float(period.time_s[-1])), limits(values), left=LEFT)
    panel.y_axis(label)
    panel.x_axis("time in the period [s]", 4)
    return panel


def _over(period: DrawnPeriod, column: Floats) -> list[tuple[float, float]]:
    return list(zip(period.time_s.tolist(), column.tolist(), strict=True))


def _lines(panel: Panel, points: Sequence[tuple[float, float]], kind: str) -> None:
    """Draw a line for each interval in which the axis moves; torque at standstill is not modelled."""
    for known, stretch in groupby(points, key=lambda point: math.isfinite(point[1])):
        if known:
            panel.polyline(list(stretch), kind)


def _position(period: DrawnPeriod, axis: int) -> tuple[str, Markup]:
    degrees = period.q_rad[:, axis] * (180.0 / math.pi)
    name = notation.axis(axis + 1)
    panel = _panel(period, degrees.tolist(), f"{name} position [deg]")
    panel.polyline(_over(period, degrees), "curve")
    return "", panel.svg(f"Position of {name} over one period")


def _torque(period: DrawnPeriod, axis: int) -> tuple[str, Markup]:
    measured, model = period.tau_nm[:, axis], period.model_nm[:, axis]
    name = notation.axis(axis + 1)
    panel = _panel(period, [*measured.tolist(), *model.tolist()], f"{name} torque [Nm]")
    for time_s, value in _over(period, measured):
        if math.isfinite(value):
            panel.dot(time_s, value, "dot faint", "", 1.8)
    _lines(panel, _over(period, model), "model-line")
    return "", panel.svg(f"Torque of {name} over one period, measured and modelled")


def _residual(period: DrawnPeriod, axis: int) -> tuple[str, Markup]:
    left = period.tau_nm[:, axis] - period.model_nm[:, axis]
    name = notation.axis(axis + 1)
    panel = _panel(period, [*left.tolist(), 0.0], f"{name} residual [Nm]")
    _lines(panel, _over(period, left), "force")
    return "", panel.svg(f"Measured minus modelled torque of {name} over one period")
