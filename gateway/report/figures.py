"""Figures per axis of the visits: measured and modelled torque, residual, residual over posture and direction.

`Layout` orders the samples along the horizontal axis: grouped by load, in the order of the poses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gateway.report import notation
from gateway.report.svg import Panel, limits
from gateway.result.drawn import FRESH, Drawn
from gateway.result.result import Result, Rows
from gateway.result.values import Matrix

Floats = NDArray[np.float64]

WIDTH, HEIGHT = 470.0, 210.0
LOAD_CLASSES = ("load-0", "load-1", "load-2", "load-3", "load-4")
#: Width of a digit of a tick label [px].
CHARACTER_PX = 8.0
# another joint angle replaces the axis's own if it explains this much more of the variance
BETTER_BY = 0.25
# number of harmonics of a joint angle in that test; it needs twice as many visits
HARMONICS = 5
# above this many samples, marks are small and poses are not labelled
DENSE = 120
GROUP_GAP = 1.4
# a moving run is reduced to about this many samples
MOST_ROWS = 900


@dataclass(frozen=True, slots=True)
class Layout:
    """Position of each sample on the horizontal axis.

    Parameters
    ----------
    order : tuple of int
        Row numbers from left to right.
    place : tuple of float
        Their positions, with spacing 1 and a gap between loads.
    groups : tuple of (str, float, float)
        Label, first and last position of each load.
    names : tuple of str
        Pose number at each position.
    roles : tuple of str
        `fit`, `held out` or `fresh`, at each position.
    """

    order: tuple[int, ...]
    place: tuple[float, ...]
    groups: tuple[tuple[str, float, float], ...]
    names: tuple[str, ...]
    roles: tuple[str, ...]

    @property
    def dense(self) -> bool:
        """Return whether there are too many samples to label them."""
        return len(self.order) > DENSE

    @property
    def width(self) -> tuple[float, float]:
        """Return the range of the horizontal axis."""
        return (-0.8, (self.place[-1] if self.place else 0.0) + 0.8)


def layout(rows: Rows, roles: Sequence[str] = ()) -> Layout:
    """Sort the rows by load (in order of appearance) and pose.

    Parameters
    ----------
    rows : Rows
    roles : sequence of str
        One entry per sample; ignored if the number differs.
    """
    loads, count = rows.load, len(rows.load)
    poses = rows.pose or (-1,) * count
    words = roles if len(roles) == count else ("fit",) * count
    seen = list(dict.fromkeys(loads))
    shown = range(0, count, 1 + count // MOST_ROWS)
    order = sorted(shown, key=lambda row: (seen.index(loads[row]), words[row] == FRESH, poses[row], row))
    place, groups = [], []
    position = 0.0
    for rank, row in enumerate(order):
        if rank and loads[row] != loads[order[rank - 1]]:
            position += GROUP_GAP
        place.append(position)
        if not groups or groups[-1][0] != loads[row]:
            groups.append((loads[row], position, position))
        groups[-1] = (groups[-1][0], groups[-1][1], position)
        position += 1.0
    names = tuple("" if poses[row] < 0 else str(poses[row]) for row in order)
    return Layout(tuple(order), tuple(place), tuple(groups), names, tuple(words[row] for row in order))


def cell(table: Matrix, row: int, axis: int) -> float:
    """Return one number of a table (samples, axes); NaN if missing."""
    return table[row][axis] if row < len(table) and axis < len(table[row]) else math.nan


def measured_axes(rows: Rows) -> list[int]:
    """Return the axes (from 0) with at least one torque."""
    return [axis for axis, column in enumerate(zip(*rows.tau_nm, strict=True)) if any(map(math.isfinite, column))]


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
