"""Parse values of URDF elements: numbers, triples and poses; errors name file and element."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from gateway.errors import ConfigError

Three = tuple[float, float, float]
ZERO: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Pose:
    """Element `<origin>`: translation [m], fixed-axis roll, pitch, yaw [rad]."""

    xyz_m: Three = ZERO
    rpy_rad: Three = ZERO


def origin(element: ET.Element, label: str, where: str) -> Pose:
    """Return the pose `<origin>` of an element; identity if missing."""
    found, label = element.find("origin"), f"{label} <origin>"
    if found is None:
        return Pose()
    return Pose(three(found, "xyz", label, where, ZERO), three(found, "rpy", label, where, ZERO))


def three(element: ET.Element, key: str, label: str, where: str, default: Three | None) -> Three:
    """Return three numbers of an attribute; raises ConfigError naming file, element and attribute."""
    text = element.get(key)
    if text is None:
        if default is None:
            raise ConfigError(f"{where}: {label}: {key} is missing; add it")
        return default
    words = text.split()
    if len(words) != 3:
        raise ConfigError(f'{where}: {label}: {key}="{text}" needs three numbers; write three, separated by spaces')
    x, y, z = (finite(word, f"{label} {key}", where) for word in words)
    return x, y, z


def number(element: ET.Element, key: str, label: str, where: str, default: float | None) -> float:
    """Return a number of an attribute; raises ConfigError naming file, element and attribute."""
    text = element.get(key)
    if text is None:
        if default is None:
            raise ConfigError(f"{where}: {label}: {key} is missing; add it")
        return default
    return finite(text, f"{label} {key}", where)


def finite(text: str, label: str, where: str) -> float:
    """Return a finite number; raises ConfigError naming file, element and attribute."""
    try:
        value = float(text)
    except ValueError as error:
        advice = f"such as {text.replace(',', '.')}" if "," in text else "of digits and a point"
        raise ConfigError(f"{where}: {label}: '{text}' is not a number; write a number {advice}") from error
    if not math.isfinite(value):
        raise ConfigError(f"{where}: {label}: '{text}' is not finite; write a number")
    return value
