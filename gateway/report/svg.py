"""SVG with axes, scales, ticks and marks, written as text without a drawing library."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup, escape

MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 72.0, 12.0, 12.0, 40.0
Point = tuple[float, float]


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

    def y_axis(self, label: str, count: int = 4) -> None:
        """Grid lines with numbers, and the label with its unit."""
        values = ticks(*self.y_range, count)
        step = values[1] - values[0] if len(values) > 1 else abs(values[0]) or 1.0
        for value in values:
            y = self.y(value)
            kind = "zero" if abs(value) < 1e-12 else "grid"
            self.add(
                f'<line class="{kind}" x1="{self.left}" x2="{self.width - self.right}" y1="{y:.1f}" y2="{y:.1f}"/>'
            )
            self.text(self.left - 6, y + 3.5, tick_text(value, step), "tick end")
        self.y_label(label)

    def y_label(self, label: str) -> None:
        """Label beside the vertical axis."""
        middle = (self.top + self.height - self.bottom) / 2
        self.add(f'<text class="label mid" transform="translate(12 {middle:.1f}) rotate(-90)">{escape(label)}</text>')

    def x_axis(self, label: str, count: int = 5) -> None:
        """Numbers under the axis, and the label with its unit."""
        values = ticks(*self.x_range, count)
        step = values[1] - values[0] if len(values) > 1 else abs(values[0]) or 1.0
        base = self.height - self.bottom
        for value in values:
            x = self.x(value)
            self.add(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{self.top}" y2="{base}"/>')
            self.text(x, base + 14, tick_text(value, step), "tick mid")
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

    def polyline(self, points: Sequence[Point], kind: str) -> None:
        """Open line through data positions; a position that is not known is left out."""
        known = [(x, y) for x, y in points if math.isfinite(x) and math.isfinite(y)]
        self.add(f'<polyline class="{kind}" points="{self._places(known)}"/>')

    def area(self, xs: Sequence[float], low: Sequence[float], high: Sequence[float], kind: str) -> None:
        """Filled band between two curves."""
        outline = [*zip(xs, high, strict=True), *reversed(list(zip(xs, low, strict=True)))]
        self.add(f'<polygon class="{kind}" points="{self._places(outline)}"/>')

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
