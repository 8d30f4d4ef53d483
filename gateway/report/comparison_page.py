"""Page that compares two results, before and after service."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits
from gateway.result.compare import CANNOT_TELL, CHANGED, UNCHANGED, ComparedQuantity, ResultComparison, sentence
from gateway.result.numerals import interval_text, significant

TAGS = {CHANGED: "fail", CANNOT_TELL: "warn", UNCHANGED: "pass"}
STATUS = {CHANGED: "bad", CANNOT_TELL: "open", UNCHANGED: "good"}
COLUMNS = ("where", "quantity", "before", "after", "difference", "verdict")
WIDTH, ROW_PX = 720.0, 24.0


def render_compare(found: ResultComparison) -> str:
    """Return the HTML page."""
    about = (("robot", found.robot), ("before", _file(found, 0)), ("after", _file(found, 1)))
    drawn = [row for row in found.quantities if math.isfinite(row.half_width) and row.before != 0.0]
    return page(
        "compare.html.j2",
        Head(f"ResultComparison: {found.robot}", "Before and after", about),
        status=STATUS[found.verdict],
        headline=sentence(found),
        columns=COLUMNS,
        rows=[(TAGS[row.outcome], cells(row)) for row in found.quantities],
        remarks=found.remarks,
        figure=_figure(drawn) if drawn else None,
    )


def _file(found: ResultComparison, which: int) -> str:
    created = found.created[which]
    return (found.before, found.after)[which] + (f" of {created}" if created else "")


def cells(row: ComparedQuantity) -> tuple[str, ...]:
    """Return the texts of a quantity: place, name, both values, difference with interval, verdict."""
    scale, unit = (1000.0, "mm") if row.unit == "m" else (1.0, row.unit)
    known = math.isfinite(row.half_width)
    difference = interval_text(scale * row.difference, scale * row.half_width) if known else significant(row.difference)
    beside = "" if known else ", no uncertainty stated"
    before, after = (significant(scale * value, 5) for value in (row.before, row.after))
    return (row.where, f"{row.what} [{unit}]", before, after, difference + beside, row.outcome)


def _figure(rows: Sequence[ComparedQuantity]) -> Markup:
    """Draw the difference of each quantity in percent of its value before, with its interval."""
    centre = [100.0 * row.difference / abs(row.before) for row in rows]
    half = [100.0 * row.half_width / abs(row.before) for row in rows]
    ends = [value + sign * width for value, width in zip(centre, half, strict=True) for sign in (-1, 1)]
    span = limits([max(-200.0, min(200.0, end)) for end in ends], include=(-5.0, 5.0))
    panel = Panel(WIDTH, ROW_PX * len(rows) + 60.0, span, (len(rows) - 0.5, -0.5), left=220.0, top=8.0)
    panel.x_axis("difference [% of the value before]", 8)
    panel.segment((0.0, len(rows) - 0.5), (0.0, -0.5), "limit")
    for place, (row, value, width) in enumerate(zip(rows, centre, half, strict=True)):
        panel.text(panel.left - 8, panel.y(place) + 4, f"{row.where} {row.what}", "name end")
        low, high = max(span[0], value - width), min(span[1], value + width)
        if low < high:
            panel.segment((low, place), (high, place), "force")
        if span[0] <= value <= span[1]:
            panel.dot(value, place, "state-failed" if row.outcome == CHANGED else "dot after", cells(row)[4])
    return panel.svg("Difference of each quantity with its interval")
