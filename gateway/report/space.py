"""3D figures: the arm in each pose, and the centre of gravity of the load with its 95 % ellipse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup, escape

from gateway.report import notation
from gateway.report.axis_series import cell
from gateway.report.centre import Centre
from gateway.report.svg import Panel, Scale
from gateway.result.drawn import FRESH, DrawnPose

Vector = Sequence[float]
AZIMUTH_RAD, ELEVATION_RAD = math.radians(-62.0), math.radians(16.0)
ARM_WIDTH, ARM_MARGIN = 190.0, 9.0
MOST_POSES = 24
# radius of the drawn floor over the largest reach
GROUND = 0.62
# 95 % quantile of chi-square with two degrees of freedom
ELLIPSE_95 = math.sqrt(5.991)
COM_SIDE = 190.0


def pose_figures(drawn: Sequence[DrawnPose], classes: Mapping[str, str]) -> list[tuple[str, Markup]]:
    """Draw the arm in each pose, all to the same scale.

    Parameters
    ----------
    drawn : sequence of DrawnPose
    classes : mapping
        CSS class of each load label.
    """
    poses = [pose for pose in drawn if pose.points_m]
    if not poses:
        return []
    every = [point for pose in poses for point in (*pose.points_m, *filter(None, [pose.com_m]))] + [(0.0, 0.0, 0.0)]
    ground = GROUND * max(math.hypot(x, y) for x, y, _ in every)
    flat = [project(point) for point in every] + [project(point) for point in _rim(ground)]
    scales = _scales(flat)
    return [(_title(pose), _arm(pose, scales, ground, classes)) for pose in poses[:MOST_POSES]]


def project(point: Vector) -> tuple[float, float]:
    """Return the axonometric projection of a point [m]: right and up [m]."""
    x, y, z = point
    right = -math.sin(AZIMUTH_RAD) * x + math.cos(AZIMUTH_RAD) * y
    depth = math.cos(AZIMUTH_RAD) * x + math.sin(AZIMUTH_RAD) * y
    return right, math.cos(ELEVATION_RAD) * z - math.sin(ELEVATION_RAD) * depth


def _scales(flat: Sequence[tuple[float, float]]) -> tuple[Scale, Scale]:
    """Return equal scales in both directions; the height follows from the arm."""
    xs, ys = [x for x, _ in flat], [y for _, y in flat]
    per_px = (max(xs) - min(xs)) / (ARM_WIDTH - 2 * ARM_MARGIN) or 1.0
    height = min(max((max(ys) - min(ys)) / per_px, 0.4 * ARM_WIDTH), 1.2 * ARM_WIDTH)
    per_px = max(per_px, (max(ys) - min(ys)) / height)
    x_mid, half = (max(xs) + min(xs)) / 2, per_px * (ARM_WIDTH / 2 - ARM_MARGIN)
    right = Scale(x_mid - half, x_mid + half, ARM_MARGIN, ARM_WIDTH - ARM_MARGIN)
    return right, Scale(min(ys), min(ys) + per_px * height, ARM_MARGIN + height, ARM_MARGIN)


def _title(pose: DrawnPose) -> str:
    if pose.pose < 0:
        return f"at {pose.time_s:.1f} s" if math.isfinite(pose.time_s) else "in motion"
    return f"pose {pose.pose}" + (", fresh" if pose.role == FRESH else "")


def _arm(pose: DrawnPose, scales: tuple[Scale, Scale], ground: float, classes: Mapping[str, str]) -> Markup:
    points = _distinct(pose.points_m)
    parts = [_floor(scales, ground), _line([(x, y, 0.0) for x, y, _ in points], scales, "shadow", 7.0)]
    count = max(len(points) - 1, 1)
    if points[0][2] > 0:
        parts.append(_line([(points[0][0], points[0][1], 0.0), points[0]], scales, "link", 13.0))
    for index in range(len(points) - 1):
        parts.append(_line(points[index : index + 2], scales, "link", 11.0 - 6.5 * index / count))
    parts += [_mark(point, scales, "joint", max(2.0, 4.2 - 0.4 * rank)) for rank, point in enumerate(points[:-1])]
    if pose.com_m:
        kind = classes.get(pose.load, "load-1")
        parts.append(_line([points[-1], pose.com_m], scales, f"stem {kind}", 2.0))
        parts.append(_mark(pose.com_m, scales, f"payload {kind}", 6.5))
    hint = "q = " + ", ".join(f"{math.degrees(q):.0f}" for q in pose.q_rad) + " deg"
    body = "".join(parts)
    label = f'role="img" aria-label="The arm in {escape(_title(pose))}"'
    size = f'viewBox="0 0 {ARM_WIDTH:g} {scales[1].start_px + ARM_MARGIN:.0f}"'
    return Markup(f"<svg {size} {label}><title>{escape(hint)}</title>{body}</svg>")


def _floor(scales: tuple[Scale, Scale], ground: float) -> str:
    rim, half = _places(_rim(ground), scales), _places(_rim(0.5 * ground), scales)
    return f'<polygon class="ground" points="{rim}"/><polygon class="ring" points="{half}"/>'


def _rim(radius: float) -> list[Vector]:
    return [(radius * math.cos(angle), radius * math.sin(angle), 0.0) for angle in _circle(48)]


def _circle(count: int) -> list[float]:
    return [2 * math.pi * index / count for index in range(count)]


def _distinct(points: Sequence[Vector]) -> list[Vector]:
    kept: list[Vector] = [points[0]]
    for point in points[1:]:
        if math.dist(point, kept[-1]) > 1e-6:
            kept.append(point)
    return kept


def _places(points: Sequence[Vector], scales: tuple[Scale, Scale]) -> str:
    flat = [project(point) for point in points]
    return " ".join(f"{scales[0](x):.1f},{scales[1](y):.1f}" for x, y in flat)


def _line(points: Sequence[Vector], scales: tuple[Scale, Scale], kind: str, width: float) -> str:
    return f'<polyline class="{kind}" stroke-width="{width:.1f}" points="{_places(points, scales)}"/>'


def _mark(point: Vector, scales: tuple[Scale, Scale], kind: str, radius: float) -> str:
    x, y = project(point)
    return f'<circle class="{kind}" cx="{scales[0](x):.1f}" cy="{scales[1](y):.1f}" r="{radius:.1f}"/>'


def com_figures(load: Centre, before: Centre | None) -> list[tuple[str, Markup]]:
    """Draw the centre of gravity in two views [mm] with the 95 % ellipse, and the value before the effects were added.

    Parameters
    ----------
    load : Centre
    before : Centre or None
        The same load before the effects were added.
    """
    if not load.known:
        return []
    shown = [("after", load)] if before is None or not before.known else [("before", before), ("after", load)]
    views = (("side view", 2, 0), ("end view", 1, 0))
    return [(f"{title}, {load.frame} frame", _com_view(shown, (across, up))) for title, across, up in views]


def _com_view(shown: Sequence[tuple[str, Centre]], pair: tuple[int, int]) -> Markup:
    across, up = pair
    half = 1.15 * max(20.0, *(_reach_mm(item) for _, item in shown))
    panel = Panel(COM_SIDE + 64, COM_SIDE + 52, (-half, half), (-half, half), left=52, right=12, top=12, bottom=40)
    panel.x_axis(f"{'xyz'[across]} [mm]", 3)
    panel.y_axis(f"{'xyz'[up]} [mm]", 3)
    if across == 2:
        panel.segment((0.0, -0.32 * half), (0.0, 0.32 * half), "flange")
        panel.segment((-0.12 * half, 0.0), (0.0, 0.0), "flange")
    else:
        panel.dot(0.0, 0.0, "flange-face", "flange", COM_SIDE * 0.16)
    for kind, item in shown:
        _com_mark(panel, item, pair, kind)
    return panel.svg("Centre of gravity of the load with its 95 % ellipse")


def _com_mark(panel: Panel, item: Centre, pair: tuple[int, int], kind: str) -> None:
    x, y = (1000 * item.com_m[axis] for axis in pair)
    outline = _ellipse(item, pair)
    if outline:
        points = " ".join(f"{panel.x(x + dx):.1f},{panel.y(y + dy):.1f}" for dx, dy in outline)
        panel.add(f'<polygon class="ellipse {kind}" points="{points}"/>')
    panel.dot(x, y, f"dot {kind}", f"{kind}: {notation.plain(x, 1)}, {notation.plain(y, 1)} mm", 3.6)


def _ellipse(item: Centre, pair: tuple[int, int]) -> list[tuple[float, float]]:
    """Return the outline of the 95 % ellipse about its centre [mm]; empty if the uncertainty is unknown."""
    if not all(map(math.isfinite, item.std_m)):
        return []
    first, second = (1000 * item.std_m[axis] for axis in pair)
    rho = cell(item.correlation or (), pair[0] + 1, pair[1] + 1)
    rho = max(-0.999, min(0.999, rho)) if math.isfinite(rho) else 0.0
    side = math.sqrt(1 - rho * rho)
    return [
        (
            ELLIPSE_95 * first * math.cos(angle),
            ELLIPSE_95 * second * (rho * math.cos(angle) + side * math.sin(angle)),
        )
        for angle in _circle(60)
    ]


def _reach_mm(item: Centre) -> float:
    """Return the largest component of the distance of a centre of gravity with its ellipse from the origin."""
    spread = item.std_m if all(map(math.isfinite, item.std_m)) else (0.0, 0.0, 0.0)
    return max(1000 * (abs(com) + ELLIPSE_95 * std) for com, std in zip(item.com_m, spread, strict=True))
