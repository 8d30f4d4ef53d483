"""Figures of the evidence: residual over noise floor, tested effects, friction band, an effect as a curve."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from gateway.report import notation
from gateway.report.figures import cell, measured_axes
from gateway.report.svg import Panel, limits, line_chart, row_panel
from gateway.report.view import AxisQuality, Candidate
from gateway.result.drawn import Curve
from gateway.result.numerals import half_width
from gateway.result.result import Formula, Result, Rows

MOST_CANDIDATES = 14


def quality_figure(axes: Sequence[AxisQuality]) -> Markup | None:
    """Draw the residual per axis, before and after, logarithmic: over the noise floor if known, otherwise in Nm."""
    rated = [axis for axis in axes if notation.known(axis.ratio_after)]
    shown = rated or [axis for axis in axes if axis.after > 0]
    if not shown:
        return None
    pairs = [(axis.ratio_before, axis.ratio_after) if rated else (axis.before, axis.after) for axis in shown]
    values = [value for pair in pairs for value in pair if value > 0]
    low, high = _decades(min([0.7, *values]), max([3.0, *values])) if rated else _decades(min(values), max(values))
    panel = row_panel(
        [axis.name for axis in shown],
        (low, high),
        "residual RMS / noise floor [-]" if rated else "residual RMS [Nm]",
        size=(430.0, 26.0),
        mark=(0.0, "noise floor") if rated else None,
        shade=(low, 0.0) if rated else None,
        log=True,
    )
    for row, (axis, pair) in enumerate(zip(shown, pairs, strict=True)):
        before, after = (math.log10(max(value, 10**low)) if notation.known(value) else math.nan for value in pair)
        if notation.known(before) and notation.known(after) and axis.before != axis.after:
            panel.segment((before, row), (after, row), "move")
            panel.dot(before, row, "dot before", f"{axis.name} before: {axis.before:.3g} Nm", 5.5)
        if notation.known(after):
            panel.dot(after, row, "dot after", f"{axis.name}: {axis.after:.3g} Nm", 5.5)
    return panel.svg("Residual of each axis, before and after")


def evidence_figure(candidates: Sequence[Candidate]) -> Markup | None:
    """Draw the held-out error of each candidate as a bar; 1 = no improvement."""
    if not candidates:
        return None
    chosen = [item for item in candidates if item.chosen]
    shown = (chosen + [item for item in candidates if not item.chosen])[:MOST_CANDIDATES]
    top = max(1.15, min(2.0, max(item.ratio for item in shown) * 1.08))
    label = "held-out error with the effect / without it [-]"
    names, mark = [""] * len(shown), (1.0, "no improvement")
    panel = row_panel(names, (0.0, top), label, size=(560.0, 21.0), left=200.0, right=36.0, mark=mark)
    for row, item in enumerate(shown):
        panel.box((0.0, min(item.ratio, top)), (row - 0.32, row + 0.32), "bar chosen" if item.chosen else "bar")
        panel.row_name(row, item.label, "name end strong" if item.chosen else "name end")
        panel.text(panel.x(top) + 6, panel.y(row) + 4, notation.plain(item.ratio, 2), "tick")
    return panel.svg("Held-out error of each tested effect")


def per_pose_figure(result: Result, classes: Mapping[str, str]) -> Markup | None:
    """Draw the mass estimated from each pose alone, for each load, with the 95 % interval of all poses."""
    loads = [load for load in result.loads if load.per_pose_mass_kg]
    names = sorted({pose for load in loads for pose in load.per_pose_mass_kg}, key=_as_number)
    if not names:
        return None
    values = [mass for load in loads for mass in (load.mass_kg, *load.per_pose_mass_kg.values())]
    panel = Panel(430.0, 190.0, (-0.7, len(names) - 0.3), limits(values))
    panel.y_axis("mass [kg]")
    for place, name in enumerate(names):
        if len(names) <= 24 or place % 5 == 0:
            panel.text(panel.x(place), panel.height - panel.bottom + 13, name, "tick mid")
    panel.x_label("pose")
    for load in loads:
        kind, mass, half = classes.get(load.label, "load-1"), load.mass_kg, half_width(load.mass_std_kg)
        if notation.known(mass) and notation.known(half):
            panel.box(panel.x_range, (mass - half, mass + half), f"between {kind}")
            panel.horizontal(mass, f"whisker {kind}")
        for place, name in enumerate(names):
            value = load.per_pose_mass_kg.get(name, math.nan)
            if notation.known(value):
                panel.dot(place, value, f"dot {kind}", f"load {load.label}, pose {name}: {value:.2f} kg", 3.4)
    return panel.svg("Mass estimated from each pose alone")


def _as_number(name: str) -> tuple[float, str]:
    try:
        return float(name), name
    except ValueError:
        return math.inf, name


def friction_figure(result: Result) -> Markup | None:
    """Draw the friction band of each visit and its median per axis, logarithmic."""
    rows = result.rows or Rows()
    bands = {}
    for axis in measured_axes(rows):
        values = [cell(rows.band_nm, row, axis) for row in range(len(rows.band_nm))]
        bands[axis] = [value for value in values if math.isfinite(value) and value > 0]
    bands = {axis: values for axis, values in bands.items() if values}
    if not bands:
        return None
    everything = [value for values in bands.values() for value in values]
    panel = row_panel(
        [notation.axis(axis + 1) for axis in bands],
        _decades(min(everything) / 1.5, max(everything) * 1.5),
        "friction band: half the difference between the approach directions [Nm]",
        size=(760.0, 30.0),
        right=110.0,
        log=True,
    )
    for row, (axis, values) in enumerate(bands.items()):
        for value in values:
            panel.dot(math.log10(value), row, "dot faint", f"{value:.3g} Nm", 4.0)
        stated = cell((result.friction_band_nm,), 0, axis)
        middle = stated if stated > 0 else float(np.median(values))
        panel.segment((math.log10(middle), row - 0.3), (math.log10(middle), row + 0.3), "median")
        panel.text(panel.width - 104, panel.y(row) + 4, f"{notation.significant(middle)} Nm", "name")
    return panel.svg("Friction band of each axis")


def curve_figure(curve: Curve) -> Markup:
    """Draw one effect over the quantity it depends on: measured points, curve and 95 % band."""
    return line_chart(
        f"{notation.effect(curve.name)} as a curve",
        (curve.x_label + (f" [{curve.x_unit}]" if curve.x_unit else ""), curve.y_label),
        [(curve.x, curve.y, "curve")],
        dots=[(curve.points_x, curve.points_y, "dot before", 3.6, "measured: {y:.3g} Nm")],
        bands=[(curve.x, curve.low, curve.high, "confidence")] if curve.low and curve.high else (),
        x_range=limits([*curve.x, *curve.points_x], pad=0.03),
        y_range=limits([*curve.y, *curve.low, *curve.high, *curve.points_y], include=(0.0,)),
        size=(560.0, 290.0),
    )


def formula_figure(formula: Formula) -> Markup:
    """Draw the residual of each pose over what the formula of the other poses predicts for it."""
    ends = limits([*formula.predicted_nm, *formula.residual_nm])
    x_label = "predicted by the formula of the other poses"
    points = {"points_x": formula.predicted_nm, "points_y": formula.residual_nm}
    return curve_figure(Curve("formula", None, x_label, "Nm", "residual without a formula [Nm]", ends, ends, **points))


def _decades(low: float, high: float) -> tuple[float, float]:
    return math.log10(low) - 0.04, math.log10(high) + 0.06
