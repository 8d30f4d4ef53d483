"""3D pages: poses and path of a plan, or the arm of a cell, with the keep-out boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from gateway.report import space
from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits, nice_step

Vector = Sequence[float]
WIDTH, MARGIN = 900.0, 14.0
CURVE_WIDTH, CURVE_HEIGHT = 420.0, 200.0
MOTIONS = (
    "Thin lines: paths of the flange centre, each from rest to rest. Thick line: arm at the start. Grey: boxes of "
    "keep_out. Cross at the base: x, y and z. Speeds are shares of the planning limit, which is slightly "
    "below the speed limit."
)
PATH = (
    "Thin line: path of the flange centre over all poses, in order. Thick line: arm at the first pose. Grey: boxes "
    "of keep_out. Cross at the base: x, y and z."
)
ARM = "Lines: arm from its base to the flange. Grey: boxes of keep_out. Cross: x, y and z."


def scene_page(
    head: Head,
    lead: str,
    lines_m: Sequence[tuple[str, Sequence[Vector]]],
    boxes_m: Sequence[Sequence[Vector]],
    said: Sequence[str],
    *,
    heading: str = "Path of the flange",
    arm: tuple[str, Sequence[Vector]] | None = None,
    over: str = "Poses",
    figures: Sequence[tuple[str, Markup]] = (),
    loads: Sequence[Sequence[str]] = (),
) -> str:
    """Return the HTML page of a plan or a cell: lines in space with the boxes of keep_out, and further figures.

    Parameters
    ----------
    head : Head
    lead : str
        Explains the lines: `MOTIONS`, `PATH` or `ARM`.
    lines_m : sequence of (name, points)
        Paths or postures, base frame.
    boxes_m : sequence of (lower, upper) corners
    said : sequence of str
        Monitored distances and assumptions, one line each.
    heading : str
        Of the lines.
    arm : (name, points), optional
        Positions of joints and flange, base frame.
    over, figures : str, sequence of (title, figure)
        Further figures and their heading.
    loads : sequence of rows
        Table of the loads of the arm, the names of its columns first.
    """
    texts = {"heading": heading, "lead": lead, "over": over, "said": said, "loads": loads}
    return page("plan.html.j2", head, scene=_scene(lines_m, boxes_m, arm), arms=figures, **texts)


def curve_figures(
    name: str, time_s: Sequence[float], q_rad: Sequence[Sequence[float]], speed_percent: Sequence[Sequence[float]]
) -> list[tuple[str, Markup]]:
    """Draw position [rad] and speed [% of the planning limit] of each moving joint over one period at times [s]."""
    figures: list[tuple[str, Markup]] = []
    for joint, (angles, speeds) in enumerate(zip(q_rad, speed_percent, strict=True), start=1):
        if not any(speeds):
            continue
        title = f"{name}: J{joint}"
        degrees = [math.degrees(angle) for angle in angles]
        for label, values, about in (("position [deg]", degrees, ()), ("speed [% of limit]", speeds, (-100.0, 100.0))):
            panel = Panel(CURVE_WIDTH, CURVE_HEIGHT, limits(time_s, pad=0.0), limits(values, include=about))
            panel.y_axis(label)
            panel.x_axis("time [s]")
            panel.polyline(list(zip(time_s, values, strict=True)), "curve")
            figures.append((title, panel.svg(f"{title}, {label}")))
    return figures


def _edges(low: Vector, high: Vector) -> list[tuple[Vector, Vector]]:
    """Return the twelve edges of a box."""
    corners = [tuple((low, high)[(number >> axis) & 1][axis] for axis in range(3)) for number in range(8)]
    return [(corners[a], corners[a | 1 << axis]) for a in range(8) for axis in range(3) if not a >> axis & 1]


def _scene(
    lines_m: Sequence[tuple[str, Sequence[Vector]]],
    boxes_m: Sequence[Sequence[Vector]],
    arm: tuple[str, Sequence[Vector]] | None = None,
) -> Markup:
    """Draw named lines, an arm, boxes and a cross of known length; boxes are clipped slightly beyond the reach."""
    arms_m = [] if arm is None else [(arm[0], [(0.0, 0.0, 0.0), *arm[1]])]
    far = 1.15 * max(max(abs(value) for value in point) for _, points in (*lines_m, *arms_m) for point in points)
    near = [[[min(max(value, -far), far) for value in corner] for corner in box] for box in boxes_m]
    rings = [tuple(space.project(end) for end in edge) for low, high in near for edge in _edges(low, high)]
    flat = [(name, [space.project(point) for point in points]) for name, points in lines_m]
    stood = [(name, [space.project(point) for point in points]) for name, points in arms_m]
    length = nice_step(far, 3)
    origin = space.project((0.0, 0.0, 0.0))
    tips = [space.project([length * (axis == other) for other in range(3)]) for axis in range(3)]
    drawn = [at for _, points in (*flat, *stood) for at in points]
    every = [origin, *tips, *(end for ring in rings for end in ring), *drawn]
    xs, ys = [x for x, _ in every], [y for _, y in every]
    scale = (WIDTH - 2 * MARGIN) / (max(xs) - min(xs) or 1.0)
    height = scale * (max(ys) - min(ys)) + 2 * MARGIN

    def place(point: tuple[float, float]) -> tuple[float, float]:
        return MARGIN + scale * (point[0] - min(xs)), height - MARGIN - scale * (point[1] - min(ys))

    def at(point: tuple[float, float]) -> str:
        return "{:.1f},{:.1f}".format(*place(point))

    def label(text: str, point: tuple[float, float]) -> Markup:
        x, y = place(point)
        return Markup('<text class="tick" x="{:.1f}" y="{:.1f}">{}</text>').format(x + 4, y - 4, text)

    parts = [Markup('<polyline class="ring" points="{} {}"/>').format(at(first), at(last)) for first, last in rings]
    for name, points in stood:
        line = '<polyline class="link arm" fill="none" stroke-width="7" points="{}"><title>{}</title></polyline>'
        parts.append(Markup(line).format(" ".join(map(at, points)), name))
    for name, points in flat:
        line = '<polyline fill="none" stroke="#0a63c2" stroke-width="1.2" points="{}"/>'
        parts += [Markup(line).format(" ".join(map(at, points))), label(name, points[-1])]
    for name, tip in zip("xyz", tips, strict=True):
        parts.append(Markup('<polyline fill="none" stroke="#444c56" points="{} {}"/>').format(at(origin), at(tip)))
        parts.append(label(f"{name} {length:g} m", tip))
    x, y = place(origin)
    parts.append(
        Markup('<circle class="joint" cx="{:.1f}" cy="{:.1f}" r="5"><title>base</title></circle>').format(x, y)
    )
    described = 'role="img" aria-label="Lines in space with the boxes of the cell"'
    return Markup(f'<svg viewBox="0 0 {WIDTH:g} {height:.0f}" {described}>{Markup("").join(parts)}</svg>')
