"""Content of the report without figures or HTML: numbers, and the summary of load, missing effects and model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from gateway.report import notation
from gateway.report.load_figures import centre, earlier
from gateway.report.moving_section import axis_rows, inertia_view
from gateway.result.acceptance import CANNOT_TELL, FAIL, IN_WORDS, asked_for, measured, open_findings
from gateway.result.names import INERTIA_PARTS, INERTIA_WHOLE
from gateway.result.numerals import SAID, half_width, holds_zero
from gateway.result.result import UNKNOWN_THREE, EffectResult, Formula, LoadResult, Result

UNKNOWNS = {
    "mass_kg": "mass",
    "com_x_m": "centre of gravity along x",
    "com_y_m": "centre of gravity along y",
    "com_z_m": "centre of gravity along z",
    INERTIA_WHOLE: "inertia",
} | {name: f"moment of inertia {name.split('_')[1]}" for name in INERTIA_PARTS}


@dataclass(frozen=True, slots=True)
class Candidate:
    """One tested effect: ratio of held-out error, after over before."""

    label: str
    ratio: float
    chosen: bool


def view(result: Result) -> dict[str, Any]:
    """Return the values of the page from a result, as the template reads them.

    `loads` and `effects` are mappings with numbers as texts: centres of gravity in mm, half widths of 95 % intervals.
    """
    before, after = result.before, result.after
    shown = (before.rms_nm, after.rms_nm)
    if held_out_known(result):
        shown = (before.holdout_rms_nm, after.holdout_rms_nm)
    columns = zip_longest(result.noise_floor_nm, *shown, result.friction_band_nm, after.rms_nm, fillvalue=math.nan)
    axes = tuple(AxisQuality(notation.axis(joint), *column) for joint, column in enumerate(columns, start=1))
    found = [
        Candidate(notation.short(item.name, item.joints), item.evidence.holdout_rms_ratio, chosen=True)
        for item in result.effects
    ]
    found += [
        Candidate(notation.short(item.name, item.joints), item.holdout_rms_ratio, chosen=False)
        for item in result.rejected
    ]
    known = [item for item in found if notation.known(item.ratio)]
    return {
        "status": status(result),
        "headline": headline(result),
        "verdict": verdict_text(result),
        "quality": quality_text(axes, result),
        "acceptance": tuple(acceptance_texts(result)),
        "loads": tuple(_load(result, load) for load in result.loads),
        "axes": axes,
        "effects": tuple(_effect(effect) for effect in result.effects),
        "candidates": tuple(sorted(known, key=lambda item: (not item.chosen, item.ratio))),
        "held_out": HELD_OUT.get(result.holdout_kind or "", ""),
        "has_before": bool(result.effects),
        "motion": tuple(axis_rows(result.motion, len(axes))),
    }


def _load(result: Result, load: LoadResult) -> dict[str, Any]:
    before = earlier(result, load)
    size, half = mass(load)
    was = mass(before) if before is not None and notation.known(before.mass_kg) else ("", "")
    spread = half_width(load.mass_std_kg)
    interval = ""
    if notation.known(load.mass_kg) and notation.known(spread):
        digits = notation.decimals(spread)
        interval = (
            f"{notation.plain(load.mass_kg - spread, digits)} to {notation.plain(load.mass_kg + spread, digits)} kg"
        )
    shown = centre(load, result)
    earlier_centre = None if before is None else centre(before)
    old_m, components = UNKNOWN_THREE if earlier_centre is None else earlier_centre.com_m, list[dict[str, str]]()
    for name, value, std, old in zip("xyz", shown.com_m, shown.std_m, old_m, strict=True) if shown is not None else ():
        text, spread_mm = notation.plus_minus(1000 * value, 1000 * half_width(std))
        was_mm = notation.plain(1000 * old, 1) if notation.known(old) else ""
        components.append({"name": name, "value": text, "half": spread_mm, "before": was_mm})
    return {
        "label": load.label,
        "mass": size,
        "mass_half": half,
        "interval": interval,
        "frame": load.frame if shown is None else shown.frame,
        "com": components,
        "before_mass": was[0],
        "before_half": was[1],
        "refused": load.refused or "",
        "unidentifiable": tuple(UNKNOWNS.get(item, item) for item in load.unidentifiable),
        "inertia": inertia_view(load),
    }


def _effect(effect: EffectResult) -> dict[str, Any]:
    parameters = []
    for key, value in effect.parameters.items():
        name, unit = notation.parameter_of(effect.name, key)
        std = effect.std.get(key)
        text, half = notation.significant(value, 4), ""
        if std is not None and notation.known(std):
            text, half = notation.plus_minus(value, half_width(std))
        parameters.append((name, text, half, unit))
    lines = []
    if notation.known(effect.evidence.holdout_rms_ratio):
        verb = "falls to" if effect.evidence.holdout_rms_ratio < 1 else "is"
        lines.append(
            f"held-out error {verb} {100 * effect.evidence.holdout_rms_ratio:.0f} % of the error without the effect"
        )
    if notation.known(effect.evidence.p_value):
        lines.append(f"p-value without the effect: p = {notation.significant(effect.evidence.p_value, 2)}")
    if effect.evidence.runner_up:
        against = (
            f", odds {notation.significant(effect.evidence.odds, 2)} to 1"
            if notation.known(effect.evidence.odds)
            else ""
        )
        lines.append(f"next best candidate: {notation.effect(effect.evidence.runner_up)}{against}")
    return {
        "name": effect.name,
        "joints": effect.joints,
        "words": notation.effect_on(effect.name, effect.joints),
        "parameters": tuple(parameters),
        "evidence": tuple(lines),
    }


#: Verdict of a result -> its text.
VERDICTS = {
    "none_needed": "model complete",
    "explained": "residual explained",
    "improved": "residual partly explained",
    "unexplained": "residual unexplained",
    "undecided": "cannot decide",
}
HELD_OUT = {
    "fresh": "validation poses that were not used in the fit",
    "given": "the given validation data",
    "blocks": "held-out blocks of the data",
}
# a residual this close to the noise floor counts as explained in text and colour
NEAR_FLOOR = 1.3


@dataclass(frozen=True, slots=True)
class AxisQuality:
    """Residual of one axis and its noise floor [Nm]; NaN = not measured or unknown."""

    name: str
    floor: float
    before: float
    after: float
    band: float
    fit: float

    @property
    def ratio_before(self) -> float:
        """Return the ratio of the residual before to the noise floor."""
        return self.before / self.floor if self.floor > 0 else math.nan

    @property
    def ratio_after(self) -> float:
        """Return the ratio of the residual after to the noise floor."""
        return self.after / self.floor if self.floor > 0 else math.nan


def status(result: Result) -> str:
    """Return `bad` for a failing finding or a refused load, `good` if nothing is open, otherwise `open`.

    Open: a statement that the measurement contradicts, a load that may not be mounted, an acceptance
    that the data cannot decide.
    """
    failing = {finding for finding in result.findings if finding.severity == "fail"}
    undecided = open_findings(result)
    if failing - undecided or any(load.refused for load in result.loads):
        return "bad"
    if failing or undecided or any(finding.severity == "warn" for finding in result.findings):
        return "open"
    return "good" if result.verdict in ("none_needed", "explained") else "open"


def headline(result: Result) -> str:
    """Return the mounted load in one line."""
    loads = result.loads
    good = [load for load in loads if notation.known(load.mass_kg)]
    if not good:
        if loads:
            return "The load was refused" if any(load.refused for load in loads) else "No load detected"
        return "Unloaded arm"
    mounted = [_sized(load, loads) for load in good if not is_undetected(load)]
    missed = [_sized(load, loads) for load in good if is_undetected(load)]
    refused = [load.label for load in loads if load.refused]
    parts = [f"{notation.listing(mounted)} on the flange"] if mounted else []
    asked = "Is it mounted?" if len(missed) == 1 else "Is each mounted?"
    parts += [f"{notation.listing(missed)}: no load detected. {asked}"] if missed else []
    parts += [f"{notation.listing(refused)} refused"] if refused else []
    return "; ".join(parts)


def _sized(load: LoadResult, loads: Sequence[LoadResult]) -> str:
    value, half = mass(load)
    size = f"{value} ± {half} kg ({SAID})" if half else f"{value} kg"
    return f"{size} of {notation.load(load.label)}" if len(loads) > 1 else size


def is_undetected(load: LoadResult) -> bool:
    """Return whether a declared load has a mass that is not significantly different from zero."""
    return holds_zero(load.mass_kg, load.mass_std_kg)


def acceptance_texts(result: Result) -> list[tuple[str, str, str]]:
    """Return the acceptance of each load: kind of tag, text of the tag, sentence."""
    tags = {FAIL: "fail", CANNOT_TELL: "warn"}
    return [
        (
            tags.get(row.outcome, "pass"),
            IN_WORDS[row.outcome],
            f"{notation.load(row.load)}: {row.what} {measured(row)} ({SAID}), allowed {asked_for(row)}.",
        )
        for row in result.acceptance
    ]


def verdict_text(result: Result) -> str:
    """Return the verdict with its evidence, and what was open before further poses were measured."""
    if result.decided is None:
        return _verdict_text(result)
    return (
        f"{_verdict_text(result)} It took {result.decided.poses} further poses: before them, the data could not decide "
        f"between {_alternatives(result.decided.effects)}."
    )


def _alternatives(effects: Sequence[EffectResult]) -> str:
    """Return the effects between which the data cannot decide; beside a single one, that nothing is missing."""
    each = [notation.effect_on(item.name, item.joints) for item in effects]
    return notation.listing(each if len(each) > 1 else [*each, "nothing at all"], "and")


def formula_text(formula: Formula) -> str:
    """Return the evidence for a candidate formula."""
    place = f" on {notation.axes(formula.joints)}" if formula.joints else ""
    text = (
        f"A formula describes the unexplained torque{place}; it is not in the library and names no cause. It leaves "
        f"{100.0 * formula.holdout_rms_ratio:.0f} % of the residual of poses that were not used in its choice "
        f"(p-value {formula.p_value:.1g})."
    )
    sizes = [(load, *mass(load)) for load in formula.after.loads if notation.known(load.mass_kg)]
    masses = [f"{notation.load(load.label)} {value}{f' ± {half}' if half else ''} kg" for load, value, half in sizes]
    if masses:
        text += f" With it in the model: {notation.listing(masses)} ({SAID})."
    if formula.runner_up:
        text += f" Next best: {formula.runner_up} (odds {notation.significant(formula.odds, 2)} to 1)."
    return text


def formula_rows(formula: Formula) -> list[tuple[str, str, str, str]]:
    """Return the products of a formula: product, coefficient, half of its 95 % interval, unit."""
    return [
        (piece.expression, *notation.plus_minus(piece.coefficient, half_width(piece.std)), piece.unit)
        for piece in formula.pieces
    ]


def _verdict_text(result: Result) -> str:
    found = notation.effects_on([(item.name, item.joints) for item in result.effects])
    names = notation.listing(found)
    held_out = HELD_OUT.get(result.holdout_kind or "", "held-out data")
    verdict = result.verdict
    if verdict == "none_needed" and any(map(is_undetected, result.loads)):
        return f"The torque is that of an unloaded arm. The model is complete: on {held_out} the residual is noise."
    if verdict == "none_needed":
        return f"The model is complete: on {held_out} the residual is measurement noise."
    if verdict == "explained":
        return f"The model lacked {names}. With it, the error on {held_out} is at the noise floor."
    if verdict == "improved":
        return f"The model lacked {names}, proven on {held_out}. Part of the error remains unexplained."
    if verdict == "unexplained":
        return "The model lacks an effect that is not in the library; see the residual below."
    if verdict == "undecided":
        if found:
            between = _alternatives(result.effects)
            return f"The data cannot decide between {between}; the poses to measure next are listed below."
        return "There is too little data to validate the model; the poses to measure next are listed below."
    return "The load was estimated without a diagnosis of the residual."


def quality_text(axes: Sequence[AxisQuality], result: Result) -> str:
    """Return the ratio of residual to noise floor of the worst axis as a sentence."""
    rated = [(axis.ratio_after, axis) for axis in axes if notation.known(axis.ratio_after)]
    if not rated:
        measured = [axis for axis in axes if notation.known(axis.after)]
        if not measured:
            return "The residual is unknown."
        worst = max(measured, key=lambda axis: axis.after)
        size = f"{notation.significant(worst.after)} Nm on {worst.name}"
        return f"The noise floor is unknown; the largest residual is {size}."
    ratio, worst = max(rated, key=lambda pair: pair[0])
    place = "" if held_out_known(result) else " of the fit"
    settled = result.verdict in ("none_needed", "explained")
    judged = "The residual exceeds the measurement noise"
    if ratio <= NEAR_FLOOR:
        judged = "The residual is at the level of the measurement noise"
    elif settled:
        judged = "The residual is within the scatter of this number of readings"
    return (
        f"{judged}: the residual{place} is {ratio:.1f} times the noise floor on the worst axis, {worst.name} "
        f"({notation.significant(worst.after)} Nm against {notation.significant(worst.floor)} Nm)."
    )


def held_out_known(result: Result) -> bool:
    """Return whether a residual on held-out data is known."""
    return any(map(notation.known, result.after.holdout_rms_nm))


def mass(load: LoadResult) -> tuple[str, str]:
    """Return mass and half width of its 95 % interval [kg] as text."""
    return notation.plus_minus(load.mass_kg, half_width(load.mass_std_kg))
