"""Page on the repeatability of a load: spread over the repetitions and stated standard deviations."""

from __future__ import annotations

from markupsafe import Markup

from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits
from gateway.result.interval import half_width
from gateway.result.numerals import interval_text, significant
from gateway.result.repeatability import (
    CANNOT_TELL,
    HOLD,
    TOO_LARGE,
    TOO_SMALL,
    Repeatability,
    RepeatedQuantity,
    conclusion,
)

TAGS = {HOLD: "pass", TOO_SMALL: "fail", TOO_LARGE: "warn", CANNOT_TELL: "warn"}
STATUS = {HOLD: "good", TOO_SMALL: "bad", TOO_LARGE: "open", CANNOT_TELL: "open"}
COLUMNS = (
    "where",
    "quantity",
    "mean",
    "spread",
    "expected",
    "stated",
    "spread / expected",
    "beyond 3",
    "verdict",
)
WIDTH, HEIGHT = 460.0, 230.0


def render_repeatability(found: Repeatability) -> str:
    """Return the HTML page."""
    about = (("robot", found.robot), ("repetitions", str(len(found.files))))
    return page(
        "repeatability.html.j2",
        Head(f"Repeatability: {found.robot}", "Repeatability", about),
        status="open" if found.verdict == HOLD and any(row.far for row in found.quantities) else STATUS[found.verdict],
        headline=conclusion(found),
        columns=COLUMNS,
        rows=[(TAGS[row.outcome], cells(row)) for row in found.quantities],
        remarks=found.remarks,
        figures=[(f"{row.where}: {_name(row)}", _figure(row, _days(found))) for row in found.quantities],
        files=list(zip(range(1, len(found.files) + 1), found.files, found.measured, strict=True)),
    )


def cells(row: RepeatedQuantity) -> tuple[str, ...]:
    """Return the texts of a quantity, as `COLUMNS`; lengths in mm."""
    scale = _scale(row)
    return (
        row.where,
        _name(row),
        interval_text(scale * row.mean, half_width(scale * row.mean_std)),
        *(significant(scale * value) for value in (row.spread, row.expected, row.stated)),
        f"{significant(row.ratio)} ({significant(row.low, 2)} to {significant(row.high, 2)})",
        ", ".join(map(str, row.far)) or "none",
        row.outcome,
    )


def _scale(row: RepeatedQuantity) -> float:
    return 1000.0 if row.unit == "m" else 1.0


def _name(row: RepeatedQuantity) -> str:
    return f"{row.what} [{'mm' if row.unit == 'm' else row.unit}]"


def _days(found: Repeatability) -> dict[int, str]:
    """Return the repetitions that are the first of a day, with its date."""
    days = [None if time is None else time[:10] for time in found.measured]
    return {k: day for k, day in enumerate(days, 1) if day is not None and (k == 1 or day != days[k - 2])}


def _figure(row: RepeatedQuantity, days: dict[int, str]) -> Markup:
    """Draw the values with their stated 95 % intervals, the mean, and the spread that is expected around it."""
    scale = _scale(row)
    values, halves = ([scale * each for each in numbers] for numbers in (row.value, map(half_width, row.std)))
    ends = [value + sign * half for value, half in zip(values, halves, strict=True) for sign in (-1, 1)]
    mean, band = scale * row.mean, half_width(scale * row.expected)
    count = max(row.repetition)
    panel = Panel(WIDTH, HEIGHT, (0.5, count + 0.5), limits(ends, include=(mean - band, mean + band)), top=20.0)
    panel.box((0.5, count + 0.5), (mean - band, mean + band), "floor")
    panel.y_axis(_name(row))
    panel.x_axis("repetition", min(count, 10))
    for first, day in days.items():
        panel.segment((first - 0.5, panel.y_range[0]), (first - 0.5, panel.y_range[1]), "group")
        panel.text(panel.x(first - 0.5) + 3, 14, day, "tick")
    panel.segment((0.5, mean), (count + 0.5, mean), "model-line")
    for number, value, half in zip(row.repetition, values, halves, strict=True):
        panel.segment((number, value - half), (number, value + half), "force")
        kind = "state-failed" if number in row.far else "dot after"
        panel.dot(number, value, kind, f"{number}: {interval_text(value, half)}")
    return panel.svg(f"{_name(row)} over the repetitions, with stated intervals")
