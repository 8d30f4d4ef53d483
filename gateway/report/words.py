"""Numbers with their uncertainty, and names of effects and axes, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gateway.model.effects import LIBRARY

MINUS = "\N{MINUS SIGN}"
# two-sided 95 % quantile of the normal distribution
TWO_SIDED_95 = 1.96

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


def known(value: float | None) -> bool:
    """Whether there is a number."""
    return value is not None and math.isfinite(value)


def decimals(uncertainty: float) -> int:
    """Decimals that show two significant digits of an uncertainty."""
    if not uncertainty > 0 or not math.isfinite(uncertainty):
        return 2
    return max(0, 1 - math.floor(math.log10(uncertainty)))


def plain(value: float | None, digits: int = 2) -> str:
    """A number with fixed decimals, a real minus sign, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    text = f"{value:.{digits}f}"
    return text.replace("-", MINUS) if float(text) != 0 else text.lstrip("-")


def significant(value: float | None, digits: int = 3) -> str:
    """A number with significant digits, scientific where it is very large or small."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    return f"{value:.{digits}g}".replace("-", MINUS)


def rounded(value: float) -> str:
    """A number with three significant digits, none behind the third decimal and no exponent; a dash where unknown."""
    if not math.isfinite(value) or value == 0:
        return plain(value, 0)
    return plain(value, max(0, min(3, 2 - math.floor(math.log10(abs(value))))))


def plus_minus(value: float, half_width: float) -> tuple[str, str]:
    """Value and half width of its interval with matching decimals; an empty half width where it is unknown."""
    if not known(value):
        return "unknown", ""
    if not known(half_width):
        return significant(value, 4), ""
    digits = min(decimals(half_width), 6)
    return plain(value, digits), plain(half_width, digits)


def axis(joint: int) -> str:
    """Name of an axis, counted from 1."""
    return f"J{joint}"


def axes(joints: Sequence[int]) -> str:
    """Names of axes; empty for the base and the load."""
    return "\N{EN DASH}".join(axis(joint) for joint in joints)


def load(label: str) -> str:
    """A load in words; `none` is the bare arm."""
    return (
        "bare arm" if label == "none" else f"load \N{LEFT DOUBLE QUOTATION MARK}{label}\N{RIGHT DOUBLE QUOTATION MARK}"
    )


def effect(name: str) -> str:
    """Effect in words; a name that is in no library (of an older result) is spelled out."""
    return LIBRARY[name].words if name in LIBRARY else name.replace("_", " ")


def effect_on(name: str, joints: Sequence[int]) -> str:
    """Effect in words with its axes."""
    return f"{effect(name)} on {axes(joints)}" if joints else effect(name)


def effects_on(effects: Sequence[tuple[str, Sequence[int]]]) -> list[str]:
    """Effects in words, those of one name on several axes named once."""
    places: dict[str, list[str]] = {}
    for name, joints in effects:
        places.setdefault(name, []).append(axes(joints))
    return [
        f"{effect(name)} on {listing(sorted(filter(None, where)))}" if any(where) else effect(name)
        for name, where in places.items()
    ]


def short(name: str, joints: Sequence[int]) -> str:
    """Effect as one short label."""
    return f"{name.replace('_', ' ')} {axes(joints)}".strip()


def parameter(name: str) -> tuple[str, str]:
    """Name and unit of a parameter, from the suffix of its key."""
    for suffix, unit in UNITS:
        if name.endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)].replace("_", " "), unit
        if name == suffix.lstrip("_"):
            return name.replace("_", " "), unit
    return name.replace("_", " "), ""


def listing(items: Sequence[str], last: str = "and") -> str:
    """Words in a row: a, b and c."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"
