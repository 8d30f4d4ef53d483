"""The page: view and figures put into the template. One file, nothing is fetched when it opens."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gateway.report import evidence, figures, posture, space, words
from gateway.report.view import View, centre, view

Json = Mapping[str, Any]


def render(result: Json) -> str:
    """HTML text of the report.

    Parameters
    ----------
    result : mapping
        Result JSON, schema 1; see the package docstring for what it may carry beside the contract.

    Returns
    -------
    str
        A complete page.
    """
    environment = Environment(
        loader=PackageLoader("gateway", "report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    result = _in_flange(result)
    shown = view(result)
    style = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8")
    return environment.get_template("report.html.j2").render(
        result=_Lenient(result),
        data=_Lenient(result.get("data") or {}),
        view=shown,
        about=_about(result),
        residual_known=any(axis.fit is not None or axis.after is not None for axis in shown.axes),
        css=Markup(style),
        sig=words.significant,
        degrees=lambda q: words.plain(None if q is None else math.degrees(q), 1),
        cellular=_cellular,
        **_figures(result, shown),
        **_tables(result),
    )


def _in_flange(result: Json) -> Json:
    """The result with the uncertainty of each load in the frame its centre of gravity is given in."""
    spread = (result.get("data") or {}).get("flange") or {}
    loads = []
    for load in result.get("loads") or []:
        own = spread.get(load.get("label")) if load.get("com_flange_m") else None
        extra = {} if own is None else {"com_flange_std_m": own["com_std_m"], "correlation": own["correlation"]}
        loads.append({**load, **extra})
    return {**result, "loads": loads}


def _about(result: Json) -> list[Markup]:
    """Robot, cell, arm and date for the head of the page, as far as they are known."""
    data = result.get("data") or {}
    named = [("robot", result.get("robot")), ("cell", data.get("cell")), ("arm", data.get("arm"))]
    parts = [Markup("{} <b>{}</b>").format(name, value) for name, value in named if value]
    return parts + ([Markup("{}").format(data["created"])] if data.get("created") else [])


class _Lenient(dict[str, Any]):
    """A dictionary whose absent keys read as None in the template."""

    def __getattr__(self, name: str) -> Any:
        return self.get(name)


def _figures(result: Json, shown: View) -> dict[str, Any]:
    classes = figures.load_classes(result)
    data = result.get("data") or {}
    drawn = space.pose_figures(result, classes)
    com, curves = _com(result), _curves(result)
    measured = dict.fromkeys((result.get("rows") or {}).get("load") or [])
    return {
        "quality": evidence.quality_figure(shown.axes),
        "per_pose": evidence.per_pose_figure(result, classes),
        "change": posture.load_change_figure(result),
        "posture": posture.posture_figures(result),
        "evidence": evidence.evidence_figure(shown.candidates),
        "friction": evidence.friction_figure(result),
        "more_candidates": max(0, len(shown.candidates) - evidence.MOST_CANDIDATES),
        "curves": curves,
        "first_curve": next(iter(curves.values()), None),
        "torque": figures.torque_figures(result),
        "residual": figures.residual_figures(result),
        "arms": drawn,
        "more_poses": max(0, len(data.get("poses") or []) - len(drawn)),
        "com": com,
        "side_views": _Lenient({label: pictures[0][1] for label, pictures in com}),
        "flange": any(load.get("com_flange_m") for load in result.get("loads") or []),
        "swatches": {label: _swatch(kind) for label, kind in classes.items()},
        "legend": [(words.load(label), _swatch(classes[label])) for label in measured],
    }


def _swatch(kind: str) -> str:
    return kind.replace("load-", "b")


def _com(result: Json) -> list[tuple[str, Any]]:
    earlier = {load.get("label"): load for load in (result.get("before") or {}).get("loads") or []}
    with_before = bool(result.get("effects"))
    pictures = [
        (load.get("label"), space.com_figures(load, earlier.get(load.get("label")) if with_before else None))
        for load in result.get("loads") or []
        if centre(load)[1]
    ]
    return [(label, picture) for label, picture in pictures if picture]


def _curves(result: Json) -> dict[int, Markup]:
    """Curve of each effect, by its place in `effects`."""
    drawn: dict[int, Markup] = {}
    curves = list((result.get("data") or {}).get("curves") or [])
    for place, effect in enumerate(result.get("effects") or []):
        match = next((curve for curve in curves if _belongs(curve, effect)), None)
        if match is not None:
            drawn[place] = evidence.curve_figure(match)
    return drawn


def _belongs(curve: Json, effect: Json) -> bool:
    joints = effect.get("joints") or []
    return curve.get("name") == effect.get("name") and (not joints or curve.get("joint") in (*joints, None))


def _tables(result: Json) -> dict[str, Any]:
    data = result.get("data") or {}
    columns: dict[str, None] = {}
    for row in data.get("bus") or []:
        columns |= dict.fromkeys(row)
    return {
        "bus_columns": list(columns),
        "provenance": _provenance(result.get("provenance") or {}),
        "fresh": "fresh" in (data.get("role") or []),
        "open_question": result.get("verdict") == "undecided",
        "has_floor": any(words.known(value) for value in result.get("noise_floor_nm") or []),
        "has_before_rows": bool(data.get("model_before_nm")),
    }


def _provenance(tree: Json) -> list[tuple[str, str, str, str, str]]:
    rows = []
    for where, constants in tree.items():
        if not isinstance(constants, Mapping):
            rows.append(("analysis", where.replace("_", " "), *_constant(constants)))
            continue
        if "value" in constants:
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
        return words.significant(value, 5)
    if isinstance(value, list | tuple):
        return ", ".join(_cellular(item) for item in value) or "none"
    return "" if value is None else str(value)
