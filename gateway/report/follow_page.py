"""Page of a feedforward comparison: the settings side by side, axis by axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from gateway.report import notation
from gateway.report.page import Head, drive_rows, made, page, status_of
from gateway.report.svg import Panel, limits, line_chart
from gateway.result.follow import IDENTIFIED, MAXIMUM, OFF, ErrorCurve, FollowResult, TorqueCurve, TrendCloud
from gateway.result.numerals import SAID, with_interval

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


def render_follow(result: FollowResult) -> str:
    """Return the HTML page of a comparison."""
    path = f"{result.path.name}, {result.path.duration_s:.1f} s"
    about = (("robot", result.robot), ("cell", result.cell), ("arm", result.arm), ("path", path), *made(result.origin))
    trend = result.trend if result.trend is not None and math.isfinite(result.trend.scale) else None
    rows = []
    for setting in result.settings:
        load = setting.load
        if load is None:
            rows.append((setting.name, notation.plain(None), notation.plain(None), "no offsets", notation.plain(None)))
            continue
        mass = interval_of(load.mass_kg, load.mass_std_kg)
        com = " ".join(notation.rounded(MRAD * value) for value in load.com_m)
        rows.append((setting.name, mass, com, load.source, load.inertia_source))
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
        fed=rows,
        sources=[
            (
                notation.axis(joint),
                axis.rotor_inertia,
                axis.gear_losses,
                axis.coulomb,
                axis.viscous,
                axis.velocity_share,
            )
            for joint, axis in enumerate(result.model.axes, start=1)
        ],
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
                (
                    setting.name,
                    NAMES.get(setting.name, setting.name),
                    [notation.rounded(factor * value) for value in getattr(setting, key)],
                )
                for setting in result.settings
            ],
        )
        for said, key, factor in QUANTITIES
    ]


def interval_of(value: float, std: float) -> str:
    """Format a number with its 95 % interval, if known."""
    return f"{with_interval(value, std)} ({SAID})" if std > 0 else notation.rounded(value)


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
    panel.y_axis("peak following error [mrad]", log=True)
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
    shown = " and ".join(NAMES.get(name, name) for name in curves)
    return line_chart(
        f"Following error of axis {axis + 1} over time, {shown}",
        ("time [s]", f"{notation.axis(axis + 1)} error [mrad]"),
        [(curve.time_s, _errors([curve], axis), f"trace {name}") for name, curve in curves.items()],
        x_range=(0.0, max(curve.time_s[-1] for curve in curves.values())),
        y_range=scale,
    )


def _torque(curve: TorqueCurve) -> tuple[str, Markup]:
    name = notation.axis(curve.axis)
    return name, line_chart(
        f"Torque of {name}: measured, and torque offset",
        ("time [s]", "motor torque [Nm]"),
        [(curve.time_s, curve.measured_nm, "model-line"), (curve.time_s, curve.offset_nm, "trace identified")],
        x_range=(0.0, curve.time_s[-1]),
        size=(470.0, 200.0),
    )


def _cloud(cloud: TrendCloud, slope: float) -> tuple[str, Markup]:
    """Draw the residual over the feedforward torque of the load, with its trend."""
    name, ends = notation.axis(cloud.axis), (min(cloud.load_nm), max(cloud.load_nm))
    return name, line_chart(
        f"Torque residual of {name} over the feedforward torque of the load, with the trend",
        ("feedforward torque of the load [Nm]", "residual [Nm]"),
        [(ends, [slope * end for end in ends], "trend-line")],
        dots=[(cloud.load_nm, cloud.residual_nm, "cloud", 2.2, "")],
        x_range=limits(cloud.load_nm),
        y_range=limits(cloud.residual_nm, include=(0.0,)),
        size=(470.0, 230.0),
    )
