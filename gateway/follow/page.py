"""The comparison as one HTML page: opens offline, prints on paper. The three settings stand side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gateway.follow.settings import IDENTIFIED, MAXIMUM, OFF
from gateway.report.svg import Panel, limits

Json = Mapping[str, Any]
AXES = range(6)
NAMES = {OFF: "off", MAXIMUM: "maximum load assumed", IDENTIFIED: "identified load"}
COLOURS = {OFF: "#d2660a", MAXIMUM: "#7a4bc4", IDENTIFIED: "#0a63c2"}
MRAD = 1000.0
WIDTH, HEIGHT = 330.0, 170.0
STYLE = """
svg .curve.off, svg .bar.off { stroke: #d2660a; } svg .curve.maximum, svg .bar.maximum { stroke: #7a4bc4; }
svg .curve.identified, svg .bar.identified { stroke: #0a63c2; }
svg .bar { fill: none; stroke-width: 9; } svg .curve { stroke-width: 1.5; }
svg .trend-line { stroke: #b9202a; stroke-width: 2; } svg .cloud { fill: #0a63c2; fill-opacity: 0.35; }
.three { display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); gap: 4px 14px; break-inside: avoid; }
.six { display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); gap: 10px 14px; }
.k-off { width: 18px; border-top: 3px solid #d2660a; } .k-maximum { width: 18px; border-top: 3px solid #7a4bc4; }
.k-identified { width: 18px; border-top: 3px solid #0a63c2; }
td.off { color: #a14c05; } td.maximum { color: #5f36a3; } td.identified { color: #0a4f9c; font-weight: 600; }
"""


def page(body: Json) -> str:
    """HTML text of a comparison.

    Parameters
    ----------
    body : mapping
        As `gateway.follow.body.body_of` gives it.
    """
    environment = Environment(
        loader=PackageLoader("gateway", "follow"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    style = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8") + STYLE
    names = [setting["name"] for setting in body["settings"]]
    failed = [item for item in body["findings"] if item["severity"] == "fail"]
    return environment.get_template("follow.html.j2").render(
        body=body,
        css=Markup(style),
        names=[(name, NAMES.get(name, name)) for name in names],
        status="bad" if failed else "good",
        headline=headline(body),
        figures=figure_rows(body),
        bars=_bars(body),
        curves=_curves(body, names),
        zoom=_zoom(body),
        torque=[_torque(item) for item in body["series"]["torque"]],
        trend=[_trend(body, item) for item in body["series"]["trend"]],
        number=number,
    )


def headline(body: Json) -> str:
    """The result in one line: the axis that gains most by its following error without feedforward."""
    by_name = {setting["name"]: setting for setting in body["settings"]}
    if OFF not in by_name or IDENTIFIED not in by_name:
        return "Following error"
    axes = (1, 2)
    parts = []
    for axis in axes:
        values = [
            f"{number(MRAD * by_name[name]['peak_rad'][axis])}"
            for name in (OFF, MAXIMUM, IDENTIFIED)
            if name in by_name
        ]
        parts.append(f"J{axis + 1} {' > '.join(values)} mrad")
    return "Peak following error: " + "; ".join(parts)


def figure_rows(body: Json) -> list[dict[str, Any]]:
    """Rows of the table of figures: one per axis, a triple of texts per quantity."""
    settings = body["settings"]
    quantities = (("peak_rad", MRAD), ("rms_rad", MRAD), ("lag_s", 1000.0), ("overshoot_rad", MRAD))
    return [
        {
            "axis": f"J{axis + 1}",
            "cells": [
                [(setting["name"], number(_times(setting[key][axis], scale))) for setting in settings]
                for key, scale in quantities
            ],
        }
        for axis in AXES
    ]


def number(value: float | None) -> str:
    """Three significant digits, a dash for what is not known."""
    if value is None:
        return "\N{EN DASH}"
    if value == 0:
        return "0"
    digits = max(0, min(3, 2 - math.floor(math.log10(abs(value)))))
    text = f"{value:.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}") if float(text) else text.lstrip("-")


def _times(value: float | None, scale: float) -> float | None:
    return None if value is None else scale * value


def _bars(body: Json) -> Markup:
    """Peak of each axis under each setting, on a scale of powers of ten."""
    settings = body["settings"]
    logs = [[_log(MRAD * value) for value in setting["peak_rad"]] for setting in settings]
    low = math.floor(min(min(row) for row in logs))
    high = math.ceil(max(max(row) for row in logs))
    high = high if high > low else low + 1
    panel = Panel(720.0, 230.0, (0.4, 6.6), (float(low), float(high)))
    for power in range(low, high + 1):
        panel.segment((0.4, power), (6.6, power), "grid")
        panel.text(panel.left - 6, panel.y(power) + 3.5, f"{10.0**power:g}", "tick end")
    panel.add(
        f'<text class="label mid" transform="translate(12 {(panel.top + panel.height - panel.bottom) / 2:.1f}) '
        'rotate(-90)">peak following error [mrad]</text>'
    )
    for axis in AXES:
        panel.text(panel.x(axis + 1.0), panel.height - panel.bottom + 16, f"J{axis + 1}", "tick mid")
        for place, (setting, row) in enumerate(zip(settings, logs, strict=True)):
            x = axis + 1.0 + 0.2 * (place - (len(settings) - 1) / 2)
            panel.segment((x, low), (x, row[axis]), f"bar {setting['name']}")
    return panel.svg("Peak following error of every axis under every setting, logarithmic scale")


def _log(value: float) -> float:
    return math.log10(max(value, 1e-6))


def _curves(body: Json, names: Sequence[str]) -> list[tuple[str, list[Markup]]]:
    """Per axis one panel per setting, all with the same scale."""
    rows = []
    for axis in AXES:
        scale = limits(
            MRAD * (value or 0.0) for curve in body["series"]["error"].values() for value in curve["error_rad"][axis]
        )
        rows.append((f"J{axis + 1}", [_error_panel(body, [name], axis, scale) for name in names]))
    return rows


def _zoom(body: Json) -> list[Markup]:
    """Per axis the settings with feedforward in one panel, enlarged."""
    fed = [name for name in body["series"]["error"] if name != OFF]
    panels = []
    for axis in AXES:
        values = [MRAD * (v or 0.0) for name in fed for v in body["series"]["error"][name]["error_rad"][axis]]
        panels.append(_error_panel(body, fed, axis, limits(values)))
    return panels


def _error_panel(body: Json, names: Sequence[str], axis: int, scale: tuple[float, float]) -> Markup:
    curves = body["series"]["error"]
    last = max(curves[name]["time_s"][-1] for name in names)
    panel = Panel(WIDTH, HEIGHT, (0.0, last), scale)
    panel.y_axis(f"J{axis + 1} error [mrad]")
    panel.x_axis("time [s]")
    for name in names:
        points = zip(curves[name]["time_s"], curves[name]["error_rad"][axis], strict=True)
        panel.polyline([(t, MRAD * value) for t, value in points if value is not None], f"curve {name}")
    told = " and ".join(NAMES.get(name, name) for name in names)
    return panel.svg(f"Following error of axis {axis + 1} over time, {told}")


def _torque(item: Json) -> tuple[str, Markup]:
    both = [value for key in ("measured_nm", "offset_nm") for value in item[key] if value is not None]
    panel = Panel(470.0, 200.0, (0.0, item["time_s"][-1]), limits(both))
    panel.y_axis("motor torque [Nm]")
    panel.x_axis("time [s]")
    for key, kind in (("measured_nm", "model-line"), ("offset_nm", "curve identified")):
        points = [(t, value) for t, value in zip(item["time_s"], item[key], strict=True) if value is not None]
        panel.polyline(points, kind)
    name = f"J{item['axis']}"
    return name, panel.svg(f"Torque of {name}: measured, and the offset that was fed")


def _trend(body: Json, item: Json) -> tuple[str, Markup]:
    """Residual over the torque of the load as fed, and the trend through it."""
    loads, residuals = item["load_nm"], item["residual_nm"]
    x_range, y_range = limits(loads), limits(residuals, include=(0.0,))
    panel = Panel(470.0, 230.0, x_range, y_range)
    panel.y_axis("residual [Nm]")
    panel.x_axis("torque of the load as fed [Nm]")
    for load, residual in zip(loads, residuals, strict=True):
        panel.dot(load, residual, "cloud", radius=2.2)
    if body["trend"] is not None and body["trend"]["scale"] is not None:
        slope = body["trend"]["scale"]
        panel.segment((min(loads), slope * min(loads)), (max(loads), slope * max(loads)), "trend-line")
    name = f"J{item['axis']}"
    return name, panel.svg(f"Torque residual of {name} over the torque of the load as fed, with the trend")
