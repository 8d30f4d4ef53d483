"""Figures per axis and visit: measured and modelled torque, and residual."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from gateway.report import notation
from gateway.report.axis_series import Layout, cell, layout, measured_axes
from gateway.report.svg import Panel, limits
from gateway.result.drawn import FRESH, Drawn
from gateway.result.result import Result, Rows

WIDTH, HEIGHT = 470.0, 210.0
LOAD_CLASSES = ("load-0", "load-1", "load-2", "load-3", "load-4")
#: Width of a digit of a tick label [px].
CHARACTER_PX = 8.0


def torque_figures(result: Result) -> list[tuple[str, Markup]]:
    """Draw per measured axis: torque of each visit with its friction band, the model as a dash."""
    if result.rows is None or not result.rows.tau_nm:
        return []
    plan, colours = _plan(result, result.rows), load_classes(result)
    return [(notation.axis(axis + 1), _torque(result.rows, plan, colours, axis)) for axis in measured_axes(result.rows)]


def residual_figures(result: Result) -> list[tuple[str, Markup]]:
    """Draw per measured axis: measured minus model of each visit, before and after, with the noise floor."""
    rows = result.rows
    if rows is None or not rows.tau_nm:
        return []
    plan = _plan(result, rows)
    before = (result.data or Drawn()).model_before_nm
    figures = []
    for axis in measured_axes(rows):
        after_nm = [cell(rows.tau_nm, row, axis) - cell(rows.model_nm, row, axis) for row in plan.order]
        before_nm = [cell(rows.tau_nm, row, axis) - cell(before, row, axis) for row in plan.order]
        if any(map(math.isfinite, after_nm)):
            floor = cell((result.noise_floor_nm,), 0, axis)
            figures.append((notation.axis(axis + 1), _residual(plan, (before_nm, after_nm), floor, axis)))
    return figures


def load_classes(result: Result) -> dict[str, str]:
    """Return the CSS class of each load label, the unloaded arm first."""
    measured = () if result.rows is None else result.rows.load
    labels = list(dict.fromkeys([*measured, *(load.label for load in result.loads)]))
    bare = [label for label in labels if label == "none"]
    rest = [label for label in labels if label != "none"]
    named = dict.fromkeys(bare, LOAD_CLASSES[0])
    return named | {label: LOAD_CLASSES[1 + index % (len(LOAD_CLASSES) - 1)] for index, label in enumerate(rest)}


def _plan(result: Result, rows: Rows) -> Layout:
    return layout(rows, () if result.data is None else result.data.role)


def _torque(rows: Rows, plan: Layout, colours: Mapping[str, str], axis: int) -> Markup:
    tau, model, band = (
        [cell(table, row, axis) for row in plan.order] for table in (rows.tau_nm, rows.model_nm, rows.band_nm)
    )
    band = [half if math.isfinite(half) else 0.0 for half in band]
    spread = [value + side * half for value, half in zip(tau, band, strict=True) for side in (-1, 1)]
    panel = Panel(WIDTH, HEIGHT, plan.width, limits([*spread, *model]))
    _shade_fresh(panel, plan)
    _frame(panel, plan, f"{notation.axis(axis + 1)} torque [Nm]")
    for place, row, value, half in zip(plan.place, plan.order, tau, band, strict=True):
        if not math.isfinite(value):
            continue
        kind = colours[rows.load[row]]
        if plan.dense:
            panel.dot(place, value, f"dot {kind} small", "", 1.6)
            continue
        if half > 0:
            panel.segment((place, value - half), (place, value + half), f"whisker {kind}")
        panel.dot(place, value, f"dot {kind}", _hint(rows, row, value), 3.2)
    _model_marks(panel, plan, model)
    return panel.svg(f"Torque of {notation.axis(axis + 1)}, measured and modelled, for each visit")


def _model_marks(panel: Panel, plan: Layout, model: Sequence[float]) -> None:
    places = [(place, value) for place, value in zip(plan.place, model, strict=True) if math.isfinite(value)]
    if plan.dense:
        panel.polyline(places, "model-line")
        return
    for place, value in places:
        panel.segment((place - 0.42, value), (place + 0.42, value), "model")


def _residual(plan: Layout, pair: tuple[list[float], list[float]], floor: float, axis: int) -> Markup:
    before, after = pair
    shown = [value for value in (*before, *after) if math.isfinite(value)]
    half = 2 * floor if math.isfinite(floor) else 0.0
    panel = Panel(WIDTH, HEIGHT, plan.width, limits(shown, include=(-half, half, 0.0)))
    _shade_fresh(panel, plan)
    if half:
        panel.box(plan.width, (-half, half), "floor")
    _frame(panel, plan, f"{notation.axis(axis + 1)} residual [Nm]")
    radius = 1.6 if plan.dense else 3.2
    small = " small" if plan.dense else ""
    for place, name, old, new in zip(plan.place, plan.names, before, after, strict=True):
        changed = math.isfinite(old) and abs(old - new) > 1e-3 * (panel.y_range[1] - panel.y_range[0])
        if changed and not plan.dense:
            panel.segment((place, old), (place, new), "move")
        if changed:
            panel.dot(place, old, f"dot before{small}", f"pose {name}: before {old:.3g} Nm" if name else "", radius)
        if math.isfinite(new):
            panel.dot(place, new, f"dot after{small}", f"pose {name}: {new:.3g} Nm" if name else "", radius)
    return panel.svg(f"Residual of {notation.axis(axis + 1)} for each visit")


def _shade_fresh(panel: Panel, plan: Layout) -> None:
    fresh = [place for place, role in zip(plan.place, plan.roles, strict=True) if role == FRESH]
    for start, end in _runs(fresh):
        panel.box((start - 0.5, end + 0.5), panel.y_range, "fresh")


def _frame(panel: Panel, plan: Layout, label: str) -> None:
    """Draw the vertical axis; pose numbers and load labels below the axis."""
    panel.y_axis(label)
    base = panel.height - panel.bottom
    free_px = -math.inf
    for place, name in zip(plan.place, plan.names, strict=True) if not plan.dense else ():
        centre_px, half_px = panel.x(place), 0.5 * CHARACTER_PX * len(name)
        if centre_px - half_px > free_px:
            panel.text(centre_px, base + 13, name, "tick mid")
            free_px = centre_px + half_px + 0.5 * CHARACTER_PX
    for name, start, end in plan.groups:
        panel.add(
            f'<line class="group" x1="{panel.x(start - 0.4):.1f}" x2="{panel.x(end + 0.4):.1f}" '
            f'y1="{base + 18:.1f}" y2="{base + 18:.1f}"/>'
        )
        title = notation.load(name)
        panel.text(
            panel.x((start + end) / 2),
            base + 31,
            f"{title}, in time order" if plan.dense else f"{title}, poses",
            "label mid",
        )


def _runs(places: Sequence[float]) -> list[tuple[float, float]]:
    runs: list[tuple[float, float]] = []
    for place in places:
        if runs and place - runs[-1][1] <= 1.0:
            runs[-1] = (runs[-1][0], place)
        else:
            runs.append((place, place))
    return runs


def _hint(rows: Rows, row: int, value: float) -> str:
    pose = rows.pose[row] if rows.pose else -1
    place = f"pose {pose}, " if pose >= 0 else ""
    return f"{place}load {rows.load[row]}: measured {value:.4g} Nm"
