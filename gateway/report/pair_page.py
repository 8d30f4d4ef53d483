"""Page of two arms: force or gap along the path for each embodiment, learning points, convergence per cycle.

The first three drawings are those of CN104379308 figures 17 to 19, with numbers. They show the force along the line
between the grippers over the path, for the comparison example, for impedance control alone and for the embodiment
that was run. For a pair that keeps a gap with distance sensors, the gap deviation replaces the force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from gateway.report import notation
from gateway.report.page import Head, made, page
from gateway.report.svg import Panel, Point, limits
from gateway.result.origin import Origin
from gateway.result.pair import CycleSummary, PairRunResult
from gateway.result.values import Numbers

WIDTH, HEIGHT = 560.0, 230.0
FIGURES = {"A": "figure 17", "B": "figure 18", "C8": "figure 19"}
COLOURS = 8
MOST_POINTS = 500


@dataclass(frozen=True, slots=True)
class Quantity:
    """Quantity of the figures: reading hint, unit and factor, digits, texts, sign and limit.

    `part` is drawn as a thin line without limit; `halves` are the half widths of the 95 % intervals in the first and
    the last cycle.
    """

    first: Callable[[PairRunResult], Numbers]
    last: Callable[[PairRunResult], Numbers]
    part: Callable[[PairRunResult], Numbers]
    halves: Callable[[PairRunResult], tuple[Numbers, Numbers]]
    largest: Callable[[CycleSummary], float]
    unit: str
    factor: float
    digits: int
    axis: str
    title: str
    error: str
    of_what: str
    below: str
    to_limit: bool
    sided: bool


FORCE = Quantity(
    first=lambda run: run.first_size_n,
    last=lambda run: run.last_size_n,
    part=lambda run: run.last_n,
    halves=lambda run: (run.first_half_n, run.last_half_n),
    largest=lambda cycle: cycle.force_n,
    unit="N",
    factor=1.0,
    digits=0,
    axis="force [N]",
    title="Force",
    error="force",
    of_what="internal force of the part",
    below="Size of the whole force, which the limit is on; shaded: its 95 % interval in the first and the last cycle, "
    "which is wide where friction hides the force. Thin grey: its part along the line between the grippers in "
    "the last cycle, positive where the workpiece is pulled.",
    to_limit=True,
    sided=False,
)
GAP = Quantity(
    first=lambda run: run.first_m,
    last=lambda run: run.last_m,
    part=lambda run: (),
    halves=lambda run: ((), ()),
    largest=lambda cycle: cycle.gap_m,
    unit="mm",
    factor=1e3,
    digits=3,
    axis="gap error [mm]",
    title="Gap",
    error="gap error",
    of_what="deviation of the gap from its setpoint",
    below="Largest deviation of all sensors.",
    to_limit=False,
    sided=True,
)


@dataclass(frozen=True, slots=True)
class Limited:
    """Quantity to draw, its limit in SI, and its source."""

    what: Quantity
    limit_si: float
    source: str

    @property
    def limit(self) -> float:
        """Return values in the display unit."""
        return self.what.factor * self.limit_si


@dataclass(frozen=True, slots=True)
class RunView:
    """A run for display, values in the display unit."""

    run: PairRunResult
    along: tuple[list[float], list[float]]
    part: list[float]
    largest: list[float]

    @property
    def kept(self) -> list[float]:
        """Return the known values along the path."""
        return [value for values in (*self.along, self.part) for value in values if math.isfinite(value)]


def render_pair(cell: str, bound: Limited, runs: Sequence[PairRunResult], origin: Origin | None = None) -> str:
    """Return the HTML page of a pair.

    Parameters
    ----------
    cell : str
        Name of it.
    bound : Limited
    runs : sequence of PairRunResult
        With at least one cycle each.
    origin : Origin, optional
        Date and program, and the files of the runs.
    """
    views = [_view(run, bound.what) for run in runs]
    several = [view for view in views if len(view.largest) > 1] or views
    what, knots = bound.what, [[float(cycle.knots) for cycle in view.run.cycles] for view in several]
    sizes = _per_cycle(
        f"Largest {what.title.lower()} per cycle",
        f"largest {what.error} [{what.unit}]",
        [view.largest for view in several],
        bound.limit if what.to_limit else None,
    )
    best = min(views, key=lambda view: view.largest[-1] if math.isfinite(view.largest[-1]) else math.inf)
    size = f"{notation.plain(best.largest[-1], bound.what.digits)} {bound.what.unit}"
    return page(
        "pair.html.j2",
        Head("Two arms, one workpiece", "Two arms, one workpiece", (("cell", cell), *made(origin))),
        origin=origin,
        what=what,
        status="good" if any(view.largest[-1] < bound.limit for view in views) else "bad",
        headline=f"{best.run.name}: largest {bound.what.error} {size} in the last cycle",
        limit=f"{bound.limit:g}",
        source=bound.source,
        columns=[
            *("run", "description", "speed", "cycles"),
            *(f"{which} cycle [{what.unit}]" for which in ("first", "last")),
            *(("last cycle [Nm]",) if what is FORCE else ()),
            *("learning points", "within the limit"),
        ],
        table=[_row(view, bound) for view in views],
        along=[(_caption(view, bound), _along(view, bound)) for view in views],
        convergence=[
            (f"Largest {what.of_what} per cycle", sizes),
            ("Learning points per cycle", _per_cycle("Learning points per cycle", "learning points [number]", knots)),
        ],
        key=[(f"c{place % COLOURS}", view.run.name) for place, view in enumerate(several)],
    )


def _view(run: PairRunResult, what: Quantity) -> RunView:
    first, last, part = (
        [what.factor * value for value in values] for values in (what.first(run), what.last(run), what.part(run))
    )
    return RunView(run, (first, last), part, [what.factor * what.largest(cycle) for cycle in run.cycles])


def _row(view: RunView, bound: Limited) -> list[str]:
    """Texts of the table: name, words, and numbers."""
    run, what = view.run, bound.what
    sizes = [notation.plain(value, what.digits) for value in (view.largest[0], view.largest[-1])]
    moment = [notation.plain(run.cycles[-1].moment_nm, 1)] if what is FORCE else []
    kept = "yes" if view.largest[-1] < bound.limit else "no"
    return [
        run.name,
        run.text,
        f"{run.speed:g}",
        f"{len(run.cycles)}",
        *sizes,
        *moment,
        f"{run.cycles[-1].knots}",
        kept,
    ]


def _caption(view: RunView, bound: Limited) -> Markup:
    run, what = view.run, bound.what
    figure = FIGURES.get(run.name)
    named = f" ({figure} of the patent)" if figure else ""
    worst = f"{notation.plain(view.largest[-1], what.digits)} {what.unit}"
    return Markup("<b>{}</b> {}{}, speed {:g}: largest {} {}").format(
        run.name, run.text, named, run.speed, what.error, worst
    )


def _along(view: RunView, bound: Limited) -> Markup:
    run, what, limit, known = view.run, bound.what, bound.limit, view.kept
    x_mm = [1e3 * value for value in run.x_m]
    # a gap uses a small part of its range: on the scale of the range it would be invisible
    sized = bool(view.along[1])
    to_limit = sized and (what.to_limit or max(map(abs, known), default=0.0) > 0.5 * limit)
    sides = (-limit, limit) if what.sided else (limit,)
    frame = tuple(1.2 * side for side in sides) + (0.0,) if to_limit else (0.0,)
    panel = Panel(WIDTH, HEIGHT, (run.s_m[0], run.s_m[-1]), limits(known, include=frame))
    low, high = panel.y_range
    if to_limit:
        panel.box(panel.x_range, (limit, high), "over")
        if what.sided:
            panel.box(panel.x_range, (low, -limit), "over")
    panel.y_axis(what.axis)
    panel.x_axis(f"position along the path [m]; gripper X {min(x_mm):.0f} to {max(x_mm):.0f} mm")
    for side in sides if to_limit else ():
        panel.horizontal(side, "limit")
    first, last = view.along
    if len(run.cycles) > 1:
        panel.polyline(_thinned(run.s_m, first), "before-line")
    for values, half, kind in zip(view.along, what.halves(run), ("force-band before", "force-band"), strict=True):
        if not half:
            continue
        rows = range(0, len(half), max(1, len(half) // MOST_POINTS))
        low_side = [max(values[row] - what.factor * half[row], 0.0) for row in rows]
        high_side = [min(values[row] + what.factor * half[row], high) for row in rows]
        panel.area([run.s_m[row] for row in rows], low_side, high_side, kind)
    panel.polyline(_thinned(run.s_m, view.part), "part-line")
    panel.polyline(_thinned(run.s_m, last), "force")
    for knot in run.knots_s_m:
        panel.dot(knot, 0.0, "knot", f"learning point at {knot:.3f} m", 2.6)
    return panel.svg(f"{what.title} along the path for {run.name}")


def _thinned(x: Sequence[float], y: Sequence[float]) -> list[Point]:
    """Return evenly spaced points along the path, and the largest of the table; none without measurement."""
    rows = set(range(0, len(y), max(1, len(y) // MOST_POINTS)))
    rows |= {max(range(len(y)), key=lambda row: abs(y[row]) if math.isfinite(y[row]) else 0.0)} if y else set()
    return [(x[row], y[row]) for row in sorted(rows)]


def _per_cycle(describe: str, label: str, curves: Sequence[Sequence[float]], limit: float | None = None) -> Markup:
    """A curve per run over its cycles, and the limit of the quantity."""
    longest = max(map(len, curves), default=1)
    ends = (0.5, longest + 0.5)
    panel = Panel(WIDTH, HEIGHT, ends, limits([value for curve in curves for value in curve], include=(0.0,)))
    panel.y_axis(label)
    panel.x_axis("cycle", min(5, longest))
    for place, curve in enumerate(curves):
        kind = f"c{place % COLOURS}"
        points = [(float(cycle), value) for cycle, value in enumerate(curve, start=1)]
        panel.polyline(points, f"trace {kind}")
        for x, y in points:
            if math.isfinite(y):
                panel.dot(x, y, f"spot {kind}", radius=2.2)
    if limit is not None:
        panel.horizontal(limit, "limit")
    return panel.svg(describe)
