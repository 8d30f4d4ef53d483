"""Identified loads in the syntax of robot controllers: pure functions from loads (SI, flange frame) to text.

Units, frames and sources: docs/reference/controller-formats.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gateway.result.export_load import INERTIA_NOTE, ExportLoad, accuracy, identifier, number_text
from gateway.result.inertia import principal_axes, quaternion, zyx_degrees
from gateway.result.numerals import SAID, half_width

if TYPE_CHECKING:
    from gateway.result.values import Numbers

#: 1 kg m2 in FANUC's kgf cm s2.
KGF_CM_S2_PER_KG_M2 = 100.0 / 9.80665
#: Products of inertia below this share of the largest moment count as zero.
NO_PRODUCT = 1e-3


def _assumed(mark: str, loads: Sequence[ExportLoad], short: str = "") -> list[str]:
    """Return a comment line on the origin of the flange frame; a warning if it is assumed."""
    sources = [load for load in loads if load.flange_source is not None]
    if not sources:
        return []
    if any(load.flange_is_assumed for load in sources):
        warning = "WARNING: the orientation of the flange is assumed, X, Y, Z may be exchanged: check it before use"
        return [short or f"{mark} {warning} ({sources[0].flange_source})"]
    return [] if short else [f"{mark} flange in the last link: {sources[0].flange_source}"]


def to_abb(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return RAPID `loaddata`: [mass kg, cog mm, axes of moment, ix, iy, iz kg m2]; zero inertia is a point mass.

    The axes of moment are the principal axes, a quaternion in the wrist frame, with their origin in cog.
    """
    lines = [f"! loads identified on {robot}; frame: wrist (tool0)", *_assumed("!", loads)]
    for load in loads:
        cog = ",".join(number_text(1000 * value, 2) for value in load.com_m)
        tensor, note, inertia = load.tensor_kg_m2, f"{load.inertia_note}: 0,0,0 lets RAPID take a point mass", ""
        if tensor is None:
            inertia = "[1,0,0,0],0,0,0"
        else:
            moments, axes = principal_axes(tensor)
            turned = ",".join(number_text(value, 6) for value in quaternion(axes))
            inertia = f"[{turned}],{','.join(number_text(value, 5) for value in moments.tolist())}"
            note = f"{load.inertia_note}, by its principal axes"
        lines += [
            f"! {load.label}: {accuracy(load)}; {note}",
            f"PERS loaddata {load.name}:=[{number_text(load.mass_kg, 3)},[{cog}],{inertia}];",
        ]
    return "\n".join([*lines, ""])


