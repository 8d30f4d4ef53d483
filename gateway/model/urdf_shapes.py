"""Elements and attributes of a URDF file, and `<collision>` of a link as written; no arithmetic."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
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


@dataclass(frozen=True, slots=True)
class Sphere:
    """Sphere about the origin of its frame."""

    radius_m: float


@dataclass(frozen=True, slots=True)
class Cylinder:
    """Cylinder along z, centred at the origin; `rounded` adds a half sphere at both ends."""

    radius_m: float
    length_m: float
    rounded: bool = False


@dataclass(frozen=True, slots=True)
class Box:
    """Box along the axes, centred at the origin."""

    size_m: Three


@dataclass(frozen=True, slots=True)
class Mesh:
    """Mesh in a separate file."""

    file: str
    scale: Three


@dataclass(frozen=True, slots=True)
class Unknown:
    """Shape of unknown kind, or without size; `what` names it."""

    what: str


Shape = Sphere | Cylinder | Box | Mesh | Unknown


def shapes_of(link: ET.Element, name: str, where: str) -> Iterator[tuple[Pose, Shape]]:
    """Return the shapes of a link with their poses in it; a shape that cannot be used is `Unknown`.

    Raises
    ------
    ConfigError
        A pose is invalid; the message names file and element.
    """
    label = f"link '{name}' <collision>"
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        for element in [] if geometry is None else list(geometry):
            yield origin(collision, label, where), _shape(element)


def _shape(element: ET.Element) -> Shape:
    tag = element.tag
    try:
        if tag == "sphere":
            return Sphere(_size(element, "radius"))
        if tag in ("cylinder", "capsule"):
            return Cylinder(_size(element, "radius"), _size(element, "length"), tag == "capsule")
        if tag == "box":
            size = three(element, "size", tag, "", None)
            return Box(size) if min(size) > 0 else Unknown(f"<box> of size {element.get('size')}")
        if tag == "mesh" and element.get("filename"):
            return Mesh(element.get("filename", ""), three(element, "scale", tag, "", (1.0, 1.0, 1.0)))
    except ConfigError:
        written = " ".join(f"{key}={value!r}" for key, value in element.attrib.items())
        return Unknown(f"<{tag}> with {written or 'no size'}")
    return Unknown(f"<{tag}>")


def _size(element: ET.Element, key: str) -> float:
    value = number(element, key, element.tag, "", None)
    if value <= 0:
        raise ConfigError(f"{key} must be positive")
    return value
