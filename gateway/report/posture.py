"""Residual against posture and direction of approach, before and after: the picture of what was wrong."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gateway.report import words
from gateway.report.rows import DENSE, axes_of, measured_axes
from gateway.report.svg import Panel, limits

Json = Mapping[str, Any]
Floats = NDArray[np.float64]

WIDTH, HEIGHT = 470.0, 220.0
# Another joint's angle is drawn in place of the axis's own one where it explains so much more of the variance.
BETTER_BY = 0.25
# Harmonics of a joint angle that are asked how much they explain; twice as many visits are needed to ask.
HARMONICS = 5


def posture_figures(result: Json) -> list[tuple[str, Markup]]:
    """Per measured axis: what each side of each visit reads beyond the model, over the joint angle it hangs on.

    A two-sided visit gives two marks, one for each direction of approach; a visit or instant with one direction gives
    one.
    """
    rows, data = result.get("rows") or {}, result.get("data") or {}
    if not rows.get("tau_nm") or not rows.get("q_rad"):
        return []
    q = _table(rows["q_rad"])
    after = _sides(rows, rows.get("model_nm"), data.get("band_model_nm"))
    before = _sides(rows, data.get("model_before_nm"), data.get("band_model_before_nm"))
    floor = list(result.get("noise_floor_nm") or []) + [None] * axes_of(result)
    figures = []
    for axis in measured_axes(rows):
        if not any(np.isfinite(values[:, axis]).any() for _, values in after):
            continue
        joint = _joint(q, before or after, axis)
        shown = [[(side, values[:, axis]) for side, values in series] for series in (before, after)]
        figures.append((words.axis(axis + 1), _figure(q[:, joint], shown, (axis, joint), floor[axis])))
    return figures


def _table(values: Sequence[Sequence[float | None]]) -> Floats:
    return np.array([[math.nan if value is None else float(value) for value in row] for row in values])


def _sides(rows: Json, model: Any, band_model: Any) -> list[tuple[int, Floats]]:
    """Residual (n, N) of readings after motion up (+1), down (-1), unknown (0); empty without a model."""
    if not model:
        return []
    middle = _table(rows["tau_nm"]) - _table(model)
    direction = np.zeros_like(middle)
    if rows.get("direction"):
        direction = np.nan_to_num(_table(rows["direction"]))
    half = np.full_like(middle, np.nan)
    if band_model and rows.get("band_nm"):
        half = _table(rows["band_nm"]) - _table(band_model)
    two = np.isfinite(half)
    out = []
    for side in (1, -1, 0):
        single = np.where(~two & (direction == side), middle, np.nan)
        values = np.where(two, middle + side * half, single) if side else single
        if np.isfinite(values).any():
            out.append((side, values))
    return out


def _joint(q: Floats, series: Sequence[tuple[int, Floats]], axis: int) -> int:
    """The joint whose angle explains the residual of an axis best; its own unless another is clearly better."""
    stacked = np.array([values[:, axis] for _, values in series])
    count = np.isfinite(stacked).sum(axis=0)
    left = np.where(count > 0, np.nansum(stacked, axis=0) / np.maximum(count, 1), np.nan)
    seen = np.isfinite(left)
    if seen.sum() < 2 * HARMONICS or np.var(left[seen]) == 0:
        return axis
    shares = []
    for joint in range(q.shape[1]):
        angle = q[seen, joint]
        shape = np.stack([np.ones_like(angle), *(f(k * angle) for k in (1, 2) for f in (np.sin, np.cos))], axis=1)
        fit, *_ = np.linalg.lstsq(shape, left[seen], rcond=None)
        shares.append(1.0 - float(np.var(left[seen] - shape @ fit) / np.var(left[seen])))
    best = int(np.argmax(shares))
    return best if shares[best] > shares[axis] + BETTER_BY else axis


def _figure(
    angle: Floats, shown: Sequence[Sequence[tuple[int, Floats]]], place: tuple[int, int], floor: float | None
) -> Markup:
    axis, joint = place
    values = [float(v) for series in shown for _, side in series for v in side]
    half = 2.0 * floor if floor is not None and math.isfinite(floor) else 0.0
    panel = Panel(WIDTH, HEIGHT, limits(angle.tolist(), pad=0.04), limits(values, include=(-half, half, 0.0)))
    if half:
        panel.box(panel.x_range, (-half, half), "floor")
    panel.x_axis(f"q{joint + 1} [rad]")
    panel.y_axis(f"{words.axis(axis + 1)} residual [Nm]")
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
    return panel.svg(f"Residual of {words.axis(axis + 1)} against posture and direction")


def _mark(panel: Panel, place: tuple[float, float], side: int, kind: str) -> None:
    """A triangle that points the way the joint came; a dot where that is not known."""
    small = kind.endswith("small")
    if side == 0:
        panel.dot(*place, f"dot {kind}", "", 1.6 if small else 3.2)
    else:
        panel.triangle(*place, side, f"dot {kind}", 2.2 if small else 4.2)


def load_change_figure(result: Json) -> Markup | None:
    """Mass and centre of gravity of every load before and after, in half widths of the final 95 % interval."""
    if not result.get("effects"):
        return None
    earlier = {load.get("label"): load for load in (result.get("before") or {}).get("loads") or []}
    entries = [
        entry
        for load in result.get("loads") or []
        for entry in _changes(load, earlier.get(load.get("label")), len(result["loads"]) > 1)
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


def _changes(load: Json, before: Json | None, named: bool) -> list[tuple[str, float, float, str]]:
    """(name, place of the value before, its half width, text) per quantity; lengths in the frame of the last link."""
    if before is None:
        return []
    entries = []
    for name, unit, factor, (value, std), (old, old_std) in _quantities(load, before):
        if not all(map(math.isfinite, (value, std, old))) or std <= 0:
            continue
        scale = words.TWO_SIDED_95 * std
        half = old_std / std if math.isfinite(old_std) else 0.0
        digits = words.decimals(factor * scale)
        text = f"{words.plain(factor * old, digits)} → {words.plain(factor * value, digits)} {unit}"
        title = f"{load.get('label')} {name}" if named else name
        entries.append((title, (old - value) / scale, half, text))
    return entries


def _quantities(load: Json, before: Json) -> list[tuple[str, str, float, tuple[float, float], tuple[float, float]]]:
    """Name, unit, factor to that unit, and (value, standard deviation) after and before; NaN where not known."""

    def pair(item: Json, place: int) -> tuple[float, float]:
        if place < 0:
            values = (item.get("mass_kg"), item.get("mass_std_kg"))
        else:
            values = ((item.get("com_m") or [None] * 3)[place], (item.get("com_std_m") or [None] * 3)[place])
        first, second = (math.nan if value is None else float(value) for value in values)
        return first, second

    kinds = [("mass", "kg", 1.0), *((f"centre {name}", "mm", 1e3) for name in "xyz")]
    return [(*kind, pair(load, place), pair(before, place)) for place, kind in enumerate(kinds, start=-1)]
