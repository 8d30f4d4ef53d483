"""Page of a feedforward comparison: the settings side by side, axis by axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from gateway.report import notation
from gateway.report.page import Head, drive_rows, made, page, status_of
from gateway.report.svg import Panel, limits
from gateway.result.follow import IDENTIFIED, MAXIMUM, OFF, ErrorCurve, FollowResult, TorqueCurve, TrendCloud
from gateway.result.interval import SAID
from gateway.result.numerals import with_interval

NAMES = {OFF: "off", MAXIMUM: "maximum load assumed", IDENTIFIED: "identified load"}
#: Axes named in the headline: those that carry gravity.
HEADLINE_AXES = (1, 2)
MRAD = 1000.0
#: Text with unit of a quantity, its key, factor to the unit.
QUANTITIES = (
    ("peak error [mrad]", "peak_rad", MRAD),
    ("rms error [mrad]", "rms_rad", MRAD),
    ("lag [ms]", "lag_s", 1000.0),
    ("overshoot [mrad]", "overshoot_rad", MRAD),
)
WIDTH, HEIGHT = 330.0, 170.0


def render_follow(result: FollowResult) -> str:
    """Return the HTML page of a comparison."""
    path = f"{result.path.name}, {result.path.duration_s:.1f} s"
    about = (("robot", result.robot), ("cell", result.cell), ("arm", result.arm), ("path", path), *made(result.origin))
    trend = result.trend if result.trend is not None and math.isfinite(result.trend.scale) else None
    return page(
        "follow.html.j2",
        Head(f"Feedforward: {result.robot}", "Feedforward report", about),
        result=result,
        interval=with_interval,
        names=[(setting.name, NAMES.get(setting.name, setting.name)) for setting in result.settings],
        status=status_of(result.findings),
        headline=headline(result),
        figures=figure_rows(result),
        axis_names=[notation.axis(axis + 1) for axis in _axes(result)],
        fed=_fed(result),
        sources=_sources(result),
        drive_rows=[] if result.origin is None else drive_rows(result.origin.drives),
        bars=_bars(result),
        curves=_curves(result),
        zoom=_zoom(result),
        torque=[_torque(curve) for curve in result.series.torque],
        trend=trend,
        clouds=[] if trend is None else [_cloud(cloud, trend.scale) for cloud in result.series.trend],
    )


def headline(result: FollowResult) -> str:
    """Summarise the result in one line: peak error of the axes that carry gravity, for each setting."""
    if result.setting(OFF) is None or result.setting(IDENTIFIED) is None:
        return "Following error"
    shown = [setting for name in NAMES if (setting := result.setting(name)) is not None]
    parts = [
        f"{notation.axis(axis + 1)} "
        f"{' → '.join(notation.rounded(MRAD * setting.peak_rad[axis]) for setting in shown)} mrad"
        for axis in HEADLINE_AXES
    ]
    return "Peak following error: " + "; ".join(parts)


def figure_rows(result: FollowResult) -> list[tuple[str, list[tuple[str, str, list[str]]]]]:
    """Return tables: quantity; for each setting its name, its text, and a number per axis."""
    return [
        (
            said,
            [
                (setting.name, NAMES.get(setting.name, setting.name), _numbers(getattr(setting, key), factor))
                for setting in result.settings
            ],
        )
        for said, key, factor in QUANTITIES
    ]


def _numbers(values: Sequence[float], factor: float) -> list[str]:
    return [notation.rounded(factor * value) for value in values]


def _fed(result: FollowResult) -> list[tuple[str, ...]]:
    """Return the load used by each setting."""
    rows = []
    for setting in result.settings:
        load = setting.load
        if load is None:
            rows.append((setting.name, notation.plain(None), notation.plain(None), "no offsets", notation.plain(None)))
            continue
        mass = interval_of(load.mass_kg, load.mass_std_kg)
        com = " ".join(notation.rounded(MRAD * value) for value in load.com_m)
        rows.append((setting.name, mass, com, load.source, load.inertia_source))
    return rows


def interval_of(value: float, std: float) -> str:
    """Format a number with its 95 % interval, if known."""
    return f"{with_interval(value, std)} ({SAID})" if std > 0 else notation.rounded(value)


def _sources(result: FollowResult) -> list[tuple[str, ...]]:
    """Return the source of the terms of each axis."""
    return [
        (notation.axis(joint), axis.rotor_inertia, axis.gear_losses, axis.coulomb, axis.viscous, axis.velocity_share)
        for joint, axis in enumerate(result.model.axes, start=1)
    ]


def _axes(result: FollowResult) -> range:
    return range(min((len(setting.peak_rad) for setting in result.settings), default=0))


def _bars(result: FollowResult) -> Markup:
    """Draw the peak of each axis for each setting on a logarithmic scale."""
    axes, count = _axes(result), len(result.settings)
    logs = [
        [math.log10(max(MRAD * value, 1e-6)) if notation.known(value) else math.nan for value in setting.peak_rad]
        for setting in result.settings
    ]
    low_log, high_log = limits([value for row in logs for value in row], pad=0.0)
    low, high = math.floor(low_log), math.ceil(high_log)
    high = max(high, low + 1)
    panel = Panel(720.0, 230.0, (0.4, len(axes) + 0.6), (float(low), float(high)))
    for power in range(low, high + 1):
        panel.segment((panel.x_range[0], power), (panel.x_range[1], power), "grid")
        panel.text(panel.left - 6, panel.y(power) + 3.5, f"{10.0**power:g}", "tick end")
    panel.y_label("peak following error [mrad]")
    for axis in axes:
        panel.text(panel.x(axis + 1.0), panel.height - panel.bottom + 16, notation.axis(axis + 1), "tick mid")
        for place, (setting, row) in enumerate(zip(result.settings, logs, strict=True)):
            x = axis + 1.0 + 0.2 * (place - (count - 1) / 2)
            if math.isfinite(row[axis]):
                panel.segment((x, low), (x, row[axis]), f"peak {setting.name}")
    return panel.svg("Peak following error of each axis and setting, logarithmic scale")


def _curves(result: FollowResult) -> list[list[tuple[str, Markup]]]:
    """Draw one panel per axis and setting, all with the same scale."""
    error = result.series.error
    rows = []
    for axis in _axes(result):
        scale = limits(_errors(list(error.values()), axis))
        rows.append(
            [
                (f"{notation.axis(axis + 1)}, {NAMES.get(name, name)}", _error_panel({name: curve}, axis, scale))
                for name, curve in error.items()
            ]
        )
    return rows


def _zoom(result: FollowResult) -> list[tuple[str, Markup]]:
    """Draw per axis the settings with feedforward in one panel, enlarged."""
    fed = {name: curve for name, curve in result.series.error.items() if name != OFF}
    if not fed:
        return []
    scales = [limits(_errors(list(fed.values()), axis)) for axis in _axes(result)]
    return [("", _error_panel(fed, axis, scale)) for axis, scale in enumerate(scales)]


def _errors(curves: Sequence[ErrorCurve], axis: int) -> list[float]:
    return [MRAD * value for curve in curves for value in curve.error_rad[axis]]


def _error_panel(curves: dict[str, ErrorCurve], axis: int, scale: tuple[float, float]) -> Markup:
    panel = Panel(WIDTH, HEIGHT, (0.0, max(curve.time_s[-1] for curve in curves.values())), scale)
    panel.y_axis(f"{notation.axis(axis + 1)} error [mrad]")
    panel.x_axis("time [s]")
    for name, curve in curves.items():
        panel.polyline(list(zip(curve.time_s, _errors([curve], axis), strict=True)), f"trace {name}")
    shown = " and ".join(NAMES.get(name, name) for name in curves)
    return panel.svg(f"Following error of axis {axis + 1} over time, {shown}")


def _torque(curve: TorqueCurve) -> tuple[str, Markup]:
    panel = Panel(470.0, 200.0, (0.0, curve.time_s[-1]), limits([*curve.measured_nm, *curve.offset_nm]))
    panel.y_axis("motor torque [Nm]")
    panel.x_axis("time [s]")
    for values, kind in ((curve.measured_nm, "model-line"), (curve.offset_nm, "trace identified")):
        panel.polyline(list(zip(curve.time_s, values, strict=True)), kind)
    name = notation.axis(curve.axis)
    return name, panel.svg(f"Torque of {name}: measured, and torque offset")


def _cloud(cloud: TrendCloud, slope: float) -> tuple[str, Markup]:
    """Draw the residual over the feedforward torque of the load, with its trend."""
    panel = Panel(470.0, 230.0, limits(cloud.load_nm), limits(cloud.residual_nm, include=(0.0,)))
    panel.y_axis("residual [Nm]")
    panel.x_axis("feedforward torque of the load [Nm]")
    for load, residual in zip(cloud.load_nm, cloud.residual_nm, strict=True):
        panel.dot(load, residual, "cloud", radius=2.2)
    low, high = min(cloud.load_nm), max(cloud.load_nm)
    panel.segment((low, slope * low), (high, slope * high), "trend-line")
    name = notation.axis(cloud.axis)
    return name, panel.svg(f"Torque residual of {name} over the feedforward torque of the load, with the trend")
