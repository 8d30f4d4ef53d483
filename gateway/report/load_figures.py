"""Centre of gravity of a load for display, and the figures of its change: two views with ellipse, and every quantity.

The centre is shown in the flange frame if known, otherwise in the frame of the result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from gateway.report import notation
from gateway.report.figures import cell
from gateway.report.svg import Panel, limits, row_panel
from gateway.result.numerals import half_width
from gateway.result.result import UNKNOWN_THREE, LoadResult, Result
from gateway.result.values import Matrix, Numbers

#: 95 % quantile of chi-square with two degrees of freedom.
ELLIPSE_95 = math.sqrt(5.991)
COM_SIDE = 190.0
# name, unit and factor of the load parameters
QUANTITIES = (("mass", "kg", 1.0), *((f"centre {name}", "mm", 1e3) for name in "xyz"))


@dataclass(frozen=True, slots=True)
class Centre:
    """Position and standard deviation (3,) [m] in `frame`, NaN if unknown; `correlation` (4, 4) of [mass, x, y, z]."""

    frame: str
    com_m: Numbers
    std_m: Numbers
    correlation: Matrix | None

    @property
    def known(self) -> bool:
        """Return whether all three components are known."""
        return all(map(math.isfinite, self.com_m))


def centre(load: LoadResult, result: Result | None = None) -> Centre | None:
    """Return the centre of gravity of a load, or None.

    Parameters
    ----------
    load : LoadResult
    result : Result, optional
        Result of the load, with its uncertainty in the flange frame.
    """
    std_m, correlation = load.com_std_m or UNKNOWN_THREE, load.correlation
    if load.com_flange_m:
        turned = None if result is None or result.data is None else result.data.flange.get(load.label)
        if turned is not None:
            std_m, correlation = turned.com_std_m, turned.correlation
        return Centre("flange", load.com_flange_m, std_m, correlation)
    return None if load.com_m is None else Centre(load.frame, load.com_m, std_m, correlation)


def earlier(result: Result, load: LoadResult) -> LoadResult | None:
    """Return the same load before the effects were added, or None."""
    if not result.effects:
        return None
    return next((item for item in result.before.loads if item.label == load.label), None)


def com_figures(load: Centre, before: Centre | None) -> list[tuple[str, Markup]]:
    """Draw the centre of gravity in two views [mm] with the 95 % ellipse, and the value before the effects were added.

    Parameters
    ----------
    load : Centre
    before : Centre or None
        The same load before the effects were added.
    """
    if not load.known:
        return []
    shown = [("after", load)] if before is None or not before.known else [("before", before), ("after", load)]
    views = (("side view", 2, 0), ("end view", 1, 0))
    return [(f"{title}, {load.frame} frame", _com_view(shown, (across, up))) for title, across, up in views]


def _com_view(shown: Sequence[tuple[str, Centre]], pair: tuple[int, int]) -> Markup:
    across, up = pair
    half = 1.15 * max(20.0, *(_reach_mm(item) for _, item in shown))
    panel = Panel(COM_SIDE + 64, COM_SIDE + 52, (-half, half), (-half, half), left=52, right=12, top=12, bottom=40)
    panel.x_axis(f"{'xyz'[across]} [mm]", 3)
    panel.y_axis(f"{'xyz'[up]} [mm]", 3)
    if across == 2:
        panel.segment((0.0, -0.32 * half), (0.0, 0.32 * half), "flange")
        panel.segment((-0.12 * half, 0.0), (0.0, 0.0), "flange")
    else:
        panel.dot(0.0, 0.0, "flange-face", "flange", COM_SIDE * 0.16)
    for kind, item in shown:
        x, y = (1000 * item.com_m[axis] for axis in pair)
        outline = _ellipse(item, pair)
        if outline:
            panel.polygon([(x + dx, y + dy) for dx, dy in outline], f"ellipse {kind}")
        panel.dot(x, y, f"dot {kind}", f"{kind}: {notation.plain(x, 1)}, {notation.plain(y, 1)} mm", 3.6)
    return panel.svg("Centre of gravity of the load with its 95 % ellipse")


def _ellipse(item: Centre, pair: tuple[int, int]) -> list[tuple[float, float]]:
    """Return the outline of the 95 % ellipse about its centre [mm]; empty if the uncertainty is unknown."""
    if not all(map(math.isfinite, item.std_m)):
        return []
    first, second = (1000 * item.std_m[axis] for axis in pair)
    rho = cell(item.correlation or (), pair[0] + 1, pair[1] + 1)
    rho = max(-0.999, min(0.999, rho)) if math.isfinite(rho) else 0.0
    side = math.sqrt(1 - rho * rho)
    return [
        (
            ELLIPSE_95 * first * math.cos(angle),
            ELLIPSE_95 * second * (rho * math.cos(angle) + side * math.sin(angle)),
        )
        for angle in (math.tau * index / 60 for index in range(60))
    ]


def _reach_mm(item: Centre) -> float:
    """Return the largest component of the distance of a centre of gravity with its ellipse from the origin."""
    spread = item.std_m if all(map(math.isfinite, item.std_m)) else (0.0, 0.0, 0.0)
    return max(1000 * (abs(com) + ELLIPSE_95 * std) for com, std in zip(item.com_m, spread, strict=True))


def load_change_figure(result: Result) -> Markup | None:
    """Draw mass and centre of gravity of each load before and after, in half widths of the final 95 % interval."""
    several = len(result.loads) > 1
    pairs = [(load, earlier(result, load)) for load in result.loads]
    entries = [
        entry
        for load, before in pairs
        if before is not None
        for entry in _changes(load.label if several else "", _quantities(load, result), _quantities(before))
    ]
    if not entries:
        return None
    reach = [v for _, at, half, _ in entries for v in (at - half, at + half)]
    panel = row_panel(
        [name for name, *_ in entries],
        limits([*reach, -1.4, 1.4]),
        "distance from the final value / its 95 % half width [-]",
        size=(560.0, 24.0),
        left=128.0,
        right=150.0,
    )
    panel.box((-1.0, 1.0), panel.y_range, "band-after")
    panel.vertical(0.0, "zero")
    for row, (name, at, half, text) in enumerate(entries):
        panel.segment((at - half, row), (at + half, row), "whisker-before")
        panel.dot(at, row, "dot before", f"{name} before", 4.4)
        panel.dot(0.0, row, "dot after", f"{name} after", 4.4)
        panel.text(panel.width - panel.right + 8, panel.y(row) + 4, text, "tick")
    return panel.svg("Mass and centre of gravity before and after")


def _changes(
    label: str, final: Sequence[tuple[float, float]], before: Sequence[tuple[float, float]]
) -> list[tuple[str, float, float, str]]:
    """Return (name, value before, its half width, text) per quantity; `label` if there are several loads."""
    entries = []
    for (name, unit, factor), (value, std), (old, old_std) in zip(QUANTITIES, final, before, strict=True):
        if not all(map(math.isfinite, (value, std, old))) or std <= 0:
            continue
        scale = half_width(std)
        half = old_std / std if math.isfinite(old_std) else 0.0
        digits = notation.decimals(factor * scale)
        text = f"{notation.plain(factor * old, digits)} → {notation.plain(factor * value, digits)} {unit}"
        entries.append((f"{label} {name}".strip(), (old - value) / scale, half, text))
    return entries


def _quantities(load: LoadResult, result: Result | None = None) -> list[tuple[float, float]]:
    """Return value and standard deviation of each of `QUANTITIES`, in the displayed frame; NaN if unknown."""
    shown = centre(load, result)
    com, std = (UNKNOWN_THREE, UNKNOWN_THREE) if shown is None else (shown.com_m, shown.std_m)
    return [(load.mass_kg, load.mass_std_kg), *zip(com, std, strict=True)]
