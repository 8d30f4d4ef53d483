"""The page of a rehearsal: families, a chart an effect, confused pairs, the load. `answer`: what it wrote."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from markupsafe import Markup

from gateway.model.effects import MISTAKES
from gateway.report.notation import axes, effect, effect_on, listing, parameter_of
from gateway.report.page import Head, page
from gateway.report.svg import row_panel
from gateway.result.numerals import half_width, significant
from gateway.result.origin import Origin

#: Head of the table that `effect_cells` fills.
COLUMNS: Final = ("effect", "on", "named from", "largest plausible", "strength (95 %)", "named in")
#: Label of each case of the load.
CASES: Final = {"as_stated": "constants as stated", "calibrated": "constants calibrated with a weighed load"}
#: Strengths on the charts, 0.5 to 200, as decades.
_DECADES: Final = (math.log10(0.5), math.log10(200.0))


def render_rehearsal(answer: Mapping[str, Any], origin: Origin) -> str:
    """Return the HTML page."""
    missed = [family["name"] for family in answer["families"] if not family["recovered"]]
    names = list(dict.fromkeys(entry["name"] for entry in answer["effects"]))
    about = (("robot", answer["robot"]), ("arm", answer["arm"]), ("", origin.created), ("", origin.software))
    return page(
        "rehearsal.html.j2",
        Head(f"Rehearsal: {answer['arm']}", "Rehearsal: what this plan would find", about),
        status="open" if missed or answer["false_names"] else "good",
        headline=f"Not all effects would be found: {listing(missed)}" if missed else "All families are recovered",
        answer=answer,
        families=[(family["name"], family_sentence(family)) for family in answer["families"]],
        loads=[load_sentence(name, case) for name, case in answer["load"].items() if case is not None],
        columns=COLUMNS,
        effects=[effect_cells(entry) for entry in answer["effects"]],
        charts=[
            (effect(name).capitalize(), chart)
            for name in names
            if (chart := effect_chart([each for each in answer["effects"] if each["name"] == name], answer["runs"]))
        ],
        pairs=[pair_sentence(pair) for pair in answer["confused"]],
    )


def effect_cells(entry: Mapping[str, Any]) -> list[str]:
    """Return the row of an effect on its joints, for `COLUMNS`."""
    counted = f"{entry['named']} of {entry['arms']}"
    place = [effect(entry["name"]), axes(entry["joints"])]
    if "parameter" not in entry:
        return [*place, "listed always" if entry["recovered"] else "not always listed", "", "", counted]
    name, unit = parameter_of(entry["name"], entry["parameter"])
    low, high = (significant(end, 2) for end in entry["interval"])
    size = f"{name} {significant(entry['detection_size'], 2)} {unit}" if entry["recovered"] else "not named"
    strength = f"{significant(entry['detection_strength'], 2)} ({low} to {high})" if entry["named"] else ""
    return [*place, size.strip(), f"{significant(entry['largest_size'], 2)} {unit}".strip(), strength, counted]


def family_sentence(family: Mapping[str, Any]) -> str:
    """Say whether a family of effects is recovered, and what of it is not."""
    if family["recovered"]:
        return f"recovered, all {family['members']}"
    missed = [effect_on(each["name"], each["joints"]) for each in family["missed"]]
    return f"not recovered, {len(missed)} of {family['members']}: {listing(missed)}"


def load_sentence(name: str, case: Mapping[str, Any]) -> str:
    """Say how well the load is known in one case: stated and real, and how often the intervals hold."""
    com_mm = ", ".join(significant(1000.0 * half_width(std), 2) for std in case["com_std_m"])
    return (
        f"load, {CASES[name]}: mass \N{PLUS-MINUS SIGN}{significant(100.0 * half_width(case['mass_std_share']), 2)} %, "
        f"centre of gravity \N{PLUS-MINUS SIGN}{com_mm} mm (95 %); the intervals hold the truth in {case['inside']} of "
        f"{case['intervals']}; real over stated standard deviation of the mass "
        f"{significant(case['mass_rms_error_share'] / case['mass_std_share'], 2)}"
    )


def pair_sentence(pair: Mapping[str, Any]) -> str:
    """Say which two effects are confused, where and in how many arms, and what separates them."""
    poses = pair["separated_by"]
    places = listing(["/".join(axes(joints) or "all axes" for joints in ends) for ends in pair["joints"]])
    remedy = f"plan for them: plan --distinguish {','.join(dict.fromkeys(pair['effects']))}"
    if poses:
        remedy = f"a diagnosis then asks for {len(poses)} further poses"
    if any(name in MISTAKES for name in pair["effects"]):
        remedy = "the diagnosis lists both: check wiring and settings of the drive"
    names = " and ".join(map(effect, pair["effects"]))
    return f"{names} are confused (arms: {pair['arms']}; {places}); {remedy}"


def effect_chart(entries: Sequence[Mapping[str, Any]], runs: Sequence[Mapping[str, Any]]) -> Markup | None:
    """Draw an effect: a row a place, a dot an arm at its strength, filled where it was named; None without a size."""
    sized = [entry for entry in entries if "parameter" in entry]
    if not sized:
        return None
    names = [axes(entry["joints"]) or "all" for entry in sized]
    panel = row_panel(names, _DECADES, "strength [standard deviations]", size=(560.0, 30.0), left=64.0, log=True)
    for row, entry in enumerate(sized):
        if entry["named"]:
            low, middle, high = map(_place, (entry["interval"][0], entry["detection_strength"], entry["interval"][1]))
            panel.box((low, high), (row - 0.3, row + 0.3), "confidence")
            panel.segment((middle, row - 0.38), (middle, row + 0.38), "median")
        for run in runs:
            if run["effect"] == entry["name"] and run["joints"] == entry["joints"]:
                said = "named" if run["named"] else "not named"
                title = f"strength {significant(run['strength'], 2)}: {said}, verdict {run['verdict']}"
                panel.dot(_place(run["strength"]), row, f"dot {'after' if run['named'] else 'before'}", title)
    return panel.svg(f"{effect(sized[0]['name'])}: arms by strength, and from which strength it is named")


def _place(strength: float) -> float:
    return min(max(math.log10(max(strength, 1e-9)), _DECADES[0]), _DECADES[1])
