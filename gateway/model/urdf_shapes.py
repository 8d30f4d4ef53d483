"""`<collision>` of a link as written: spheres, cylinders, boxes and the names of meshes; no arithmetic."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

from gateway.errors import ConfigError
from gateway.model.urdf_elements import Pose, Three, number, origin, three


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball about its frame's origin."""

    radius_m: float


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder along z, its middle in the origin; `rounded` has half a ball at both ends in addition."""

    radius_m: float
    length_m: float
    rounded: bool = False


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes, its middle in the origin."""

    size_m: Three


@dataclass(frozen=True, slots=True)
class Mesh:
    """A mesh in a file of its own."""

    file: str
    scale: Three


@dataclass(frozen=True, slots=True)
class Unknown:
    """A shape that is not understood; `what` names it."""

    what: str


Shape = Sphere | Cylinder | Box | Mesh | Unknown


def shapes_of(link: ET.Element, name: str, where: str) -> Iterator[tuple[Pose, Shape]]:
    """Shapes of a link with their poses in it.

    Raises
    ------
    ConfigError
        A shape without its size, or with one that is not positive; names file and element.
    """
    label = f"link '{name}' <collision>"
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        for element in [] if geometry is None else list(geometry):
            yield origin(collision, label, where), _shape(element, f"{label} <{element.tag}>", where)


def _shape(element: ET.Element, label: str, where: str) -> Shape:
    if element.tag == "sphere":
        return Sphere(_size(element, "radius", label, where))
    if element.tag in ("cylinder", "capsule"):
        radius, length = _size(element, "radius", label, where), _size(element, "length", label, where)
        return Cylinder(radius, length, element.tag == "capsule")
    if element.tag == "box":
        size = three(element, "size", label, where, None)
        if min(size) <= 0:
            raise ConfigError(f"{where}: {label}: size {size} m must be positive")
        return Box(size)
    if element.tag == "mesh" and element.get("filename"):
        return Mesh(element.get("filename", ""), three(element, "scale", label, where, (1.0, 1.0, 1.0)))
    return Unknown(f"<{element.tag}>")


def _size(element: ET.Element, key: str, label: str, where: str) -> float:
    value = number(element, key, label, where, None)
    if value <= 0:
        raise ConfigError(f"{where}: {label}: {key} {value} m must be positive")
    return value
