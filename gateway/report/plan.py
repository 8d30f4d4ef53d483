"""3D pages: poses and path of a plan, or the arm of a cell, with the keep-out boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from gateway.report import space
from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits
from gateway.result.drawn import DrawnPose

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


def plan_page(
    title: str,
    poses: Sequence[DrawnPose],
    path_m: Sequence[Vector],
    boxes_m: Sequence[Sequence[Vector]],
    said: Sequence[str],
) -> str:
    """Return the HTML page of a plan.

    Parameters
    ----------
    title : str
    poses : sequence of DrawnPose
    path_m : sequence of points
        Flange positions along the path, base frame.
    boxes_m : sequence of (lower, upper) corners
    said : sequence of str
        Monitored distances and assumptions, one line each.
    """
    head = Head(f"Plan: {title}", "Plan of the rest poses", (("arm", title), ("poses", str(len(poses)))))
    return page(
        "plan.html.j2",
        head,
        heading="Path of the flange",
        lead=PATH,
        scene=_scene([("", path_m)], boxes_m, (f"arm at pose {poses[0].pose}", poses[0].points_m)),
        arms=space.pose_figures(poses, {}),
        said=list(said),
    )


@dataclass(frozen=True, slots=True)
class JointCurves:
    """One period of a trajectory: positions [rad] and speeds [% of the planning limit] by joint, at times [s]."""

    name: str
    time_s: Sequence[float]
    q_rad: Sequence[Sequence[float]]
    speed_percent: Sequence[Sequence[float]]


def moving_page(
    title: str,
    paths_m: Sequence[tuple[str, Sequence[Vector]]],
    curves: Sequence[JointCurves],
    boxes_m: Sequence[Sequence[Vector]],
    said: Sequence[str],
    arm_m: Sequence[Vector],
) -> str:
    """Return the HTML page of a trajectory plan.

    Parameters
    ----------
    title : str
    paths_m : sequence of (name, points)
        Flange positions along each trajectory, base frame.
    curves : sequence of JointCurves
        Curves of all joints of each trajectory.
    boxes_m, said
        As of a plan.
    arm_m : sequence of points
        Positions of joints and flange at the start of the first trajectory, base frame.
    """
    motions = (("arm", title), ("motions", str(len(paths_m))))
    return page(
        "plan.html.j2",
        Head(f"Plan: {title}", "Plan of the trajectories", motions),
        heading="Path of the flange",
        lead=MOTIONS,
        scene=_scene(paths_m, boxes_m, ("arm at its start", arm_m)),
        over="Over one period",
        arms=[figure for each in curves for figure in _curve_figures(each)],
        said=list(said),
    )


def _curve_figures(curves: JointCurves) -> list[tuple[str, Markup]]:
    """Draw position and speed of each moving joint over one period."""
    figures: list[tuple[str, Markup]] = []
    for joint, (angles, speeds) in enumerate(zip(curves.q_rad, curves.speed_percent, strict=True), start=1):
        if not any(speeds):
            continue
        title = f"{curves.name}: J{joint}"
        degrees = [math.degrees(angle) for angle in angles]
        for label, values, about in (("position [deg]", degrees, ()), ("speed [% of limit]", speeds, (-100.0, 100.0))):
            panel = Panel(CURVE_WIDTH, CURVE_HEIGHT, limits(curves.time_s, pad=0.0), limits(values, include=about))
            panel.y_axis(label)
            panel.x_axis("time [s]")
            panel.polyline(list(zip(curves.time_s, values, strict=True)), "curve")
            figures.append((title, panel.svg(f"{title}, {label}")))
    return figures


def cell_page(
    title: str,
    postures: Sequence[tuple[str, Sequence[Vector]]],
    boxes_m: Sequence[Sequence[Vector]],
    said: Sequence[str],
) -> str:
    """Return the HTML page of the arm of a cell.

    Parameters
    ----------
    title : str
    postures : sequence of (name, points)
        Positions of the joints and the flange, base frame.
    boxes_m, said
        As of a plan.
    """
    head = Head(f"Cell: {title}", "The arm and its surroundings", (("arm", title),))
    return page("plan.html.j2", head, heading="Postures", lead=ARM, scene=_scene(postures, boxes_m), arms=[], said=said)


def edges(low: Vector, high: Vector) -> list[tuple[Vector, Vector]]:
    """Return the twelve edges of a box."""
    corners = [tuple((low, high)[(number >> axis) & 1][axis] for axis in range(3)) for number in range(8)]
    return [(corners[a], corners[a | 1 << axis]) for a in range(8) for axis in range(3) if not a >> axis & 1]


def _round_length_m(far_m: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is at most a third of the range shown."""
    power = 10.0 ** math.floor(math.log10(far_m / 3.0))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= far_m / 3.0)


def _scene(
    lines_m: Sequence[tuple[str, Sequence[Vector]]],
    boxes_m: Sequence[Sequence[Vector]],
    arm: tuple[str, Sequence[Vector]] | None = None,
) -> Markup:
    """Draw named lines, an arm, boxes and a cross of known length; boxes are clipped slightly beyond the reach."""
    arms_m = [] if arm is None else [(arm[0], [(0.0, 0.0, 0.0), *arm[1]])]
    far = 1.15 * max(max(abs(value) for value in point) for _, points in (*lines_m, *arms_m) for point in points)
    near = [[[min(max(value, -far), far) for value in corner] for corner in box] for box in boxes_m]
    rings = [tuple(space.project(end) for end in edge) for low, high in near for edge in edges(low, high)]
    flat = [(name, [space.project(point) for point in points]) for name, points in lines_m]
    stood = [(name, [space.project(point) for point in points]) for name, points in arms_m]
    length = _round_length_m(far)
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
