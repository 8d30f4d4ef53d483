"""The page: view and figures put into the template. One file, nothing is fetched when it opens."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gateway.report import evidence, figures, space, words
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
    shown = view(result)
    style = files("gateway.report").joinpath("report.css").read_text(encoding="utf-8")
    return environment.get_template("report.html.j2").render(
        result=_Lenient(result),
        data=_Lenient(result.get("data") or {}),
        view=shown,
        css=Markup(style),  # noqa: S704 - the package's own file
        sig=words.significant,
        degrees=lambda q: words.plain(None if q is None else math.degrees(q), 1),
        cellular=_cellular,
        **_figures(result, shown),
        **_tables(result),
    )


class _Lenient(dict):
    """A dictionary whose absent keys read as None in the template."""

    def __getattr__(self, name: str) -> Any:
        return self.get(name)


def _figures(result: Json, shown: View) -> dict[str, Any]:
    classes = figures.load_classes(result)
    data = result.get("data") or {}
    drawn = space.pose_figures(result, classes)
    com, curves = _com(result), _curves(result)
    return {
        "quality": evidence.quality_figure(shown.axes),
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
        "legend": [(words.load(label), _swatch(kind)) for label, kind in classes.items()],
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
