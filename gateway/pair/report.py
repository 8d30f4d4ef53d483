"""The report on a pair: force along the path for every way of running it, learning points, convergence per cycle.

The first three drawings are those of CN104379308 figures 17 to 19, with numbers: force along the line between the
grippers over the way, for the comparison example, for impedance alone and for the embodiment that was run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from markupsafe import Markup, escape

from gateway.report.svg import Panel, Point, limits

Json = Mapping[str, Any]

WIDTH, HEIGHT = 560.0, 230.0
FIGURES = {"A": "figure 17", "B": "figure 18", "C8": "figure 19"}
STYLE = """
svg .force { fill: none; stroke: var(--after); stroke-width: 1.6; }
svg .before-line { fill: none; stroke: var(--before); stroke-width: 1.2; }
svg .limit { stroke: var(--bad); stroke-width: 1.2; stroke-dasharray: 5 4; }
svg .over { fill: #fbe3e4; }
svg .knot { fill: var(--ink); }
svg .curve { fill: none; stroke-width: 1.5; }
"""
COLOURS = ("#66717f", "#d2660a", "#0a63c2", "#0d8a7a", "#7a4bc4", "#b0452f", "#1a7a49", "#93640a")


def render_pair(data: Json) -> str:
    """HTML page of a pair.

    Parameters
    ----------
    data : mapping
        `cell`, `date`, `force_limit_n`, `source` (how the force is known), and `rows`, each with `name`, `text`,
        `speed`, `s_m`, `x_m` (way and gripper position per command), `first_n`, `last_n` (force along the line between
        the grippers in the first and the last cycle), `knots_s_m`, and `cycles`: per cycle `force_n`, `moment_nm`,
        `knots`.

    Returns
    -------
    str
        One file, nothing is fetched when it opens.
    """
    css = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8") + STYLE
    rows = [{**row, "cycles": [_known(cycle) for cycle in row["cycles"]]} for row in data["rows"]]
    several = [row for row in rows if len(row["cycles"]) > 1] or rows
    parts = [
        f"<header class='top'><h1>Two arms, one workpiece: {escape(data['cell'])}</h1>"
        f"<div class='meta'>{escape(data['date'])}</div></header>",
        f"<p class='lead'>Force inside the part, {escape(data['source'])}. The limit is"
        f" {data['force_limit_n']:g} N; dashed red.</p>",
        _table(rows, float(data["force_limit_n"])),
        "<h2>Force along the path</h2><p>Force along the line between the grippers, positive where the part is pulled."
        " Orange: first cycle, blue: last cycle, dots: learning points.</p><div class='panels'>",
        *[_figure(_along(row, float(data["force_limit_n"])), _caption(row)) for row in rows],
        "</div><h2>Convergence</h2><div class='panels'>",
        _figure(
            _convergence(several, float(data["force_limit_n"])),
            "Largest force inside the part per cycle; " + _key(several),
        ),
        _figure(_knots(several), "Learning points per cycle; " + _key(several)),
        "</div>",
    ]
    body = "\n".join(str(part) for part in parts)
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Two arms, one workpiece</title>"
        f"<style>{css}</style></head><body><main>{body}</main></body></html>\n"
    )


def _known(cycle: Json) -> Json:
    return {key: math.nan if cycle.get(key) is None else cycle[key] for key in ("force_n", "moment_nm", "knots")}


def _caption(row: Json) -> Markup:
    figure = FIGURES.get(str(row["name"]))
    named = f" ({figure} of the patent)" if figure else ""
    worst = row["cycles"][-1]["force_n"]
    return Markup("<b>{}</b> {}{}, speed {:g}: largest force {:.0f} N").format(
        row["name"], row["text"], named, row["speed"], worst
    )


def _figure(drawing: Markup, caption: Markup | str) -> Markup:
    return Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(drawing, caption)


def _along(row: Json, limit_n: float) -> Markup:
    x_mm = [1e3 * value for value in row["x_m"]]
    way = [float(value) for value in row["s_m"]]
    first, last = row.get("first_n") or [], row["last_n"]
    panel = Panel(WIDTH, HEIGHT, (way[0], way[-1]), limits([*first, *last], include=(-1.2 * limit_n, 1.2 * limit_n)))
    low, high = panel.y_range
    panel.box(panel.x_range, (limit_n, high), "over")
    panel.box(panel.x_range, (low, -limit_n), "over")
    panel.y_axis("Fx [N]")
    panel.x_axis(f"way along the path [m]; gripper X {min(x_mm):.0f} to {max(x_mm):.0f} mm")
    for side in (-limit_n, limit_n):
        panel.segment((way[0], side), (way[-1], side), "limit")
    if first and len(row["cycles"]) > 1:
        panel.polyline(_thinned(way, first), "before-line")
    panel.polyline(_thinned(way, last), "force")
    for knot in row["knots_s_m"]:
        panel.dot(float(knot), 0.0, "knot", f"learning point at {knot:.3f} m", 2.6)
    return panel.svg(f"Force along the path for {row['name']}")


def _thinned(x: Sequence[float], y: Sequence[float]) -> list[Point]:
    step = max(1, len(y) // 500)
    return [(a, float(b)) for a, b in zip(x[::step], y[::step], strict=True) if math.isfinite(float(b))]


def _convergence(rows: Sequence[Json], limit_n: float) -> Markup:
    forces = [[float(cycle["force_n"]) for cycle in row["cycles"]] for row in rows]
    panel = Panel(WIDTH, HEIGHT, (0.5, _longest(rows) + 0.5), limits([v for f in forces for v in f], include=(0.0,)))
    panel.y_axis("largest force [N]")
    panel.x_axis("cycle")
    panel.segment((0.5, limit_n), (_longest(rows) + 0.5, limit_n), "limit")
    _curves(panel, forces)
    return panel.svg("Largest force per cycle")


def _knots(rows: Sequence[Json]) -> Markup:
    counts = [[float(cycle["knots"]) for cycle in row["cycles"]] for row in rows]
    panel = Panel(WIDTH, HEIGHT, (0.5, _longest(rows) + 0.5), limits([v for c in counts for v in c], include=(0.0,)))
    panel.y_axis("learning points [number]")
    panel.x_axis("cycle")
    _curves(panel, counts)
    return panel.svg("Learning points per cycle")


def _curves(panel: Panel, values: Sequence[Sequence[float]]) -> None:
    for number, row in enumerate(values):
        colour = COLOURS[number % len(COLOURS)]
        points = [(float(cycle), value) for cycle, value in enumerate(row, start=1) if math.isfinite(value)]
        places = " ".join(f"{panel.x(x):.1f},{panel.y(y):.1f}" for x, y in points)
        panel.add(f'<polyline class="curve" style="stroke:{colour}" points="{places}"/>')
        for x, y in points:
            panel.add(f'<circle style="fill:{colour}" cx="{panel.x(x):.1f}" cy="{panel.y(y):.1f}" r="2.2"/>')


def _key(rows: Sequence[Json]) -> Markup:
    names = [
        Markup("<span class='swatch' style='background:{}'></span>{}").format(COLOURS[i % len(COLOURS)], row["name"])
        for i, row in enumerate(rows)
    ]
    return Markup(" ").join(names)


def _longest(rows: Sequence[Json]) -> int:
    return max((len(row["cycles"]) for row in rows), default=1)


def _table(rows: Sequence[Json], limit_n: float) -> Markup:
    head = Markup("").join(
        Markup("<th{}>{}</th>").format(Markup(" class='n'" if number > 1 else ""), name)
        for number, name in enumerate(
            ("row", "", "speed", "cycles", "first [N]", "last [N]", "last [Nm]", "learning points", "inside the limit")
        )
    )
    lines = [_line(row, limit_n) for row in rows]
    return Markup("<h2>Largest force inside the part</h2><table><tr>{}</tr>{}</table>").format(
        head, Markup("").join(lines)
    )


def _line(row: Json, limit_n: float) -> Markup:
    cycles = row["cycles"]
    kept = "yes" if cycles[-1]["force_n"] < limit_n else "no"
    numbers = (
        f"{row['speed']:g}",
        f"{len(cycles)}",
        f"{cycles[0]['force_n']:.0f}",
        f"{cycles[-1]['force_n']:.0f}",
        f"{cycles[-1]['moment_nm']:.1f}",
        f"{cycles[-1]['knots']}",
        kept,
    )
    cells = Markup("").join(Markup("<td class='n'>{}</td>").format(value) for value in numbers)
    return Markup("<tr><td><b>{}</b></td><td>{}</td>{}</tr>").format(row["name"], row["text"], cells)