def to_kuka(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return KRL `LOAD_DATA[n]`: mass kg, CM in mm and degrees in the flange frame, J kg m2.

    A, B, C rotate the flange axes into the principal axes of inertia: about z, the new y, the new x.
    """
    head = f"; loads identified on {robot}; frame: flange; copy to $CONFIG.DAT under the tool number used"
    lines = [head, *_assumed(";", loads)]
    for number, load in enumerate(loads, start=1):
        x, y, z = (number_text(1000 * value, 2) for value in load.com_m)
        tensor, note = load.tensor_kg_m2, f"{load.inertia_note}: J 0.0, enter J from CAD before fast motion"
        turn, inertia = ("0.0",) * 3, ("0.0",) * 3
        if tensor is not None:
            moments, axes = principal_axes(tensor)
            turn = tuple(number_text(value, 3) for value in zyx_degrees(axes))
            inertia = tuple(number_text(value, 5) for value in moments.tolist())
            note = f"{load.inertia_note}, by its principal axes"
        centre = f"X {x},Y {y},Z {z},A {turn[0]},B {turn[1]},C {turn[2]}"
        own = f"X {inertia[0]},Y {inertia[1]},Z {inertia[2]}"
        aggregate = f"{{M {number_text(load.mass_kg, 3)},CM {{{centre}}},J {{{own}}}}}"
        lines += [
            f"; {load.label}: {accuracy(load)}; {note}",
            f"LOAD_DATA[{number}]={aggregate}",
            f"; or in a program: $LOAD={aggregate}",
        ]
    return "\n".join([*lines, ""])


def to_ur(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return URScript `set_target_payload(m, cog, inertia)`: kg, m, kg m2 about cog with the axes of the tool flange.

    The controller takes an omitted inertia as zero.
    """
    lines = [f"# loads identified on {robot}; frame: tool flange", *_assumed("#", loads)]
    for load in loads:
        cog = ", ".join(number_text(value, 5) for value in load.com_m)
        note, inertia = f"{load.inertia_note}: left out, the controller takes zero", ""
        if load.inertia_kg_m2 is not None:
            note = load.inertia_note
            inertia = f", [{', '.join(number_text(value, 6) for value in load.inertia_kg_m2)}]"
        lines += [
            f"# {load.label}: {accuracy(load)}; {note}",
            f"def use_{load.name}():",
            f"  set_target_payload({number_text(load.mass_kg, 3)}, [{cog}]{inertia})",
            "end",
        ]
    return "\n".join([*lines, ""])


def to_ros(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return `geometry_msgs/msg/Inertia` of ROS 2 by name of the load, as YAML: kg, m, kg m2.

    The inertia is about the centre of gravity. The message has no frame: the comment of a load names it. An omitted
    inertia is zero in the message.
    """
    lines = [f"# geometry_msgs/msg/Inertia of the loads identified on {robot}", *_assumed("#", loads)]
    for load in loads:
        note = f"{load.inertia_note}: left out, a message has zero" if load.inertia_kg_m2 is None else load.inertia_note
        lines += [f"# {load.label}: {accuracy(load)}; frame: {load.frame}; {note}", f'"{load.name}":']
        lines.append(f"  m: {number_text(load.mass_kg, 3)}")
        centre = ", ".join(f"{name}: {number_text(value, 5)}" for name, value in zip("xyz", load.com_m, strict=True))
        lines.append(f"  com: {{{centre}}}")
        moments = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), load.inertia_kg_m2 or (), strict=False)
        lines += [f"  {name}: {number_text(value, 6)}" for name, value in moments]
    return "\n".join([*lines, ""])


def _moments(load: ExportLoad) -> tuple[Numbers, str]:
    """Return moments of inertia about the axes of the frame, and a note on omitted products of inertia."""
    if load.inertia_kg_m2 is None:
        return (0.0, 0.0, 0.0), ""
    moments, products = load.inertia_kg_m2[:3], load.inertia_kg_m2[3:]
    most = max(map(abs, products))
    left = f"products of inertia up to {most:.3g} kg m2 left out" if most > NO_PRODUCT * max(moments) else ""
    return moments, left


def to_fanuc(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return a TP program (.LS) that sets payload schedules from 1: mass kg, centre of gravity cm from the faceplate.

    Inertia is in kgf cm s2 about axes through the centre of gravity, parallel to the faceplate; 0 if not measured.
    The program contains no motion; `PAYLOAD[n]` selects a schedule. Negative constants are in brackets; a remark has
    at most 32 characters.
    """
    lines = [f"!{_remark(f'loads of {robot}')}", "!kg, cm from faceplate, kgf cm s2"]
    lines += [f"!{_remark(line)}" for line in _assumed("", loads, "faceplate turn is ASSUMED, check")]
    for number, load in enumerate(loads, start=1):
        moments, left = _moments(load)
        lines += [f"!{_remark(load.heading)}", f"!{_remark(_short_accuracy(load))}"]
        lines.append(f"!{_remark(_short_inertia(load, left))}")
        lines.append(f"$PLST_GRP1[{number}].$PAYLOAD={number_text(load.mass_kg, 3)}")
        for axis, value in zip("XYZ", load.com_m, strict=True):
            text = number_text(100 * value, 3)
            lines.append(f"$PLST_GRP1[{number}].$PAYLOAD_{axis}={f'({text})' if text.startswith('-') else text}")
        for axis, value in zip("XYZ", moments, strict=True):
            text = "0" if load.inertia_kg_m2 is None else number_text(KGF_CM_S2_PER_KG_M2 * value, 4)
            lines.append(f"$PLST_GRP1[{number}].$PAYLOAD_I{axis}={text}")
    lines.append("!select with PAYLOAD[n]")
    body = [f"{number:4d}:  {line} ;" for number, line in enumerate(lines, start=1)]
    head = ["/PROG  SETLOADS", "/ATTR", 'COMMENT = "identified loads";', "DEFAULT_GROUP = *,*,*,*,*;", "/MN"]
    return "\n".join([*head, *body, "/POS", "/END", ""])


def _short_inertia(load: ExportLoad, left: str) -> str:
    """Return the note on the inertia, short enough for a remark."""
    if load.inertia_kg_m2 is None:
        return "inertia not measured: 0" if load.inertia_note == INERTIA_NOTE else "inertia not known: 0"
    return "inertia without its products" if left else "inertia about the gravity centre"


def _remark(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9 .,:+=()_-]", " ", text)[:32].rstrip()


def _short_accuracy(load: ExportLoad) -> str:
    half = "" if math.isnan(load.mass_std_kg) else f" +- {half_width(load.mass_std_kg):.3f}"
    # a remark holds no percent sign
    return f"{load.mass_kg:.3f}{half} kg ({SAID.replace('%', 'pct')})"


def to_yaskawa(loads: Sequence[ExportLoad], robot: str) -> str:
    """Return a Smart Pendant preset file (.yps), one tool per load: weight kg, com mm from the mounting plate, moi kg
    m2.

    The pendant pre-fills a new tool; the operator confirms it. The controller's "tool" is everything on the flange,
    as identified. moi are the moments about axes through com, parallel to the plate; 0 if not measured. The offset
    keeps the pendant's default.
    """
    lines = [
        f"// loads identified on {robot}; frame: tool mounting plate",
        *_assumed("//", loads),
        "{",
        '  filetype: "presets",',
        "  presets: [",
    ]
    for load in loads:
        com = ", ".join(number_text(1000 * value, 2) for value in load.com_m)
        moments, left = _moments(load)
        moi, note = "0.0, 0.0, 0.0", f"{load.inertia_note}: 0, enter it from CAD if it is large"
        if load.inertia_kg_m2 is not None:
            moi, note = ", ".join(number_text(value, 5) for value in moments), load.inertia_note
        lines += [
            f"    // {load.label}: {accuracy(load)}; {note}{f'; {left}' if left else ''}",
            "    {",
            '      preset: "tool",',
            f'      id: "local.{identifier(robot).lower()}.{load.name.lower()}",',
            f'      displayNames: {{ en: "{load.screen_name}" }},',
            f"      weight: {number_text(load.mass_kg, 3)},",
            f"      com: [{com}],",
            f"      moi: [{moi}]",
            "    },",
        ]
    lines[-1] = "    }"
    return "\n".join([*lines, "  ]", "}", ""])
