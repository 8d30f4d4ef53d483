"""What the report says: numbers and sentences from a result, without any drawing or HTML."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gateway.report import sentences, words
from gateway.report.quality import AxisQuality
from gateway.report.rows import axes_of

Json = Mapping[str, Any]


UNKNOWNS = {
    "mass_kg": "mass",
    "com_x_m": "centre of gravity along x",
    "com_y_m": "centre of gravity along y",
    "com_z_m": "centre of gravity along z",
}


@dataclass(frozen=True, slots=True)
class ComponentView:
    """One component of the centre of gravity, mm; texts."""

    name: str
    value: str
    half: str
    before: str


@dataclass(frozen=True, slots=True)
class LoadView:
    """One load as it is printed; `half` are half widths of 95 % intervals."""

    label: str
    mass: str
    mass_half: str
    interval: str
    frame: str
    com: tuple[ComponentView, ...]
    before_mass: str
    before_half: str
    refused: str
    unidentifiable: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class EffectView:
    """An effect that was found, with its parameters as (name, value, std, unit)."""

    name: str
    joints: tuple[int, ...]
    words: str
    parameters: tuple[tuple[str, str, str, str], ...]
    evidence: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect that was tried: held-out error after over before."""

    label: str
    ratio: float
    chosen: bool


@dataclass(frozen=True, slots=True)
class View:
    """The whole page in values."""

    status: str
    headline: str
    verdict: str
    quality: str
    loads: tuple[LoadView, ...]
    axes: tuple[AxisQuality, ...]
    effects: tuple[EffectView, ...]
    candidates: tuple[Candidate, ...]
    held_out: str
    has_before: bool


def view(result: Json) -> View:
    """Read a result into the values that the page shows.

    Parameters
    ----------
    result : mapping
        Result JSON, schema 1.

    Returns
    -------
    View
    """
    axes = _axes(result)
    return View(
        status=sentences.status(result),
        headline=sentences.headline(result),
        verdict=sentences.verdict_sentence(result),
        quality=sentences.quality_sentence(axes, result),
        loads=tuple(_load(load, _before(result, load)) for load in result.get("loads") or []),
        axes=axes,
        effects=tuple(_effect(effect) for effect in result.get("effects") or []),
        candidates=_candidates(result),
        held_out=sentences.HELD_OUT.get(str(result.get("holdout_kind")), ""),
        has_before=bool(result.get("effects")),
    )


def _axes(result: Json) -> tuple[AxisQuality, ...]:
    before, after = result.get("before") or {}, result.get("after") or {}
    key = "holdout_rms_nm" if sentences.held_out_known(result) else "rms_nm"
    floor, band = result.get("noise_floor_nm"), result.get("friction_band_nm")
    lists = (floor, before.get(key), after.get(key), band, after.get("rms_nm"))
    columns = zip(*(_by_axis(values, axes_of(result)) for values in lists), strict=True)
    return tuple(AxisQuality(words.axis(index + 1), *column) for index, column in enumerate(columns))


def _by_axis(values: Sequence[float | None] | None, axes: int) -> tuple[float | None, ...]:
    given = list(values or [])[:axes]
    return tuple(value if words.known(value) else None for value in given + [None] * (axes - len(given)))


def _before(result: Json, load: Json) -> Json | None:
    if not result.get("effects"):
        return None
    earlier = (result.get("before") or {}).get("loads") or []
    return next((item for item in earlier if item.get("label") == load.get("label")), None)


def _load(load: Json, before: Json | None) -> LoadView:
    mass, half = sentences.mass(load)
    earlier = sentences.mass(before) if before is not None and words.known(before.get("mass_kg")) else ("", "")
    value, spread = load.get("mass_kg"), sentences.half_width(load.get("mass_std_kg"))
    interval = ""
    if value is not None and spread is not None:
        digits = words.decimals(spread)
        interval = f"{words.plain(value - spread, digits)} to {words.plain(value + spread, digits)} kg"
    frame, com = centre(load)
    return LoadView(
        label=str(load.get("label")),
        mass=mass,
        mass_half=half,
        interval=interval,
        frame=frame,
        com=_components(
            com, load.get("com_flange_std_m") or load.get("com_std_m"), centre(before)[1] if before else None
        ),
        before_mass=earlier[0],
        before_half=earlier[1],
        refused=str(load.get("refused") or ""),
        unidentifiable=tuple(_reason(item) for item in load.get("unidentifiable") or []),
    )


def centre(load: Json) -> tuple[str, Sequence[float | None] | None]:
    """Frame and centre of gravity: in the flange frame where it is given, else in that of the last link."""
    if load.get("com_flange_m"):
        return "flange", load["com_flange_m"]
    return str(load.get("frame", "link_6")), load.get("com_m")


def _components(
    com: Sequence[float | None] | None, std: Sequence[float | None] | None, before: Sequence[float | None] | None
) -> tuple[ComponentView, ...]:
    if com is None:
        return ()
    spread, earlier = std or (None,) * 3, before or (None,) * 3
    views = []
    for name, value, sigma, old in zip("xyz", com, spread, earlier, strict=True):
        half = sentences.half_width(sigma)
        text, wide = words.plus_minus(None if value is None else 1000 * value, None if half is None else 1000 * half)
        views.append(ComponentView(name, text, wide, words.plain(1000 * old, 1) if old is not None else ""))
    return tuple(views)


def _reason(item: Any) -> str:
    if isinstance(item, Mapping):
        return ": ".join(str(item[key]) for key in ("what", "why") if item.get(key))
    return UNKNOWNS.get(str(item), str(item))


def _effect(effect: Json) -> EffectView:
    joints = tuple(effect.get("joints") or ())
    std = effect.get("std") or {}
    parameters = []
    for key, value in (effect.get("parameters") or {}).items():
        name, unit = words.parameter(key)
        sigma = std.get(key)
        parameters.append(
            (name, words.significant(value, 4), words.significant(sigma, 2) if words.known(sigma) else "", unit)
        )
    return EffectView(
        name=effect["name"],
        joints=joints,
        words=words.effect_on(effect["name"], joints),
        parameters=tuple(parameters),
        evidence=_evidence(effect.get("evidence") or {}),
    )


def _evidence(evidence: Json) -> tuple[str, ...]:
    lines = []
    ratio = evidence.get("holdout_rms_ratio")
    if words.known(ratio):
        verb = "falls to" if float(ratio or 0) < 1 else "is"
        lines.append(f"held-out error {verb} {100 * float(ratio or 0):.0f} % of what it was")
    if words.known(evidence.get("p_value")):
        lines.append(f"chance of that without the effect: p = {words.significant(evidence['p_value'], 2)}")
    if evidence.get("runner_up"):
        odds = evidence.get("odds")
        against = f", odds {words.significant(odds, 2)} to 1" if words.known(odds) else ""
        lines.append(f"next best explanation: {words.effect(evidence['runner_up'])}{against}")
    return tuple(lines)


def _candidates(result: Json) -> tuple[Candidate, ...]:
    found = [
        _candidate(item, (item.get("evidence") or {}).get("holdout_rms_ratio"), chosen=True)
        for item in result.get("effects") or []
    ]
    rejected = [_candidate(item, item.get("holdout_rms_ratio"), chosen=False) for item in result.get("rejected") or []]
    known = [item for item in found + rejected if words.known(item.ratio)]
    return tuple(sorted(known, key=lambda item: (not item.chosen, item.ratio)))


def _candidate(item: Json, ratio: float | None, *, chosen: bool) -> Candidate:
    return Candidate(words.short(item["name"], item.get("joints") or []), math.nan if ratio is None else ratio, chosen)
