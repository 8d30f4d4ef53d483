"""Pages that compare results: two of one robot before and after service, or repetitions of one measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from markupsafe import Markup

from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits, row_panel
from gateway.result.compare import CANNOT_TELL, CHANGED, UNCHANGED, ComparedQuantity, ResultComparison, sentence
from gateway.result.numerals import half_width, interval_text, significant
from gateway.result.repeatability import HOLD, TOO_LARGE, TOO_SMALL, Repeatability, RepeatedQuantity, conclusion

#: Outcome of a quantity, or of a comparison -> colour of its tag, and of the head of the page.
TAGS: Final = {
    CHANGED: "fail",
    TOO_SMALL: "fail",
    TOO_LARGE: "warn",
    CANNOT_TELL: "warn",
    UNCHANGED: "pass",
    HOLD: "pass",
}
STATUS: Final = {"fail": "bad", "warn": "open", "pass": "good"}
COMPARED: Final = ("where", "quantity", "before", "after", "difference", "verdict")
REPEATED: Final = (
    "where", "quantity", "mean", "spread", "expected", "stated", "spread / expected", "beyond 3", "verdict",
)  # fmt: skip


def render_compare(found: ResultComparison) -> str:
    """Return the HTML page of two results."""
    files = [
        f"{name} of {created}" if created else name
        for name, created in zip((found.before, found.after), found.created, strict=True)
    ]
    drawn = [row for row in found.quantities if math.isfinite(row.half_width) and row.before != 0.0]
    return page(
        "comparison.html.j2",
        Head(
            f"Comparison: {found.robot}",
            "Before and after",
            (("robot", found.robot), *zip(("before", "after"), files, strict=True)),
        ),
        status=STATUS[TAGS[found.verdict]],
        headline=sentence(found),
        title="Quantities in both results",
        columns=COMPARED,
        rows=[(TAGS[row.outcome], compared_cells(row)) for row in found.quantities],
        remarks=found.remarks,
        figures=[("", _compared_figure(drawn))] if drawn else [],
        files=[],
    )


def render_repeatability(found: Repeatability) -> str:
    """Return the HTML page of repetitions: spread and stated standard deviations."""
    far = found.verdict == HOLD and any(row.far for row in found.quantities)
    return page(
        "comparison.html.j2",
        Head(
            f"Repeatability: {found.robot}",
            "Repeatability",
            (("robot", found.robot), ("repetitions", str(len(found.files)))),
        ),
        status="open" if far else STATUS[TAGS[found.verdict]],
        headline=conclusion(found),
        title="Spread and stated standard deviations",
        columns=REPEATED,
        rows=[(TAGS[row.outcome], repeated_cells(row)) for row in found.quantities],
        remarks=found.remarks,
        figures=[(f"{row.where}: {_named(row)}", _repeated_figure(row, _days(found))) for row in found.quantities],
        files=[
            (str(number), file, measured or "\N{EN DASH}")
            for number, file, measured in zip(range(1, len(found.files) + 1), found.files, found.measured, strict=True)
        ],
    )


def _scale(row: ComparedQuantity | RepeatedQuantity) -> float:
    """Return the factor to the unit of the page, which has lengths in mm."""
    return 1000.0 if row.unit == "m" else 1.0


def _named(row: ComparedQuantity | RepeatedQuantity) -> str:
    return f"{row.what} [{'mm' if row.unit == 'm' else row.unit}]"


def compared_cells(row: ComparedQuantity) -> tuple[str, ...]:
    """Return the texts of a quantity, as `COMPARED`; the difference with its interval."""
    scale, known = _scale(row), math.isfinite(row.half_width)
    difference = (
        interval_text(scale * row.difference, scale * row.half_width) if known else significant(scale * row.difference)
    )
    beside = "" if known else ", no uncertainty stated"
    before, after = (significant(scale * value, 5) for value in (row.before, row.after))
    return (row.where, _named(row), before, after, difference + beside, row.outcome)


def repeated_cells(row: RepeatedQuantity) -> tuple[str, ...]:
    """Return the texts of a quantity, as `REPEATED`."""
    scale = _scale(row)
    return (
        row.where,
        _named(row),
        interval_text(scale * row.mean, half_width(scale * row.mean_std)),
        *(significant(scale * value) for value in (row.spread, row.expected, row.stated)),
        f"{significant(row.ratio)} ({significant(row.low, 2)} to {significant(row.high, 2)})",
        ", ".join(map(str, row.far)) or "none",
        row.outcome,
    )


def _compared_figure(rows: Sequence[ComparedQuantity]) -> Markup:
    """Draw the difference of each quantity in percent of its value before, with its interval."""
    centre = [100.0 * row.difference / abs(row.before) for row in rows]
    half = [100.0 * row.half_width / abs(row.before) for row in rows]
    ends = [value + sign * width for value, width in zip(centre, half, strict=True) for sign in (-1, 1)]
    span = limits([max(-200.0, min(200.0, end)) for end in ends], include=(-5.0, 5.0))
    names = [f"{row.where} {row.what}" for row in rows]
    panel = row_panel(names, span, "difference [% of the value before]", size=(720.0, 24.0), left=220.0, count=8)
    panel.vertical(0.0, "limit")
    for place, (row, value, width) in enumerate(zip(rows, centre, half, strict=True)):
        low, high = max(span[0], value - width), min(span[1], value + width)
        if low < high:
            panel.segment((low, place), (high, place), "force")
        if span[0] <= value <= span[1]:
            panel.dot(value, place, "state-failed" if row.outcome == CHANGED else "dot after", compared_cells(row)[4])
    return panel.svg("Difference of each quantity with its interval")


def _days(found: Repeatability) -> dict[int, str]:
    """Return the repetitions that are the first of a day, with its date."""
    days = [None if time is None else time[:10] for time in found.measured]
    return {k: day for k, day in enumerate(days, 1) if day is not None and (k == 1 or day != days[k - 2])}


def _repeated_figure(row: RepeatedQuantity, days: dict[int, str]) -> Markup:
    """Draw the values with their stated 95 % intervals, the mean, and the spread that is expected around it."""
    scale = _scale(row)
    values, halves = ([scale * each for each in numbers] for numbers in (row.value, map(half_width, row.std)))
    ends = [value + sign * half for value, half in zip(values, halves, strict=True) for sign in (-1, 1)]
    mean, band = scale * row.mean, half_width(scale * row.expected)
    count = max(row.repetition)
    panel = Panel(460.0, 230.0, (0.5, count + 0.5), limits(ends, include=(mean - band, mean + band)), top=20.0)
    panel.box((0.5, count + 0.5), (mean - band, mean + band), "floor")
    panel.y_axis(_named(row))
    panel.x_axis("repetition", min(count, 10))
    for first, day in days.items():
        panel.vertical(first - 0.5, "group")
        panel.text(panel.x(first - 0.5) + 3, 14, day, "tick")
    panel.horizontal(mean, "model-line")
    for number, value, half in zip(row.repetition, values, halves, strict=True):
        panel.segment((number, value - half), (number, value + half), "force")
        kind = "state-failed" if number in row.far else "dot after"
        panel.dot(number, value, kind, f"{number}: {interval_text(value, half)}")
    return panel.svg(f"{_named(row)} over the repetitions, with stated intervals")
