"""Export identified loads as URDF, JSON and in the syntax of robot controllers.

Each format is a pure function from loads (SI, flange frame) to text. The inertia tensor is identifiable only from
motion; if it was not measured, the controller's own "point mass" or "zero" is written with a comment. A load with a
quantity that is not identifiable is refused.

LoadType values of OPC 40010-1 (OPC UA for Robotics) are for the OPC UA server of the robot. OPC 40010-1 7.23.2: Mass
(AnalogUnitType, EngineeringUnits mandatory), CenterOfMass (3DFrameType: X, Y, Z of the centre in the coordinate system
of the mounting point, the flange; A, B, C the orientation of the principal axes of inertia in it) and Inertia
(3DVectorType: the three principal moments). OPC 10000-5 7.28 and 12.28: CartesianCoordinates X, Y, Z with their
LengthUnit, Orientation A, B, C with its AngleUnit, rotations about x, y and z. Their order is not said there and is
that of OPC 10000-210 7.4: about z, the new y, the new x. Units by UNECE Recommendation 20, as EUInformation has them
(OPC 10000-8 5.6.3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.sax.saxutils import quoteattr

from drives.printable import one_line
from gateway.errors import ConfigError, DataUnusable, InputError
from gateway.result.controllers import to_abb, to_fanuc, to_kuka, to_ros, to_ur, to_yaskawa
from gateway.result.drawn import Drawn
from gateway.result.export_load import SCREEN_WIDTH, ExportLoad, accuracy, complete, number_text, unique_names
from gateway.result.inertia import principal_axes, zyx_degrees
from gateway.result.library import read_library
from gateway.result.result import read_result

if TYPE_CHECKING:
    from gateway.result.result import LoadResult, Result
    from gateway.result.values import Numbers

NAMESPACE: Final = "http://opcfoundation.org/UA/Robotics/"
_UNECE: Final = "http://www.opcfoundation.org/UA/units/un/cefact"
#: Common code of UNECE Recommendation 20, what is shown, and what it is called.
_UNITS: Final = {
    "kg": ("KGM", "kg", "kilogram"),
    "m": ("MTR", "m", "metre"),
    "deg": ("DD", "\N{DEGREE SIGN}", "degree [unit of angle]"),
    "kg m2": ("B32", "kg\N{MIDDLE DOT}m\N{SUPERSCRIPT TWO}", "kilogram metre squared"),
}
Writer = Callable[[Sequence[ExportLoad], str], str]


def export(result: Result, fmt: str, label: str | None = None) -> str:
    """Return the identified loads in the syntax of `fmt`.

    Parameters
    ----------
    result : Result
    fmt : str
        A key of `FORMATS`.
    label : str, optional
        Load to write; every load that was identified if omitted.

    Returns
    -------
    str
        Text that ends with a newline.

    Raises
    ------
    ConfigError
        Unknown format or label; no flange given where the controller needs it.
    DataUnusable
        The load was refused, or a component was not identifiable.
    """
    if fmt not in FORMATS:
        raise ConfigError(f"format '{fmt}' is not known; choose one of {', '.join(FORMATS)}")
    write, frames = FORMATS[fmt]
    labels = [load.label for load in result.loads]
    names, screen_names = unique_names(labels), unique_names(labels, SCREEN_WIDTH)
    loads = [
        replace(complete(load, frames, result.data), name=names[load.label], screen_name=screen_names[load.label])
        for load in _chosen(result, label)
    ]
    return write(loads, one_line(result.robot))


def loads_of_library(path: Path) -> Result:
    """Return one result with all loads of a library, for `export`.

    Raises
    ------
    InputError
        The library or one of its results cannot be used, or they are of different robots, arms or flange frames.
    """
    results = [read_result(Path(f"{path}#{label}")) for label in read_library(path)]
    pairs = [(result, result.data or Drawn()) for result in results]
    if len({(result.robot, about.arm, about.flange_source) for result, about in pairs}) != 1:
        advice = "estimate the older ones again with --save"
        raise InputError(f"{path}: its loads are not of one robot, arm and flange frame; {advice}")
    loads = [(load, about) for result, about in pairs for load in result.loads]
    flange = {load.label: about.flange[load.label] for load, about in loads if load.label in about.flange}
    about = replace(pairs[0][1], flange=flange)
    return replace(results[0], loads=tuple(load for load, _ in loads), data=about)


def _chosen(result: Result, label: str | None) -> list[LoadResult]:
    if label is not None:
        loads = [load for load in result.loads if load.label == label]
        if not loads:
            known = ", ".join(load.label for load in result.loads) or "none"
            raise ConfigError(f"load '{label}' is not in the result; it holds: {known}")
        return loads
    if not result.loads:
        raise DataUnusable(
            "the result contains no load; estimate one first (servo-gateway estimate DATA --json OUT.json)"
        )
    return [load for load in result.loads if math.isfinite(load.mass_kg)] or list(result.loads)


def to_urdf(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return a link and a fixed joint per load, below its frame; without inertia if unknown."""
    parts = [
        '<?xml version="1.0"?>',
        f"<!-- loads identified on {_comment(robot)} -->",
        f"<robot name={quoteattr(robot)}>",
    ]
    for frame in dict.fromkeys(load.frame for load in loads):
        parts += [
            f"  <!-- {_comment(frame)}: rename this link, here and as parent below, to the name in your robot -->",
            f"  <link name={quoteattr(frame)}/>",
        ]
    for load in loads:
        name = f"load_{load.name}"
        xyz = " ".join(number_text(value, 6) for value in load.com_m)
        parts += [
            f"  <!-- {_comment(load.label)}: {accuracy(load)}; {_comment(load.inertia_note)};"
            f" frame: {_comment(load.frame_note)} -->",
            f'  <link name="{name}">',
            "    <inertial>",
            f'      <origin xyz="{xyz}" rpy="0 0 0"/>',
            f'      <mass value="{number_text(load.mass_kg, 6)}"/>',
            f"      {_urdf_inertia(load)}",
            "    </inertial>",
            "  </link>",
            f'  <joint name="{name}_joint" type="fixed">',
            f"    <parent link={quoteattr(load.frame)}/>",
            f'    <child link="{name}"/>',
            '    <origin xyz="0 0 0" rpy="0 0 0"/>',
            "  </joint>",
        ]
    return "\n".join([*parts, "</robot>", ""])


