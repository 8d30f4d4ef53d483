"""Identified load as LoadType values of OPC 40010-1 (OPC UA for Robotics), for the OPC UA server of the robot.

OPC 40010-1 7.23.2: Mass (AnalogUnitType, EngineeringUnits mandatory), CenterOfMass (3DFrameType: X, Y, Z of the centre
in the coordinate system of the mounting point, the flange; A, B, C the orientation of the principal axes of inertia in
it) and Inertia (3DVectorType: the three principal moments). OPC 10000-5 7.28 and 12.28: CartesianCoordinates X, Y, Z
with their LengthUnit, Orientation A, B, C with its AngleUnit, rotations about x, y and z. Their order is not said there
and is that of OPC 10000-210 7.4: about z, the new y, the new x. Units by UNECE Recommendation 20, as EUInformation has
them (OPC 10000-8 5.6.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from gateway.result.export_load import ExportLoad, accuracy
from gateway.result.inertia import principal_axes, zyx_degrees

if TYPE_CHECKING:
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
