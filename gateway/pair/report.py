"""The report on a pair: force along the path for every way of running it, learning points, convergence per cycle.

The first three drawings are those of CN104379308 figures 17 to 19, with numbers: force along the line between the
grippers over the way, for the comparison example, for impedance alone and for the embodiment that was run. A pair that
keeps a gap by distance sensors has the gap's deviation in place of the force.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class Quantity:
    """What is drawn: keys of a row and of its cycles, unit and factor to it, limit in that unit, digits, words."""

    along: tuple[str, str]
    per_cycle: str
    unit: str
    factor: float
    limit: float
    digits: int
    axis: str
    title: str
    largest: str
    lead: str
    below: str


def _quantity(data: Json) -> Quantity:
    if "gap_limit_m" in data:
        limit_mm = 1e3 * float(data["gap_limit_m"])
        return Quantity(
            ("first_m", "last_m"), "gap_m", "mm", 1e3, limit_mm, 3, "gap error [mm]", "Gap", "deviation of the gap",
            f"Deviation of the gap from the demanded one, {data['source']}. {limit_mm:g} mm stop both; dashed red.",
            "Of all sensors the one that is furthest off.",
        )  # fmt: skip
    limit_n = float(data["force_limit_n"])
    return Quantity(
        ("first_n", "last_n"), "force_n", "N", 1.0, limit_n, 0, "Fx [N]", "Force", "force inside the part",
        f"Force inside the part, {data['source']}. The limit is {limit_n:g} N; dashed red.",
        "Force along the line between the grippers, positive where the part is pulled.",
    )  # fmt: skip


def render_pair(data: Json) -> str:
    """HTML page of a pair.

    Parameters
    ----------
    data : mapping
        `cell`, `date`, `force_limit_n`, `source` (how the force is known), and `rows`, each with `name`, `text`,
        `speed`, `s_m`, `x_m` (way and gripper position per command), `first_n`, `last_n` (force along the line between
        the grippers in the first and the last cycle), `knots_s_m`, and `cycles`: per cycle `force_n`, `moment_nm`,
        `knots`. With distance sensors `gap_limit_m`, `first_m`, `last_m`, and per cycle `gap_m` in place of forces.

    Returns
    -------
    str
        One file, nothing is fetched when it opens.
    """
    css = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8") + STYLE
    what = _quantity(data)
    rows = [{**row, "cycles": [_known(cycle, what) for cycle in row["cycles"]]} for row in data["rows"]]
    several = [row for row in rows if len(row["cycles"]) > 1] or rows
    parts = [
        f"<header class='top'><h1>Two arms, one workpiece: {escape(data['cell'])}</h1>"
        f"<div class='meta'>{escape(data['date'])}</div></header>",
        f"<p class='lead'>{escape(what.lead)}</p>",
        _table(rows, what),
        f"<h2>{what.title} along the path</h2><p>{what.below}"
        " Orange: first cycle, blue: last cycle, dots: learning points.</p><div class='panels'>",
        *[_figure(_along(row, what), _caption(row, what)) for row in rows],
        "</div><h2>Convergence</h2><div class='panels'>",
        _figure(_convergence(several, what), f"Largest {what.largest} per cycle; " + _key(several)),
        _figure(_knots(several), "Learning points per cycle; " + _key(several)),
        "</div>",
    ]
    body = "\n".join(str(part) for part in parts)
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Two arms, one workpiece</title>"
        f"<style>{css}</style></head><body><main>{body}</main></body></html>\n"
    )


def _known(cycle: Json, what: Quantity) -> Json:
    """Figures of a cycle: the drawn one in its unit as `largest`."""
    found = {key: math.nan if cycle.get(key) is None else cycle[key] for key in (what.per_cycle, "moment_nm", "knots")}
    return found | {"largest": what.factor * float(found[what.per_cycle])}


def _caption(row: Json, what: Quantity) -> Markup:
    figure = FIGURES.get(str(row["name"]))
    named = f" ({figure} of the patent)" if figure else ""
    worst = f"{row['cycles'][-1]['largest']:.{what.digits}f} {what.unit}"
    return Markup("<b>{}</b> {}{}, speed {:g}: largest {} {}").format(
        row["name"], row["text"], named, row["speed"], what.title.lower() + " error" * (what.unit == "mm"), worst
    )


def _figure(drawing: Markup, caption: Markup | str) -> Markup:
    return Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(drawing, caption)


def _values(given: Sequence[float | None], what: Quantity) -> list[float]:
    return [math.nan if value is None else what.factor * float(value) for value in given]


def _along(row: Json, what: Quantity) -> Markup:
    x_mm = [1e3 * value for value in row["x_m"]]
    way = [float(value) for value in row["s_m"]]
    first, last = (_values(row.get(key) or [], what) for key in what.along)
    known = [value for value in (*first, *last) if math.isfinite(value)]
    # a gap stays far inside its range: drawn to the range's scale nothing of it would be seen
    shown = what.unit == "N" or max(map(abs, known), default=0.0) > 0.5 * what.limit
    panel = Panel(WIDTH, HEIGHT, (way[0], way[-1]), limits(known, include=_frame(what) if shown else (0.0,)))
    low, high = panel.y_range
    if shown:
        panel.box(panel.x_range, (what.limit, high), "over")
        panel.box(panel.x_range, (low, -what.limit), "over")
    panel.y_axis(what.axis)
    panel.x_axis(f"way along the path [m]; gripper X {min(x_mm):.0f} to {max(x_mm):.0f} mm")
    for side in (-what.limit, what.limit) if shown else ():
        panel.segment((way[0], side), (way[-1], side), "limit")
    if first and len(row["cycles"]) > 1:
        panel.polyline(_thinned(way, first), "before-line")
    panel.polyline(_thinned(way, last), "force")
    for knot in row["knots_s_m"]:
        panel.dot(float(knot), 0.0, "knot", f"learning point at {knot:.3f} m", 2.6)
    return panel.svg(f"{what.title} along the path for {row['name']}")


def _frame(what: Quantity) -> tuple[float, float]:
    return -1.2 * what.limit, 1.2 * what.limit


def _thinned(x: Sequence[float], y: Sequence[float]) -> list[Point]:
    step = max(1, len(y) // 500)
    return [(a, float(b)) for a, b in zip(x[::step], y[::step], strict=True) if math.isfinite(float(b))]


def _convergence(rows: Sequence[Json], what: Quantity) -> Markup:
    sizes = [[float(cycle["largest"]) for cycle in row["cycles"]] for row in rows]
    panel = Panel(WIDTH, HEIGHT, (0.5, _longest(rows) + 0.5), limits([v for f in sizes for v in f], include=(0.0,)))
    panel.y_axis("largest force [N]" if what.unit == "N" else "largest gap error [mm]")
    panel.x_axis("cycle")
    if what.unit == "N":
        panel.segment((0.5, what.limit), (_longest(rows) + 0.5, what.limit), "limit")
    _curves(panel, sizes)
    return panel.svg(f"Largest {what.title.lower()} per cycle")


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


def _table(rows: Sequence[Json], what: Quantity) -> Markup:
    moment = ("last [Nm]",) if what.unit == "N" else ()
    head = Markup("").join(
        Markup("<th{}>{}</th>").format(Markup(" class='n'" if number > 1 else ""), name)
        for number, name in enumerate(
            (
                "row",
                "",
                "speed",
                "cycles",
                f"first [{what.unit}]",
                f"last [{what.unit}]",
                *moment,
                "learning points",
                "inside the limit",
            )  # fmt: skip
        )
    )
    lines = [_line(row, what) for row in rows]
    return Markup("<h2>Largest {}</h2><table><tr>{}</tr>{}</table>").format(what.largest, head, Markup("").join(lines))


def _line(row: Json, what: Quantity) -> Markup:
    cycles = row["cycles"]
    kept = "yes" if cycles[-1]["largest"] < what.limit else "no"
    moment = (f"{cycles[-1]['moment_nm']:.1f}",) if what.unit == "N" else ()
    numbers = (
        f"{row['speed']:g}",
        f"{len(cycles)}",
        f"{cycles[0]['largest']:.{what.digits}f}",
        f"{cycles[-1]['largest']:.{what.digits}f}",
        *moment,
        f"{cycles[-1]['knots']}",
        kept,
    )
    cells = Markup("").join(Markup("<td class='n'>{}</td>").format(value) for value in numbers)
    return Markup("<tr><td><b>{}</b></td><td>{}</td>{}</tr>").format(row["name"], row["text"], cells)