def _urdf_inertia(load: ExportLoad) -> str:
    if load.inertia_kg_m2 is None:
        return "<!-- add <inertia> from CAD: URDF requires it, and zero is wrong -->"
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    reported = (f'{name}="{number_text(value, 6)}"' for name, value in zip(names, load.inertia_kg_m2, strict=True))
    return f"<inertia {' '.join(reported)}/>"


def _comment(text: str) -> str:
    return text.replace("--", "- -")


def to_json(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return mass, centre of gravity and inertia in SI with their frame; an unknown inertia is `null`."""
    from gateway.result.values import json_text

    handed = []
    for load in loads:
        reported = asdict(load)
        note = reported.pop("inertia_note")
        del reported["screen_name"]
        handed.append(reported | {"note": note})
    return json_text({"robot": robot, "loads": handed})


def unit(name: str) -> dict[str, Any]:
    """Return the EUInformation of a unit; its UnitId is the common code, its characters as bytes of one number."""
    code, shown, called = _UNITS[name]
    number = 0
    for letter in code:
        number = number * 256 + ord(letter)
    return {"NamespaceUri": _UNECE, "UnitId": number, "DisplayName": shown, "Description": called}


def to_opc40010(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return JSON text with a LoadType per load; an unknown inertia is omitted, as the standard allows."""
    from gateway.result.values import json_text

    return json_text({"NamespaceUri": NAMESPACE, "Robot": robot, "Loads": [_load(load) for load in loads]})


def _load(load: ExportLoad) -> dict[str, Any]:
    tensor = load.tensor_kg_m2
    moments: Numbers | None = None
    yaw, pitch, roll = 0.0, 0.0, 0.0
    if tensor is not None:
        principal, axes = principal_axes(tensor)
        moments, (yaw, pitch, roll) = tuple(principal.tolist()), zyx_degrees(axes)
    reported: dict[str, Any] = {
        "BrowseName": load.label,
        "TypeDefinition": "LoadType",
        "Description": f"{accuracy(load)}; {load.inertia_note}; frame: {load.frame_note}",
        "Mass": {
            "TypeDefinition": "AnalogUnitType",
            "DataType": "Double",
            "Value": load.mass_kg,
            "EngineeringUnits": unit("kg"),
        },
        "CenterOfMass": {
            "TypeDefinition": "3DFrameType",
            "DataType": "3DFrame",
            "Value": {
                "CartesianCoordinates": dict(zip("XYZ", load.com_m, strict=True)),
                "Orientation": {"A": roll, "B": pitch, "C": yaw},
            },
            "CartesianCoordinates": {"LengthUnit": unit("m")},
            "Orientation": {"AngleUnit": unit("deg")},
        },
    }
    if moments is not None and all(map(math.isfinite, moments)):
        reported["Inertia"] = {
            "TypeDefinition": "3DVectorType",
            "DataType": "3DVector",
            "Value": dict(zip("XYZ", moments, strict=True)),
            "VectorUnit": unit("kg m2"),
        }
    return reported


# format -> writer and the frames it may be given in, the preferred one first
FORMATS: dict[str, tuple[Writer, tuple[str, ...]]] = {
    "urdf": (to_urdf, ("flange", "link_6")),
    "json": (to_json, ("flange", "link_6")),
    "abb": (to_abb, ("flange",)),
    "kuka": (to_kuka, ("flange",)),
    "ur": (to_ur, ("flange",)),
    "fanuc": (to_fanuc, ("flange",)),
    "yaskawa": (to_yaskawa, ("flange",)),
    "opc40010": (to_opc40010, ("flange",)),
    "ros": (to_ros, ("flange", "link_6")),
}
