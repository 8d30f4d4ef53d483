"""Page of a result: view and figures in the template."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from gateway.report import budget, evidence, figures, load_figures, moving_section, notation, scene
from gateway.report.page import Head, drive_rows, page
from gateway.report.view import formula_rows, formula_text, view
from gateway.result.acceptance import acceptance_findings
from gateway.result.certificate import COVERAGE_FACTOR, NOT_TRACEABLE, CertifiedQuantity, certificate
from gateway.result.drawn import FRESH, Drawn
from gateway.result.result import Result, to_dict
from gateway.result.values import Matrix

#: Integers up to this value are written in full.
_COUNTS = 1e12


def render(result: Result) -> str:
    """Return the HTML report of a result; missing parts are omitted."""
    shown, data = view(result), result.data or Drawn()
    about = (("robot", result.robot), ("cell", data.cell), ("arm", data.arm), ("", data.created), ("", data.software))
    stated = set(acceptance_findings(result.acceptance))
    found = [finding for finding in result.findings if finding.severity != "info" and finding not in stated]
    after = "after, held out" if shown["has_before"] else "held out" if shown["held_out"] else "residual"
    rows = [("before, held out", "before")] if shown["has_before"] else []
    rows += [(after, "after"), ("in the fit", "fit"), ("noise floor", "floor"), ("friction band", "band")]
    classes = figures.load_classes(result)
    drawn = scene.pose_figures(data.poses, classes)
    com: list[tuple[str, list[tuple[str, Markup]]]] = []
    for load in result.loads:
        now, before = load_figures.centre(load, result), load_figures.earlier(result, load)
        if now is not None and now.known:
            was = None if before is None else load_figures.centre(before)
            com.append((load.label, load_figures.com_figures(now, was)))
    # the curve of each effect, by its index
    curves: dict[int, Markup] = {}
    for place, effect in enumerate(result.effects):
        joints = (*effect.joints, None)
        fitting = (curve for curve in data.curves if curve.name == effect.name)
        match = next((curve for curve in fitting if not effect.joints or curve.joint in joints), None)
        if match is not None:
            curves[place] = evidence.curve_figure(match)
    swatches = {label: kind.replace("load-", "b") for label, kind in classes.items()}
    period = moving_section.period_of(result)
    measured = dict.fromkeys(() if result.rows is None else result.rows.load)
    return page(
        "report.html.j2",
        Head(f"Load identification: {result.robot}", "Load identification report", about),
        result=result,
        data=data,
        view=shown,
        residual_known=any(notation.known(axis.fit) or notation.known(axis.after) for axis in shown["axes"]),
        residual_rows=[
            (said, [notation.significant(getattr(axis, name)) for axis in shown["axes"]]) for said, name in rows
        ],
        posed=_posed,
        cellular=_cellular,
        first=sorted(found, key=lambda finding: finding.severity),
        notes=[finding for finding in result.findings if finding.severity == "info"],
        checksum=result.sha256 or to_dict(result)["sha256"],
        **_certificate(result),
        **{
            "quality": evidence.quality_figure(shown["axes"]),
            "per_pose": evidence.per_pose_figure(result, classes),
            "change": load_figures.load_change_figure(result),
            "posture": figures.posture_figures(result),
            "budget_picture": budget.budget_figure(result),
            "evidence": evidence.evidence_figure(shown["candidates"]),
            "formula": None if result.formula is None else evidence.formula_figure(result.formula),
            "friction": evidence.friction_figure(result),
            "more_candidates": max(0, len(shown["candidates"]) - evidence.MOST_CANDIDATES),
            "curves": curves,
            "first_curve": next(iter(curves.values()), None),
            "friction_curves": [moving_section.sliding_figure(one) for one in moving_section.friction_views(result)],
            "period": period,
            "period_panels": [] if period is None else moving_section.period_figures(period),
            "load_words": notation.load,
            "torque": figures.torque_figures(result),
            "residual": figures.residual_figures(result),
            "arms": drawn,
            "more_poses": max(0, len(data.poses) - len(drawn)),
            "com": com,
            "side_views": {label: pictures[0][1] for label, pictures in com},
            "flange": any(load.com_flange_m for load in result.loads),
            "swatches": swatches,
            "legend": [(notation.load(label), swatches[label]) for label in measured],
        },
        **{
            "bus_rows": [
                (name.replace("_", " "), [_cellular(row.get(name)) for row in data.bus])
                for name in dict.fromkeys(name for row in data.bus for name in row)
            ],
            "provenance": _provenance(result.provenance),
            "drive_rows": drive_rows(data.drives),
            "budget_rows": budget.budget_rows(result),
            "source_words": budget.SOURCE_WORDS,
            "nuisances": budget.nuisance_rows(result),
            "formula_text": "" if result.formula is None else formula_text(result.formula),
            "formula_rows": [] if result.formula is None else formula_rows(result.formula),
            "set_aside": budget.rejected_rows(result.set_aside),
            "fresh": FRESH in data.role,
            "open_question": result.verdict == "undecided",
            "has_floor": any(map(notation.known, result.noise_floor_nm)),
            "has_before_rows": bool(data.model_before_nm),
        },
    )


def _certificate(result: Result) -> dict[str, Any]:
    """The certificate, and its values in the units of the page: kg, mm, kg m2."""
    stated = certificate(result)
    return {
        "certified": stated,
        "certified_rows": [[_certified(quantity) for quantity in load.quantities] for load in stated.loads],
        "coverage_factor": f"{COVERAGE_FACTOR:g}",
        "not_traceable": NOT_TRACEABLE,
    }


def _certified(quantity: CertifiedQuantity) -> tuple[str, str, str, str, str]:
    unit, factor = quantity.unit.replace("m2", "m\N{SUPERSCRIPT TWO}"), 1.0
    if unit == "m":
        unit, factor = "mm", 1000.0
    if not notation.known(quantity.value):
        return quantity.name, unit, "not determined", "", ""
    value, expanded = notation.plus_minus(factor * quantity.value, factor * quantity.expanded)
    return quantity.name, unit, value, expanded, f"{COVERAGE_FACTOR:g}"


def _posed(poses_rad: Matrix) -> list[tuple[str, list[str]]]:
    """Return poses in degrees."""
    return [
        (f"pose {number}", [notation.plain(math.degrees(q), 1) for q in pose])
        for number, pose in enumerate(poses_rad, start=1)
    ]


def _provenance(tree: Mapping[str, Any]) -> list[tuple[str, str, str, str, str]]:
    rows = []
    for where, constants in tree.items():
        if not isinstance(constants, Mapping) or "value" in constants:
            rows.append(("analysis", where.replace("_", " "), *_constant(constants)))
            continue
        rows += [(where, name.replace("_", " "), *_constant(item)) for name, item in constants.items()]
    return rows


def _constant(item: Any) -> tuple[str, str, str]:
    if isinstance(item, Mapping):
        return _cellular(item.get("value")), str(item.get("unit") or ""), str(item.get("source") or "")
    return _cellular(item), "", ""


def _cellular(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        # counts are written as integers
        return (
            notation.plain(value, 0) if value.is_integer() and abs(value) < _COUNTS else notation.significant(value, 5)
        )
    if isinstance(value, list | tuple):
        return ", ".join(_cellular(item) for item in value) or "none"
    return "" if value is None else str(value)
