"""Pages of a fleet: one for the fleet and one per robot."""

from __future__ import annotations

import math
from collections.abc import Iterator

from markupsafe import Markup

from gateway.report import notation
from gateway.report.page import Head, page
from gateway.report.svg import Panel, limits, line_chart
from gateway.result.fleet import (
    GAIN,
    MASS,
    QUANTITIES,
    STATES,
    FleetHealth,
    FleetTrend,
    RobotHealth,
    RobotLine,
    State,
    Tracked,
    TrendCurve,
    quantity,
)
from gateway.result.numerals import half_width, plus_minus, with_interval

TAGS: dict[State, str] = {"visit": "fail", "not seen": "warn", "cannot tell": "warn", "healthy": "pass"}
STATUS: dict[State, str] = {"visit": "bad", "not seen": "open", "cannot tell": "open", "healthy": "good"}
IN_WORDS: dict[State, str] = {
    "visit": "needs a visit",
    "not seen": "has no recent check",
    "cannot tell": "not decidable yet",
    "healthy": "is healthy",
}
PERCENT = 100.0
#: Number of robots drawn, from the top of the list.
DRAWN = 60


def render_fleet(fleet: FleetHealth) -> str:
    """Return the HTML page of a fleet."""
    about = (("as of", fleet.as_of), ("robots", str(len(fleet.robots))), ("checks", str(fleet.checks)),
             ("", fleet.software))  # fmt: skip
    drawn = [line for line in fleet.robots[:DRAWN] if math.isfinite(line.gain_std_per_year)]
    worst: list[State] = [state for state in STATES if fleet.count(state)]
    return page(
        "fleet.html.j2",
        Head("Fleet", "Fleet report", about),
        fleet=fleet,
        status=(STATUS[worst[0]] if worst else STATUS["cannot tell"]),
        headline=headline(fleet),
        counts="; ".join(f"{fleet.count(state)} {state}" for state in STATES),
        tags=TAGS,
        gains=_gains(drawn) if drawn else None,
        more=max(0, len(fleet.robots) - DRAWN),
        tolerance=notation.significant(PERCENT * GAIN.tolerance),
    )


def headline(fleet: FleetHealth) -> str:
    """Summarise the fleet in one line; unknown is not counted as healthy."""
    visits, total = fleet.count("visit"), len(fleet.robots)
    if not total:
        return "No robot in the store"
    unknown = fleet.count("not seen") + fleet.count("cannot tell")
    said = f"{visits} of {total} robots need service" if visits != 1 else f"1 of {total} robots needs service"
    return f"{said}, {unknown} cannot be assessed" if unknown else said


def _gains(lines: list[RobotLine]) -> Markup:
    """Draw the most significant gain drift of each robot with its interval."""
    centre = [PERCENT * line.gain_per_year for line in lines]
    half = [PERCENT * half_width(line.gain_std_per_year) for line in lines]
    limit = PERCENT * GAIN.tolerance
    ends = [value + side * each for value, each in zip(centre, half, strict=True) for side in (-1, 1)]
    panel = Panel(
        1020.0, 260.0, (0.3, len(lines) + 0.7), limits(ends, include=(-1.2 * limit, 1.2 * limit)), bottom=56.0
    )
    panel.y_axis("drift of the gain [% a year]")
    for side in (-1, 1):
        panel.horizontal(side * limit, "limit")
    for place, (line, value, each) in enumerate(zip(lines, centre, half, strict=True), start=1):
        colour = "c5" if line.state == "visit" else "c2"
        panel.segment((place, value - each), (place, value + each), f"whisker {colour}")
        drift = with_interval(line.gain_per_year, line.gain_std_per_year, PERCENT)
        panel.dot(place, value, f"spot {colour}", f"{line.robot}, {notation.axis(line.gain_joint)}: {drift} % a year")
    base = panel.height - panel.bottom
    step = max(1, math.ceil(len(lines) / 20))
    for place in range(1, len(lines) + 1, step):
        panel.text(panel.x(place), base + 14, str(place), "tick mid")
    panel.x_label("robot, by position in the list")
    return panel.svg("Most significant gain drift of each robot, with its 95 % interval")


