"""The arm in space: in each pose of a result or plan, and the page of a plan or a cell with its keep-out boxes.

All are axonometric projections from the same direction, with the same scale in both directions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from gateway.report.page import Head, page
from gateway.report.svg import Panel, Point, limits, line_chart, nice_step
from gateway.result.drawn import FRESH, DrawnPose

Vector = Sequence[float]
AZIMUTH_RAD, ELEVATION_RAD = math.radians(-62.0), math.radians(16.0)
#: Width of the arm in a pose and of the page of a plan, and their margins [px].
ARM_WIDTH, ARM_MARGIN = 190.0, 9.0
SCENE_WIDTH, SCENE_MARGIN = 900.0, 14.0
#: Least and largest height of a picture over its width.
LEAST_HEIGHT, MOST_HEIGHT = 0.4, 1.2
MOST_POSES = 24
#: Radius of the drawn floor over the largest reach.
GROUND = 0.62
ORIGIN = (0.0, 0.0, 0.0)
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
    every = [point for pose in poses for point in (*pose.points_m, *filter(None, [pose.com_m]))] + [ORIGIN]
    radius = GROUND * max(math.hypot(x, y) for x, y, _ in every)
    rim = [
        (radius * math.cos(angle), radius * math.sin(angle), 0.0)
        for angle in [math.tau * index / 48 for index in range(48)]
    ]
    figures = []
    for pose in poses[:MOST_POSES]:
        title = f"pose {pose.pose}" + (", validation" if pose.role == FRESH else "")
        if pose.pose < 0:
            title = f"at {pose.time_s:.1f} s" if math.isfinite(pose.time_s) else "in motion"
        panel = _panel([*every, *rim], ARM_WIDTH, ARM_MARGIN)
        panel.add(f"<title>q = {', '.join(f'{math.degrees(q):.0f}' for q in pose.q_rad)} deg</title>")
        panel.polygon(_flat(rim), "ground")
        panel.polygon(_flat([(0.5 * x, 0.5 * y, z) for x, y, z in rim]), "ring")
        _draw_arm(panel, pose, classes.get(pose.load, "load-1"))
        figures.append((title, panel.svg(f"The arm in {title}")))
    return figures


def _draw_arm(panel: Panel, pose: DrawnPose, kind: str) -> None:
    """Draw links that get thinner towards the flange, joints, the shadow on the floor and the load."""
    points = [
        point
        for point, last in zip(pose.points_m, [None, *pose.points_m], strict=False)
        if last is None or math.dist(point, last) > 1e-6
    ]
    panel.polyline(_flat([(x, y, 0.0) for x, y, _ in points]), "shadow", 7.0)
    if points[0][2] > 0:
        panel.polyline(_flat([(*points[0][:2], 0.0), points[0]]), "link", 13.0)
    for index in range(len(points) - 1):
        panel.polyline(_flat(points[index : index + 2]), "link", 11.0 - 6.5 * index / (len(points) - 1))
    for rank, point in enumerate(points[:-1]):
        panel.dot(*_project(point), "joint", radius=max(2.0, 4.2 - 0.4 * rank))
    if pose.com_m:
        panel.polyline(_flat([points[-1], pose.com_m]), f"stem {kind}", 2.0)
        panel.dot(*_project(pose.com_m), f"payload {kind}", radius=6.5)


def _project(point: Vector) -> Point:
    """Return the axonometric projection of a point [m]: right and up [m]."""
    x, y, z = point
    right = -math.sin(AZIMUTH_RAD) * x + math.cos(AZIMUTH_RAD) * y
    depth = math.cos(AZIMUTH_RAD) * x + math.sin(AZIMUTH_RAD) * y
    return right, math.cos(ELEVATION_RAD) * z - math.sin(ELEVATION_RAD) * depth


def _flat(points: Sequence[Vector]) -> list[Point]:
    return [_project(point) for point in points]


def _panel(points: Sequence[Vector], width: float, margin: float) -> Panel:
    """Return a panel that holds the projection of points (n, 3) [m], with equal scales in both directions."""
    xs, ys = zip(*_flat(points), strict=True)
    inside = width - 2 * margin
    per_px = (max(xs) - min(xs)) / inside or 1.0
    height = min(max((max(ys) - min(ys)) / per_px, LEAST_HEIGHT * width), MOST_HEIGHT * width)
    per_px = max(per_px, (max(ys) - min(ys)) / height)
    middle, half = (max(xs) + min(xs)) / 2, 0.5 * per_px * inside
    ranges = (middle - half, middle + half), (min(ys), min(ys) + per_px * height)
    return Panel(width, round(height + 2 * margin), *ranges, margin, margin, margin, margin)


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
    drawn = [point for _, points in (*lines_m, *filter(None, [arm])) for point in points]
    far = 1.15 * max(abs(value) for point in drawn for value in point)
    edges: list[tuple[Vector, Vector]] = []
    for box in boxes_m:
        near = [[min(max(value, -far), far) for value in corner] for corner in box]
        corners = [tuple(near[(number >> axis) & 1][axis] for axis in range(3)) for number in range(8)]
        edges += [(corners[a], corners[a | 1 << axis]) for a in range(8) for axis in range(3) if not a >> axis & 1]
    length = nice_step(far, 3)
    tips = [[length * (axis == other) for other in range(3)] for axis in range(3)]
    panel = _panel([ORIGIN, *tips, *(end for edge in edges for end in edge), *drawn], SCENE_WIDTH, SCENE_MARGIN)

    def label(text: str, point: Vector) -> None:
        x, y = _project(point)
        panel.text(panel.x(x) + 4, panel.y(y) - 4, text, "tick")

    for edge in edges:
        panel.polyline(_flat(edge), "ring")
    if arm is not None:
        panel.polyline(_flat([ORIGIN, *arm[1]]), "link arm", 7.0, arm[0])
    for name, points in lines_m:
        panel.polyline(_flat(points), "flange-path")
        label(name, points[-1])
    for name, tip in zip("xyz", tips, strict=True):
        panel.polyline(_flat([ORIGIN, tip]), "link", 1.0)
        label(f"{name} {length:g} m", tip)
    panel.dot(*_project(ORIGIN), "joint", "base", 5.0)
    return page(
        "plan.html.j2", head, scene=panel.svg("Lines in space with the boxes of the cell"), arms=figures, **texts
    )


def curve_figures(
    name: str, time_s: Sequence[float], q_rad: Sequence[Sequence[float]], speed_percent: Sequence[Sequence[float]]
) -> list[tuple[str, Markup]]:
    """Draw position [rad] and speed [% of the planning limit] of each moving joint over one period at times [s]."""
    figures: list[tuple[str, Markup]] = []
    for joint, (angles, speeds) in enumerate(zip(q_rad, speed_percent, strict=True), start=1):
        title = f"{name}: J{joint}"
        degrees = [math.degrees(angle) for angle in angles]
        drawn = (("position [deg]", degrees, ()), ("speed [% of limit]", speeds, (-100.0, 100.0)))
        for label, values, about in drawn if any(speeds) else ():
            chart = line_chart(
                f"{title}, {label}",
                ("time [s]", label),
                [(time_s, values, "curve")],
                y_range=limits(values, include=about),
                size=(420.0, 200.0),
            )
            figures.append((title, chart))
    return figures
