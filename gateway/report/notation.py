"""Notation of the pages: format of numbers, names of effects and axes."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.model.effects import LIBRARY
from gateway.result.numerals import decimals, known, plain, plus_minus, rounded, significant

__all__ = (
    "axes", "axis", "decimals", "effect", "effect_on", "effects_on", "known", "listing", "load", "parameter", "plain",
    "plus_minus", "rounded", "short", "significant",
)  # fmt: skip

UNITS: tuple[tuple[str, str], ...] = (
    ("_nm_s05_rad05", "Nm (s/rad)^0.5"),
    ("_nm_s2_rad2", "Nm s2/rad2"),
    ("_nm_s_rad", "Nm s/rad"),
    ("_rad_s", "rad/s"),
    ("_nm_rad", "Nm/rad"),
    ("_rad_nm", "rad/Nm"),
    ("_n_m", "N/m"),
    ("_kg_m", "kg m"),
    ("_per_k", "1/K"),
    ("_per_s", "1/s"),
    ("_nm", "Nm"),
    ("_rad", "rad"),
    ("_kg", "kg"),
    ("_m", "m"),
    ("_s", "s"),
    ("_n", "N"),
)


def axis(joint: int) -> str:
    """Return the name of an axis, counted from 1."""
    return f"J{joint}"


def axes(joints: Sequence[int]) -> str:
    """Return the names of axes; empty for the base and the load."""
    return "\N{EN DASH}".join(axis(joint) for joint in joints)


def load(label: str) -> str:
    """Return the text of a load; `none` is the unloaded arm."""
    return (
        "unloaded arm"
        if label == "none"
        else f"load \N{LEFT DOUBLE QUOTATION MARK}{label}\N{RIGHT DOUBLE QUOTATION MARK}"
    )


def effect(name: str) -> str:
    """Return the text of an effect; an unknown name (of an older result) is spelled out."""
    return LIBRARY[name].words if name in LIBRARY else name.replace("_", " ")


def effect_on(name: str, joints: Sequence[int]) -> str:
    """Return the text of an effect with its axes."""
    return f"{effect(name)} on {axes(joints)}" if joints else effect(name)


def effects_on(effects: Sequence[tuple[str, Sequence[int]]]) -> list[str]:
    """Return the text of effects; one effect on several axes is named once."""
    places: dict[str, list[str]] = {}
    for name, joints in effects:
        places.setdefault(name, []).append(axes(joints))
    return [
        f"{effect(name)} on {listing(sorted(filter(None, where)))}" if any(where) else effect(name)
        for name, where in places.items()
    ]


def short(name: str, joints: Sequence[int]) -> str:
    """Return a short label of an effect."""
    return f"{name.replace('_', ' ')} {axes(joints)}".strip()


def parameter(name: str) -> tuple[str, str]:
    """Return name and unit of a parameter, from the suffix of its key."""
    for suffix, unit in UNITS:
        if name.endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)].replace("_", " "), unit
        if name == suffix.lstrip("_"):
            return name.replace("_", " "), unit
    return name.replace("_", " "), ""


def parameter_of(effect_name: str, key: str) -> tuple[str, str]:
    """Return the text and unit of a parameter of an effect."""
    name, unit = parameter(key)
    found = LIBRARY[effect_name].parameter_texts if effect_name in LIBRARY else {}
    return found.get(key, name), unit


def listing(items: Sequence[str], last: str = "and") -> str:
    """Join words: a, b and c."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"