def render_robot(robot: RobotHealth) -> str:
    """Return the HTML page of one robot."""
    line = robot.line
    serials = ", ".join("?" if number is None else str(number) for number in line.serial_numbers)
    about = (("cell", line.cell), ("arm", line.arm), ("drives", serials or None), ("first seen", line.first_seen),
             ("last seen", line.last_seen), ("checks", str(line.checks)), ("as of", robot.as_of),
             ("", robot.software))  # fmt: skip
    return page(
        "fleet_robot.html.j2",
        Head(f"Robot {line.robot}", f"Robot {line.robot}", about),
        robot=robot,
        status=STATUS[line.state],
        headline=f"{line.cell}, arm {line.arm}: {IN_WORDS[line.state]}",
        loads=[
            (
                load.program,
                with_interval(load.first_kg, load.first_std_kg),
                with_interval(load.last_kg, load.last_std_kg),
                load.last_seen or notation.plain(None),
                str(load.checks),
                load.outcome,
                load.why,
            )
            for load in robot.loads
        ],
        quantities=list(_quantities(robot)),
    )


def _quantities(robot: RobotHealth) -> Iterator[tuple[str, list[tuple[str, ...]], list[tuple[str, Markup]]]]:
    """Return for each measured quantity its name, a table row per axis, and a figure per axis."""
    for kind in (*QUANTITIES, MASS):
        trends = [trend for trend in robot.trends if trend.quantity == kind.key]
        if trends:
            name = kind.words[:1].upper() + kind.words[1:]
            curves = [curve for curve in robot.curves if curve.quantity == kind.key]
            yield name, [_row(trend) for trend in trends], [_panel(kind, curve) for curve in curves if curve.day]


def _place(joint: int, program: str) -> str:
    return notation.axis(joint) if joint else program


def _row(trend: FleetTrend) -> tuple[str, ...]:
    kind = quantity(trend.quantity)
    share = kind.relative or not kind.unit
    value, std = (
        (trend.share_per_year, trend.share_std_per_year) if share else (trend.drift_per_year, trend.drift_std_per_year)
    )
    factor, unit = (PERCENT, "%") if share else (1000.0, f"m{kind.unit}")
    least = trend.detectable_share if share else trend.detectable_per_year
    level, half = plus_minus(trend.level, half_width(trend.level_std))
    return (
        _place(trend.joint, trend.program),
        f"{level} \N{PLUS-MINUS SIGN} {half} {kind.unit}".strip() if half else level,
        f"{with_interval(value, std, factor)} {unit}" if math.isfinite(value) else "too few checks",
        notation.plain(trend.sigmas, 1),
        notation.plain(trend.needed_sigmas, 1),
        trend.found_on or notation.plain(None),
        f"{notation.significant(factor * least, 2)} {unit}" if math.isfinite(least) else notation.plain(None),
        f"{notation.significant(trend.per_k, 2)} {kind.unit or 1}/K"
        if math.isfinite(trend.per_k)
        else notation.plain(None),
        str(trend.checks),
    )


def _panel(kind: Tracked, curve: TrendCurve) -> tuple[str, Markup]:
    name = _place(curve.joint, curve.program)
    return name, line_chart(
        f"{kind.words} of {name} over days, with its trend",
        ("days since the first check [d]", f"{name} {kind.words.split()[0]} [{kind.unit or '1'}]"),
        [(curve.line_day, curve.line, "curve")],
        dots=[(curve.day, curve.value, "dot faint", 2.4, "")],
        bands=[(curve.line_day, curve.low, curve.high, "confidence")] if curve.line else (),
        x_range=limits(curve.day, include=(0.0,)),
        y_range=limits([*curve.value, *curve.line]),
    )
