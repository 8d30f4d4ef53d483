"""The page of a plan: poses, way of the flange and boxes in space, and what is kept apart."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from gateway.report import space
from gateway.report.page import Head, page
from gateway.result.drawn import DrawnPose

Vector = Sequence[float]
WIDTH, MARGIN = 900.0, 14.0


def plan_page(
    title: str,
    poses: Sequence[DrawnPose],
    way_m: Sequence[Vector],
    boxes_m: Sequence[Sequence[Vector]],
    said: Sequence[str],
) -> str:
    """HTML text of a plan.

    Parameters
    ----------
    title : str
    poses : sequence of DrawnPose
    way_m : sequence of points
        Places of the flange along the way, base frame.
    boxes_m : sequence of (lower, upper) corners
    said : sequence of str
        What is kept apart and what is assumed, a line each.
    """
    head = Head(f"Plan: {title}", "Plan of the rest poses", (("arm", title), ("poses", str(len(poses)))))
    return page("plan.html.j2", head, arms=space.pose_figures(poses, {}), way=_way(way_m, boxes_m), said=list(said))


def edges(low: Vector, high: Vector) -> list[tuple[Vector, Vector]]:
    """The twelve edges of a box."""
    corners = [tuple((low, high)[(number >> axis) & 1][axis] for axis in range(3)) for number in range(8)]
    return [(corners[a], corners[a | 1 << axis]) for a in range(8) for axis in range(3) if not a >> axis & 1]


def _way(way_m: Sequence[Vector], boxes_m: Sequence[Sequence[Vector]]) -> Markup:
    """Way and boxes; boxes are cut off a little beyond what the arm reaches."""
    far = 1.15 * max(max(abs(value) for value in point) for point in way_m)
    near = [[[min(max(value, -far), far) for value in corner] for corner in box] for box in boxes_m]
    flat = [space.project(point) for point in way_m]
    lines = [tuple(space.project(end) for end in edge) for low, high in near for edge in edges(low, high)]
    every = [*flat, *(end for line in lines for end in line), space.project((0.0, 0.0, 0.0))]
    xs, ys = [x for x, _ in every], [y for _, y in every]
    scale = (WIDTH - 2 * MARGIN) / (max(xs) - min(xs) or 1.0)
    height = scale * (max(ys) - min(ys)) + 2 * MARGIN

    def at(point: tuple[float, float]) -> str:
        return f"{MARGIN + scale * (point[0] - min(xs)):.1f},{height - MARGIN - scale * (point[1] - min(ys)):.1f}"

    parts = [f'<polyline class="ring" points="{at(first)} {at(last)}"/>' for first, last in lines]
    parts.append(f'<polyline fill="none" stroke="#0a63c2" stroke-width="1.2" points="{" ".join(map(at, flat))}"/>')
    x, y = at(space.project((0.0, 0.0, 0.0))).split(",")
    parts.append(f'<circle class="joint" cx="{x}" cy="{y}" r="5"><title>base</title></circle>')
    label = 'role="img" aria-label="Way of the flange and boxes"'
    return Markup(f'<svg viewBox="0 0 {WIDTH:g} {height:.0f}" {label}>{"".join(parts)}</svg>')
