"""SVG with axes, scales, ticks and marks, written as text without a drawing library.

`line_chart` draws curves, points and bands over one quantity; `row_panel` frames charts with a row a name (bars,
dumbbells, intervals); every other chart adds marks to a `Panel`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby

from markupsafe import Markup, escape

MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 72.0, 12.0, 12.0, 40.0
Point = tuple[float, float]
#: Abscissae, ordinates and CSS class of a curve; of a set of points with their radius [px] and text on hovering.
Curve = tuple[Sequence[float], Sequence[float], str]
Dots = tuple[Sequence[float], Sequence[float], str, float, str]
#: A logarithmic axis over fewer decades than this has ticks at 1, 2 and 5 of each, a longer one at 1 only.
FEW_DECADES = 2.7


@dataclass(frozen=True, slots=True)
class Scale:
    """Linear map from data to pixels."""

    low: float
    high: float
    start_px: float
    end_px: float

    def __call__(self, value: float) -> float:
        """Return the pixel of a value."""
        span = (self.high - self.low) or 1.0
        return self.start_px + (value - self.low) / span * (self.end_px - self.start_px)


def nice_step(span: float, count: int) -> float:
    """Return the largest step of 1, 2 or 5 times a power of ten with at least `count` intervals over `span` (> 0)."""
    raw = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    return power * next((factor for factor in (5.0, 2.0, 1.0) if factor * power <= raw * (1 + 1e-9)), 1.0)


def ticks(low: float, high: float, count: int = 4) -> list[float]:
    """Return round values within [low, high]."""
    if not high > low:
        return [low]
    step = nice_step(high - low, count)
    first = math.ceil(low / step - 1e-9)
    return [index * step for index in range(first, math.floor(high / step + 1e-9) + 1)]


def tick_text(value: float, step: float) -> str:
    """Return a tick label with the decimals of the step and a minus sign."""
    digits = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 0
    text = f"{value:.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}") if float(text) != 0 else text.lstrip("-")


def limits(values: Iterable[float], *, include: Sequence[float] = (), pad: float = 0.06) -> Point:
    """Return the range of the finite values and of `include`, slightly widened."""
    finite = [value for value in values if math.isfinite(value)]
    finite += list(include)
    if not finite:
        return -1.0, 1.0
    low, high = min(finite), max(finite)
    margin = pad * (high - low) if high > low else max(abs(high) * 0.1, 1e-3)
    return low - margin, high + margin


@dataclass(slots=True)
class Panel:
    """Figure with a horizontal and a vertical scale; elements are appended in drawing order."""

    width: float
    height: float
    x_range: Point
    y_range: Point
    left: float = MARGIN_LEFT
    right: float = MARGIN_RIGHT
    top: float = MARGIN_TOP
    bottom: float = MARGIN_BOTTOM
    parts: list[str] = field(default_factory=list)

    @property
    def x(self) -> Scale:
        """Horizontal scale."""
        return Scale(*self.x_range, self.left, self.width - self.right)

    @property
    def y(self) -> Scale:
        """Vertical scale, upwards."""
        return Scale(*self.y_range, self.height - self.bottom, self.top)

    def add(self, text: str) -> None:
        """Append an element unchanged."""
        self.parts.append(text)

    def y_axis(self, label: str, count: int = 4, *, log: bool = False) -> None:
        """Grid lines with numbers, and the label with its unit; `log`: the range is in decades."""
        for value, text in _marks(self.y_range, count, log=log):
            kind = "zero" if abs(value) < 1e-12 and not log else "grid"
            self.segment((self.x_range[0], value), (self.x_range[1], value), kind)
            self.text(self.left - 6, self.y(value) + 3.5, text, "tick end")
        middle = (self.top + self.height - self.bottom) / 2
        self.add(f'<text class="label mid" transform="translate(12 {middle:.1f}) rotate(-90)">{escape(label)}</text>')

    def x_axis(self, label: str, count: int = 5, *, log: bool = False) -> None:
        """Numbers under the axis, and the label with its unit; `log`: the range is in decades."""
        for value, text in _marks(self.x_range, count, log=log):
            self.vertical(value, "grid")
            self.text(self.x(value), self.height - self.bottom + 14, text, "tick mid")
        self.x_label(label)

    def x_label(self, label: str) -> None:
        """Label under the horizontal axis."""
        self.text((self.left + self.width - self.right) / 2, self.height - 6, label, "label mid")

    def text(self, x: float, y: float, text: str, kind: str) -> None:
        """Text at a pixel position."""
        self.add(f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>')

    def dot(self, x: float, y: float, kind: str, title: str = "", radius: float = 3.4) -> None:
        """Round mark at a data position; `title` shows on hovering."""
        hint = f"<title>{escape(title)}</title>" if title else ""
        place = f'cx="{self.x(x):.1f}" cy="{self.y(y):.1f}" r="{radius}"'
        self.add(f'<circle class="{kind}" {place}>{hint}</circle>')

    def triangle(self, x: float, y: float, side: int, kind: str, size: float = 4.2) -> None:
        """Mark at a data position that points up (`side` 1) or down (-1)."""
        px, py = self.x(x), self.y(y)
        corners = ((0.0, -1.15 * side), (1.0, 0.75 * side), (-1.0, 0.75 * side))
        places = " ".join(f"{px + size * dx:.1f},{py + size * dy:.1f}" for dx, dy in corners)
        self.add(f'<polygon class="{kind}" points="{places}"/>')

    def segment(self, start: Point, end: Point, kind: str) -> None:
        """Straight line between two data positions."""
        (x0, y0), (x1, y1) = ((self.x(x), self.y(y)) for x, y in (start, end))
        self.add(f'<line class="{kind}" x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"/>')

    def vertical(self, x: float, kind: str) -> None:
        """Line over the height of the panel."""
        self.segment((x, self.y_range[0]), (x, self.y_range[1]), kind)

    def horizontal(self, y: float, kind: str) -> None:
        """Line over the width of the panel."""
        self.segment((self.x_range[0], y), (self.x_range[1], y), kind)

    def row_name(self, row: float, name: str, kind: str = "name end") -> None:
        """Name of a row, left of the panel."""
        self.text(self.left - 8, self.y(row) + 4, name, kind)

    def polyline(self, points: Sequence[Point], kind: str, width_px: float | None = None, title: str = "") -> None:
        """Open line through data positions, interrupted at positions that are not known; one alone is a round mark."""
        stroke = "" if width_px is None else f' stroke-width="{width_px:.1f}"'
        hint = f"<title>{escape(title)}</title>" if title else ""
        for known, stretch in groupby(points, key=lambda point: math.isfinite(point[0]) and math.isfinite(point[1])):
            if known:
                places = list(stretch)
                places = places if len(places) > 1 else 2 * places
                self.add(f'<polyline class="{kind}"{stroke} points="{self._places(places)}">{hint}</polyline>')

    def polygon(self, points: Iterable[Point], kind: str) -> None:
        """Filled outline through data positions."""
        self.add(f'<polygon class="{kind}" points="{self._places(points)}"/>')

    def area(self, xs: Sequence[float], low: Sequence[float], high: Sequence[float], kind: str) -> None:
        """Filled band between two curves."""
        self.polygon([*zip(xs, high, strict=True), *reversed(list(zip(xs, low, strict=True)))], kind)

    def box(self, x: Point, y: Point, kind: str) -> None:
        """Filled rectangle between data positions, cut at the panel."""
        x0, x1 = sorted(self._inside(self.x(value), self.left, self.width - self.right) for value in x)
        y0, y1 = sorted(self._inside(self.y(value), self.top, self.height - self.bottom) for value in y)
        self.add(f'<rect class="{kind}" x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}"/>')

    def svg(self, describe: str) -> Markup:
        """The drawing; `describe` is read aloud in place of it."""
        size = f'viewBox="0 0 {self.width:g} {self.height:g}"'
        body = "".join(self.parts)
        return Markup(f'<svg {size} role="img" aria-label="{escape(describe)}">{body}</svg>')

    def _places(self, points: Iterable[Point]) -> str:
        return " ".join(f"{self.x(x):.1f},{self.y(y):.1f}" for x, y in points)

    @staticmethod
    def _inside(value: float, low: float, high: float) -> float:
        return min(max(value, low), high)


def _marks(ends: Point, count: int, *, log: bool) -> list[tuple[float, str]]:
    """Return position and label of each tick of an axis; `log`: `ends` and positions are decades."""
    low, high = ends
    if not log:
        values = ticks(low, high, count)
        step = values[1] - values[0] if len(values) > 1 else abs(values[0]) or 1.0
        return [(value, tick_text(value, step)) for value in values]
    return [
        (place, tick_text(factor * 10.0**exponent, 10.0 ** min(exponent, 0)))
        for exponent in range(math.floor(low), math.ceil(high) + 1)
        for factor in ((1, 2, 5) if high - low < FEW_DECADES else (1,))
        if low <= (place := exponent + math.log10(factor)) <= high
    ]


def line_chart(
    describe: str,
    labels: tuple[str, str],
    lines: Sequence[Curve],
    *,
    dots: Sequence[Dots] = (),
    bands: Sequence[tuple[Sequence[float], Sequence[float], Sequence[float], str]] = (),
    x_range: Point | None = None,
    y_range: Point | None = None,
    size: Point = (330.0, 170.0),
    left: float = MARGIN_LEFT,
    vertical: float | None = None,
) -> Markup:
    """Draw curves over one quantity, with points below and confidence bands around them.

    Parameters
    ----------
    describe : str
        Read aloud in place of the chart.
    labels : (str, str)
        Of the horizontal and the vertical axis, with their units.
    lines : sequence of (x, y, CSS class)
    dots : sequence of (x, y, CSS class, radius [px], format of the text of a point by its ordinate `y`)
    bands : sequence of (x, low, high, CSS class)
        Cut at the panel.
    x_range, y_range : (low, high), optional
        Range of all that is drawn by default.
    size : (width, height) [px]
    left : float
        Margin for the numbers of the vertical axis [px].
    vertical : float, optional
        Abscissa of a vertical line, such as the moment of a stop.
    """
    x_range = x_range or limits((x for xs, *_ in (*lines, *dots) for x in xs), pad=0.0)
    y_range = y_range or limits(y for _, ys, *_ in (*lines, *dots) for y in ys)
    panel = Panel(*size, x_range, y_range, left=left)
    panel.y_axis(labels[1])
    panel.x_axis(labels[0], round(size[0] / 90.0))
    if vertical is not None:
        panel.vertical(vertical, "limit")
    for xs, low, high, kind in bands:
        below, above = ([min(max(value, panel.y_range[0]), panel.y_range[1]) for value in edge] for edge in (low, high))
        panel.area(xs, below, above, kind)
    for xs, ys, kind, radius, title in dots:
        for x, y in zip(xs, ys, strict=True):
            if math.isfinite(x) and math.isfinite(y):
                panel.dot(x, y, kind, title.format(y=y), radius)
    for xs, ys, kind in lines:
        panel.polyline(list(zip(xs, ys, strict=True)), kind)
    return panel.svg(describe)


def row_panel(
    names: Sequence[str],
    x_range: Point,
    x_label: str,
    *,
    size: Point = (560.0, 26.0),
    left: float = 34.0,
    right: float = MARGIN_RIGHT,
    mark: tuple[float, str] | None = None,
    shade: Point | None = None,
    log: bool = False,
    count: int = 5,
) -> Panel:
    """Return a panel with a row for each name, from the top; the rows are 0, 1, 2 ... on its vertical scale.

    Parameters
    ----------
    names : sequence of str
    x_range : (low, high)
    x_label : str
    size : (float, float)
        Width of the panel, height of a row [px].
    left, right : float
        Margins for names and values [px].
    mark : (float, str), optional
        Vertical line with its text above the panel.
    shade : (low, high), optional
        Shaded range behind the rows.
    log : bool
        The range is in decades.
    count : int
        Least number of intervals between ticks.
    """
    top = MARGIN_TOP if mark is None else 2.0 * MARGIN_TOP
    height = top + size[1] * len(names) + MARGIN_BOTTOM
    panel = Panel(size[0], height, x_range, (len(names) - 0.5, -0.5), left, right, top)
    if shade is not None:
        panel.box(shade, panel.y_range, "floor")
    panel.x_axis(x_label, count, log=log)
    if mark is not None:
        panel.vertical(mark[0], "mark")
        panel.text(panel.x(mark[0]), 16, mark[1], "label mid")
    for row, name in enumerate(names):
        panel.row_name(row, name)
    return panel
