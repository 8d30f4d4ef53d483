"""Figures of the residual over posture and approach direction, before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gateway.report import notation
from gateway.report.axis_series import DENSE, cell, measured_axes
from gateway.report.centre import centre, earlier
from gateway.report.svg import Panel, limits
from gateway.result.drawn import Drawn
from gateway.result.interval import half_width
from gateway.result.result import UNKNOWN_THREE, LoadResult, Result, Rows
from gateway.result.values import Matrix

Floats = NDArray[np.float64]

WIDTH, HEIGHT = 470.0, 220.0
# another joint angle replaces the axis's own if it explains this much more of the variance
BETTER_BY = 0.25
# number of harmonics of a joint angle in that test; it needs twice as many visits
HARMONICS = 5
# name, unit and factor of the load parameters
QUANTITIES = (("mass", "kg", 1.0), *((f"centre {name}", "mm", 1e3) for name in "xyz"))


def posture_figures(result: Result) -> list[tuple[str, Markup]]:
    """Draw per measured axis: residual of each approach direction over the joint angle that explains it best.

    A two-sided visit gives two marks, one per approach direction; a visit or sample with one direction gives one.
    """
    rows, data = result.rows, result.data or Drawn()
    if rows is None or not rows.tau_nm or not rows.q_rad:
        return []
    q = np.array(rows.q_rad)
    after = _sides(rows, rows.model_nm, data.band_model_nm)
    before = _sides(rows, data.model_before_nm, data.band_model_before_nm)
    figures = []
    for axis in measured_axes(rows):
        if not any(np.isfinite(values[:, axis]).any() for _, values in after):
            continue
        joint = _joint(q, before or after, axis)
        shown = [[(side, values[:, axis]) for side, values in series] for series in (before, after)]
        floor = cell((result.noise_floor_nm,), 0, axis)
        figures.append((notation.axis(axis + 1), _figure(q[:, joint], shown, (axis, joint), floor)))
    return figures


def _sides(rows: Rows, model: Matrix, band_model: Matrix) -> list[tuple[int, Floats]]:
    """Return residuals (n, axes) after motion up (+1), down (-1), unknown (0); empty without a model."""
    if not model:
        return []
    middle = np.array(rows.tau_nm) - np.array(model)
    direction = np.array(rows.direction) if rows.direction else np.zeros_like(middle)
    half = np.full_like(middle, np.nan)
    if band_model and rows.band_nm:
        half = np.array(rows.band_nm) - np.array(band_model)
    two = np.isfinite(half)
    out = []
    for side in (1, -1, 0):
        single = np.where(~two & (direction == side), middle, np.nan)
        values = np.where(two, middle + side * half, single) if side else single
        if np.isfinite(values).any():
            out.append((side, values))
    return out


def _joint(q: Floats, series: Sequence[tuple[int, Floats]], axis: int) -> int:
    """Return the joint whose angle explains the residual of an axis best; its own unless another is clearly better."""
    stacked = np.array([values[:, axis] for _, values in series])
    count = np.isfinite(stacked).sum(axis=0)
    left = np.where(count > 0, np.nansum(stacked, axis=0) / np.maximum(count, 1), np.nan)
    seen = np.isfinite(left)
    if seen.sum() < 2 * HARMONICS or np.var(left[seen]) == 0:
        return axis
    shares = []
    for angle in q[seen].T:
        shape = np.stack([np.ones_like(angle), *(f(k * angle) for k in (1, 2) for f in (np.sin, np.cos))], axis=1)
        fit, *_ = np.linalg.lstsq(shape, left[seen], rcond=None)
        shares.append(1.0 - float(np.var(left[seen] - shape @ fit) / np.var(left[seen])))
    best = int(np.argmax(shares))
    return best if shares[best] > shares[axis] + BETTER_BY else axis


def _figure(
    angle: Floats, shown: Sequence[Sequence[tuple[int, Floats]]], place: tuple[int, int], floor: float
) -> Markup:
    axis, joint = place
    values = [float(v) for series in shown for _, side in series for v in side]
    half = 2.0 * floor if math.isfinite(floor) else 0.0
    panel = Panel(WIDTH, HEIGHT, limits(angle.tolist(), pad=0.04), limits(values, include=(-half, half, 0.0)))
    if half:
        panel.box(panel.x_range, (-half, half), "floor")
    panel.x_axis(f"q{joint + 1} [rad]")
    panel.y_axis(f"{notation.axis(axis + 1)} residual [Nm]")
    dense = len(angle) > DENSE
    least = 5e-3 * (panel.y_range[1] - panel.y_range[0])
    final = dict(shown[1])
    for series, kind in zip(shown, ("before", "after"), strict=True):
        for side, left in series:
            moved = np.ones(len(left), dtype=bool)
            if kind == "before" and side in final:
                moved = ~(np.abs(left - final[side]) < least)
            for x, y in zip(angle[moved].tolist(), left[moved].tolist(), strict=True):
                if math.isfinite(x) and math.isfinite(y):
                    _mark(panel, (x, y), side, f"{kind} small" if dense else kind)
    return panel.svg(f"Residual of {notation.axis(axis + 1)} against posture and direction")


def _mark(panel: Panel, place: tuple[float, float], side: int, kind: str) -> None:
    """Draw a triangle in the approach direction; a dot if unknown."""
    small = kind.endswith("small")
    if side == 0:
        panel.dot(*place, f"dot {kind}", "", 1.6 if small else 3.2)
    else:
        panel.triangle(*place, side, f"dot {kind}", 2.2 if small else 4.2)


def load_change_figure(result: Result) -> Markup | None:
    """Draw mass and centre of gravity of each load before and after, in half widths of the final 95 % interval."""
    several = len(result.loads) > 1
    pairs = [(load, earlier(result, load)) for load in result.loads]
    entries = [
        entry
        for load, before in pairs
        if before is not None
        for entry in _changes(load.label if several else "", _quantities(load, result), _quantities(before))
    ]
    if not entries:
        return None
    reach = [v for _, at, half, _ in entries for v in (at - half, at + half)]
    rows = len(entries)
    width, height = 560.0, 30.0 + 24.0 * rows + 38.0
    x_range, y_range = limits([*reach, -1.4, 1.4]), (rows - 0.5, -0.5)
    panel = Panel(width, height, x_range, y_range, left=128.0, right=150.0, top=8.0, bottom=38.0)
    panel.box((-1.0, 1.0), (rows - 0.5, -0.5), "band-after")
    panel.x_axis("distance from the final value / its 95 % half width [-]")
    panel.segment((0.0, rows - 0.5), (0.0, -0.5), "zero")
    for row, (name, at, half, text) in enumerate(entries):
        y = panel.y(row) + 4
        panel.text(panel.left - 8, y, name, "name end")
        panel.segment((at - half, row), (at + half, row), "whisker-before")
        panel.dot(at, row, "dot before", f"{name} before", 4.4)
        panel.dot(0.0, row, "dot after", f"{name} after", 4.4)
        panel.text(width - panel.right + 8, y, text, "tick")
    return panel.svg("Mass and centre of gravity before and after")


def _changes(
    label: str, final: Sequence[tuple[float, float]], before: Sequence[tuple[float, float]]
) -> list[tuple[str, float, float, str]]:
    """Return (name, value before, its half width, text) per quantity; `label` if there are several loads."""
    entries = []
    for (name, unit, factor), (value, std), (old, old_std) in zip(QUANTITIES, final, before, strict=True):
        if not all(map(math.isfinite, (value, std, old))) or std <= 0:
            continue
        scale = half_width(std)
        half = old_std / std if math.isfinite(old_std) else 0.0
        digits = notation.decimals(factor * scale)
        text = f"{notation.plain(factor * old, digits)} → {notation.plain(factor * value, digits)} {unit}"
        entries.append((f"{label} {name}".strip(), (old - value) / scale, half, text))
    return entries


def _quantities(load: LoadResult, result: Result | None = None) -> list[tuple[float, float]]:
    """Return value and standard deviation of each of `QUANTITIES`, in the displayed frame; NaN if unknown."""
    shown = centre(load, result)
    com, std = (UNKNOWN_THREE, UNKNOWN_THREE) if shown is None else (shown.com_m, shown.std_m)
    return [(load.mass_kg, load.mass_std_kg), *zip(com, std, strict=True)]
