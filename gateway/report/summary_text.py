"""What the first screen says in words: what hangs there, what was wrong, how good the model is."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.report import notation
from gateway.report.quality import AxisQuality
from gateway.result.acceptance import CANNOT_TELL, FAIL, IN_WORDS, asked_for, measured, open_findings
from gateway.result.interval import SAID, half_width, holds_zero
from gateway.result.result import LoadResult, Result

HELD_OUT = {
    "fresh": "fresh poses that no fit has seen",
    "given": "the data given for validation",
    "blocks": "blocks of data kept out of the fit",
}
# A residual this close to the noise floor counts as explained in words and colour.
NEAR_FLOOR = 1.3


def status(result: Result) -> str:
    """`bad` with a failing finding or a refused load, `good` when nothing is left open, else `open`.

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
    """What hangs on the flange, in one line."""
    loads = result.loads
    good = [load for load in loads if notation.known(load.mass_kg)]
    if not good:
        if loads:
            return "The load was refused" if any(load.refused for load in loads) else "No load could be found"
        return "The bare arm, no load on the flange"
    hung = [_sized(load, loads) for load in good if not not_felt(load)]
    missed = [_sized(load, loads) for load in good if not_felt(load)]
    refused = [load.label for load in loads if load.refused]
    parts = [f"{notation.listing(hung)} on the flange"] if hung else []
    asked = "Is it mounted?" if len(missed) == 1 else "Is each mounted?"
    parts += [f"{notation.listing(missed)}: no load detected. {asked}"] if missed else []
    parts += [f"{notation.listing(refused)} refused"] if refused else []
    return "; ".join(parts)


def _sized(load: LoadResult, loads: Sequence[LoadResult]) -> str:
    value, half = mass(load)
    size = f"{value} ± {half} kg ({SAID})" if half else f"{value} kg"
    return f"{size} of {notation.load(load.label)}" if len(loads) > 1 else size


def not_felt(load: LoadResult) -> bool:
    """Whether the mass cannot be told from nothing, although the load was announced."""
    return holds_zero(load.mass_kg, load.mass_std_kg)


def acceptance_sentences(result: Result) -> list[tuple[str, str, str]]:
    """Whether each load is accepted: kind of a tag, what it says, and the sentence behind it."""
    tags = {FAIL: "fail", CANNOT_TELL: "warn"}
    return [
        (
            tags.get(row.outcome, "pass"),
            IN_WORDS[row.outcome],
            f"{notation.load(row.load)}: {row.what} {measured(row)} ({SAID}), allowed {asked_for(row)}.",
        )
        for row in result.acceptance
    ]


def verdict_sentence(result: Result) -> str:
    """What was wrong with the model, and how that is known."""
    found = notation.effects_on([(item.name, item.joints) for item in result.effects])
    names = notation.listing(found)
    held_out = HELD_OUT.get(result.holdout_kind or "", "data kept out of the fit")
    verdict = result.verdict
    if verdict == "none_needed" and any(map(not_felt, result.loads)):
        return f"The arm moved as if nothing hung on it; nothing else is missing: on {held_out} only noise is left."
    if verdict == "none_needed":
        return f"Nothing is missing from the model: on {held_out} only measurement noise is left."
    if verdict == "explained":
        return f"The model lacked {names}. With it, the error on {held_out} falls to the noise floor."
    if verdict == "improved":
        return f"The model lacked {names}: proven on {held_out}. Part of the error remains and has no name yet."
    if verdict == "unexplained":
        return "The model lacks something that no known effect explains; the residual below shows where."
    if verdict == "undecided":
        if found:
            each = [notation.effect_on(item.name, item.joints) for item in result.effects]
            between = notation.listing(each if len(each) > 1 else [*each, "nothing at all"], "and")
            return f"The data cannot decide between {between}; what to measure next is given below."
        return "There is too little data to say whether the model lacks anything; what to measure next is given below."
    return "The load was estimated with the model as it stands; no diagnosis of the residual was asked for."


def quality_sentence(axes: Sequence[AxisQuality], result: Result) -> str:
    """How far the model is from the noise, on its worst axis."""
    rated = [(axis.ratio_after, axis) for axis in axes if notation.known(axis.ratio_after)]
    if not rated:
        measured = [axis for axis in axes if notation.known(axis.after)]
        if not measured:
            return "No residual is known."
        worst = max(measured, key=lambda axis: axis.after)
        size = f"{notation.significant(worst.after)} Nm on {worst.name}"
        return f"The noise floor is not known; the largest residual is {size}."
    ratio, worst = max(rated, key=lambda pair: pair[0])
    place = "" if held_out_known(result) else " in the fit itself"
    settled = result.verdict in ("none_needed", "explained")
    judged = "The model is not as good as the data"
    if ratio <= NEAR_FLOOR:
        judged = "The model is as good as the data"
    elif settled:
        judged = "What is left is within what so few readings scatter"
    return (
        f"{judged}: the residual{place} is {ratio:.1f} times the noise floor on the worst axis, {worst.name} "
        f"({notation.significant(worst.after)} Nm against {notation.significant(worst.floor)} Nm)."
    )


def held_out_known(result: Result) -> bool:
    """Whether a residual on held-out data is given."""
    return any(map(notation.known, result.after.holdout_rms_nm))


def mass(load: LoadResult) -> tuple[str, str]:
    """Mass and half width of its 95 % interval, kg, as text."""
    return notation.plus_minus(load.mass_kg, half_width(load.mass_std_kg))
