"""Content of the report: numbers and text from a result, without figures or HTML."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import zip_longest

from gateway.report import notation, summary_text
from gateway.report.centre import Centre, centre, earlier
from gateway.report.moving_section import InertiaView, axis_rows, inertia_view
from gateway.report.quality import AxisQuality
from gateway.result.interval import half_width
from gateway.result.names import INERTIA_PARTS, INERTIA_WHOLE
from gateway.result.result import UNKNOWN_THREE, EffectResult, Evidence, LoadResult, Result

UNKNOWNS = {
    "mass_kg": "mass",
    "com_x_m": "centre of gravity along x",
    "com_y_m": "centre of gravity along y",
    "com_z_m": "centre of gravity along z",
    INERTIA_WHOLE: "inertia",
} | {name: f"moment of inertia {name.split('_')[1]}" for name in INERTIA_PARTS}


@dataclass(frozen=True, slots=True)
class ComponentView:
    """One component of the centre of gravity, mm; texts."""

    name: str
    value: str
    half: str
    before: str


@dataclass(frozen=True, slots=True)
class LoadView:
    """One load as displayed; `half` are half widths of 95 % intervals."""

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
    inertia: InertiaView | None


@dataclass(frozen=True, slots=True)
class EffectView:
    """An identified effect with its parameters as (name, value, half width of the 95 % interval, unit)."""

    name: str
    joints: tuple[int, ...]
    words: str
    parameters: tuple[tuple[str, str, str, str], ...]
    evidence: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One tested effect: ratio of held-out error, after over before."""

    label: str
    ratio: float
    chosen: bool


@dataclass(frozen=True, slots=True)
class View:
    """All values of the page."""

    status: str
    headline: str
    verdict: str
    quality: str
    acceptance: tuple[tuple[str, str, str], ...]
    loads: tuple[LoadView, ...]
    axes: tuple[AxisQuality, ...]
    effects: tuple[EffectView, ...]
    candidates: tuple[Candidate, ...]
    held_out: str
    has_before: bool
    motion: tuple[tuple[str, list[str]], ...]


def view(result: Result) -> View:
    """Return the values of the page from a result."""
    axes = _axes(result)
    return View(
        status=summary_text.status(result),
        headline=summary_text.headline(result),
        verdict=summary_text.verdict_text(result),
        quality=summary_text.quality_text(axes, result),
        acceptance=tuple(summary_text.acceptance_texts(result)),
        loads=tuple(_load(result, load) for load in result.loads),
        axes=axes,
        effects=tuple(_effect(effect) for effect in result.effects),
        candidates=_candidates(result),
        held_out=summary_text.HELD_OUT.get(result.holdout_kind or "", ""),
        has_before=bool(result.effects),
        motion=tuple(axis_rows(result.motion, len(axes))),
    )


def _axes(result: Result) -> tuple[AxisQuality, ...]:
    before, after = result.before, result.after
    shown = (before.rms_nm, after.rms_nm)
    if summary_text.held_out_known(result):
        shown = (before.holdout_rms_nm, after.holdout_rms_nm)
    columns = zip_longest(result.noise_floor_nm, *shown, result.friction_band_nm, after.rms_nm, fillvalue=math.nan)
    return tuple(AxisQuality(notation.axis(joint), *column) for joint, column in enumerate(columns, start=1))


def _load(result: Result, load: LoadResult) -> LoadView:
    before = earlier(result, load)
    mass, half = summary_text.mass(load)
    was = summary_text.mass(before) if before is not None and notation.known(before.mass_kg) else ("", "")
    spread = half_width(load.mass_std_kg)
    interval = ""
    if notation.known(load.mass_kg) and notation.known(spread):
        digits = notation.decimals(spread)
        interval = (
            f"{notation.plain(load.mass_kg - spread, digits)} to {notation.plain(load.mass_kg + spread, digits)} kg"
        )
    shown = centre(load, result)
    return LoadView(
        label=load.label,
        mass=mass,
        mass_half=half,
        interval=interval,
        frame=load.frame if shown is None else shown.frame,
        com=() if shown is None else _components(shown, None if before is None else centre(before)),
        before_mass=was[0],
        before_half=was[1],
        refused=load.refused or "",
        unidentifiable=tuple(UNKNOWNS.get(item, item) for item in load.unidentifiable),
        inertia=inertia_view(load),
    )


def _components(shown: Centre, before: Centre | None) -> tuple[ComponentView, ...]:
    views = []
    old_m = UNKNOWN_THREE if before is None else before.com_m
    for name, value, std, old in zip("xyz", shown.com_m, shown.std_m, old_m, strict=True):
        text, half = notation.plus_minus(1000 * value, 1000 * half_width(std))
        views.append(ComponentView(name, text, half, notation.plain(1000 * old, 1) if notation.known(old) else ""))
    return tuple(views)


def _effect(effect: EffectResult) -> EffectView:
    parameters = []
    for key, value in effect.parameters.items():
        name, unit = notation.parameter_of(effect.name, key)
        std = effect.std.get(key)
        text, half = notation.significant(value, 4), ""
        if std is not None and notation.known(std):
            text, half = notation.plus_minus(value, half_width(std))
        parameters.append((name, text, half, unit))
    return EffectView(
        name=effect.name,
        joints=effect.joints,
        words=notation.effect_on(effect.name, effect.joints),
        parameters=tuple(parameters),
        evidence=_evidence(effect.evidence),
    )


def _evidence(evidence: Evidence) -> tuple[str, ...]:
    lines = []
    if notation.known(evidence.holdout_rms_ratio):
        verb = "falls to" if evidence.holdout_rms_ratio < 1 else "is"
        lines.append(f"held-out error {verb} {100 * evidence.holdout_rms_ratio:.0f} % of the error without the effect")
    if notation.known(evidence.p_value):
        lines.append(f"p-value without the effect: p = {notation.significant(evidence.p_value, 2)}")
    if evidence.runner_up:
        against = f", odds {notation.significant(evidence.odds, 2)} to 1" if notation.known(evidence.odds) else ""
        lines.append(f"next best candidate: {notation.effect(evidence.runner_up)}{against}")
    return tuple(lines)


def _candidates(result: Result) -> tuple[Candidate, ...]:
    found = [
        Candidate(notation.short(item.name, item.joints), item.evidence.holdout_rms_ratio, chosen=True)
        for item in result.effects
    ]
    found += [
        Candidate(notation.short(item.name, item.joints), item.holdout_rms_ratio, chosen=False)
        for item in result.rejected
    ]
    known = [item for item in found if notation.known(item.ratio)]
    return tuple(sorted(known, key=lambda item: (not item.chosen, item.ratio)))
