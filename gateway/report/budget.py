"""Figure and tables: sources of the uncertainty of a mass, and nuisance parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from markupsafe import Markup

from gateway.report import notation
from gateway.report.svg import Panel
from gateway.result.certificate import EVALUATIONS
from gateway.result.numerals import PLUS_MINUS, SAID, half_width, with_interval
from gateway.result.result import LoadResult, Result, SetAside

#: Source -> its name on the page.
SOURCE_WORDS: Final = {source: said for source, (said, _) in EVALUATIONS.items()}
#: Key of the result -> text, unit and factor.
NUISANCE_WORDS: Final = {
    "gain": ("gain of the torque", "%", 100.0),
    "bias_nm": ("bias by approach direction", "Nm", 1.0),
    "load_friction": ("torque-dependent friction", "%", 100.0),
    "one_efficiency": ("share of it explained by one gear efficiency for both directions", "%", 100.0),
    "cold_fast": ("additional friction when cold, time constant 10 min", "%", 100.0),
    "cold_slow": ("additional friction when cold, time constant 40 min", "%", 100.0),
}
WIDTH: Final = 470.0
_BAR, _ROW, _TOP, _LEFT = 22.0, 52.0, 22.0, 8.0
#: Least share of the bar that is labelled in the figure.
_MARGIN: Final = 0.1


def budgeted(result: Result) -> list[LoadResult]:
    """Return the loads with an uncertainty budget."""
    return [load for load in result.loads if load.budget and notation.known(load.mass_std_kg) and load.mass_std_kg > 0]


def budget_figure(result: Result) -> Markup | None:
    """Return a figure with one bar per load: variance of the mass, divided by source. None without a budget."""
    loads = budgeted(result)
    if not loads:
        return None
    height = _TOP + _ROW * len(loads) + 22.0
    panel = Panel(WIDTH, height, (0.0, 100.0), (0.0, 1.0), left=_LEFT, right=_LEFT, top=_TOP - 14.0, bottom=34.0)
    panel.x_axis("share of the variance of the mass [%]")
    for place, load in enumerate(loads):
        _bar(panel, load, _TOP + _ROW * place)
    shares = "; ".join(
        f"{load.label}: {', '.join(_percent(load.budget, name) for name in SOURCE_WORDS)}" for load in loads
    )
    return panel.svg(f"Uncertainty of the mass by source. {shares}")


def _percent(budget: Mapping[str, float], name: str) -> str:
    return f"{SOURCE_WORDS[name]} {100 * budget.get(name, 0.0):.0f} %"


def _bar(panel: Panel, load: LoadResult, top: float) -> None:
    title = f"{notation.load(load.label)}: {PLUS_MINUS} {_half(load.mass_std_kg)} kg ({SAID})"
    panel.text(_LEFT, top + 4.0, title, "tick name")
    start = 0.0
    for name in SOURCE_WORDS:
        share = max(0.0, load.budget.get(name, 0.0))
        left, right = panel.x(100 * start), panel.x(100 * (start + share))
        panel.add(
            f'<rect class="source-{name}" x="{left:.1f}" y="{top + 10:.1f}" width="{right - left:.1f}"'
            f' height="{_BAR}"><title>{_percent(load.budget, name)}</title></rect>'
        )
        if share >= _MARGIN:
            panel.text((left + right) / 2, top + 10 + _BAR / 2 + 4, f"{100 * share:.0f} %", "mid inside")
        start += share


def budget_rows(result: Result) -> list[tuple[str, str, list[tuple[str, str, str]]]]:
    """Return per load: label, half width (95 %) [kg], and name, share [%] and half width [kg] of each source."""
    rows = []
    for load in budgeted(result):
        half, parts = half_width(load.mass_std_kg), []
        for name in SOURCE_WORDS:
            share = load.budget.get(name, 0.0)
            part = notation.plain(math.sqrt(max(share, 0.0)) * half, notation.decimals(half))
            parts.append((name, f"{100 * share:.0f}", part))
        rows.append((load.label, _half(load.mass_std_kg), parts))
    return rows


def _half(std: float) -> str:
    half = half_width(std)
    return notation.plain(half, notation.decimals(half))


def nuisance_rows(result: Result) -> list[tuple[str, list[str]]]:
    """Return the nuisance parameters: text with unit, and value with 95 % interval of each axis."""
    return [
        (
            "{} [{}]".format(*_said(key)[:2]),
            [
                (with_interval(value, std, _said(key)[2]) if notation.known(value) else notation.plain(value))
                for value, std in zip(nuisance.value, nuisance.std, strict=True)
            ],
        )
        for key, nuisance in result.nuisance.items()
        if any(map(notation.known, nuisance.value))
    ]


def _said(key: str) -> tuple[str, str, float]:
    if key in NUISANCE_WORDS:
        return NUISANCE_WORDS[key]
    name, unit = notation.parameter(key)
    return name, unit, 1.0


def rejected_rows(entries: Sequence[SetAside]) -> list[tuple[str, str, str, str, str, str]]:
    """Return the rejected samples: run, load, pose or time, axis, friction bands, reason."""
    return [
        (
            each.run,
            notation.load(each.load),
            _where(each),
            notation.axis(each.joint),
            notation.plain(each.bands, 1),
            each.reason,
        )
        for each in entries
    ]


def _where(entry: SetAside) -> str:
    if entry.pose is not None:
        return f"pose {entry.pose}"
    return f"{notation.plain(entry.from_s, 1)} to {notation.plain(entry.to_s, 1)} s"
