"""The identified load in the words of URDF and of robot controllers.

Each format is a pure function from one load (SI, flange frame) to text. What the measurement at rest cannot give, the
inertia tensor, is written as the controller's own "point mass" or "zero" and the text says so; what the data could not
identify is refused, never filled in.

Units and frames: ABB technical reference manual RAPID, data type `loaddata` (kg, mm, kg m2, wrist frame `tool0`);
KUKA system variables `$LOAD`, `LOAD_DATA[]` (kg, mm, degrees A B C, flange frame); Universal Robots script manual,
`set_target_payload` (kg, m, tool flange frame); FANUC payload schedules, screen MOTION/PAYLOAD SET and system variable
`$PLST_GRP1` (kg, cm, faceplate frame: x up, z out); Yaskawa Smart Pendant preset files `.yps`, preset `tool` (kg, mm,
kg m2, tool mounting plate).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from gateway.cell.plausible import LARGEST_LEVER_M
from gateway.errors import ConfigError, DataUnusable
from gateway.result.interval import SAID, half_width

if TYPE_CHECKING:
    from gateway.result.drawn import Spread
    from gateway.result.result import LoadResult, Result
    from gateway.result.values import Vector

INERTIA_NOTE = "inertia not measured (no motion reveals it at rest)"


@dataclass(frozen=True, slots=True)
class ExportLoad:
    """One load that is complete enough to be handed over.

    Parameters
    ----------
    label : str
        Name of the load in the result.
    mass_kg, mass_std_kg : float
        Mass and its standard deviation, kg; NaN = unknown.
    com_m, com_std_m : tuple of 3 float
        Centre of gravity in `frame`, m, and its standard deviation; None = unknown.
    frame : str
        `flange` or `link_6`.
    """

    label: str
    mass_kg: float
    mass_std_kg: float
    com_m: Vector
    com_std_m: Vector | None
    frame: str


def export(result: Result, fmt: str, label: str | None = None) -> str:
    """Text of the identified load(s) in the syntax of `fmt`.

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
    turned = {} if result.data is None else result.data.flange
    loads = [_complete(load, frames, turned.get(load.label)) for load in _chosen(result, label)]
    return write(loads, _one_line(result.robot))


def _chosen(result: Result, label: str | None) -> list[LoadResult]:
    if label is not None:
        loads = [load for load in result.loads if load.label == label]
        if not loads:
            known = ", ".join(load.label for load in result.loads) or "none"
            raise ConfigError(f"load '{label}' is not in the result; it holds: {known}")
        return loads
    if not result.loads:
        raise DataUnusable("the result holds no load; estimate one first (servo-gateway estimate DATA --json OUT.json)")
    return [load for load in result.loads if math.isfinite(load.mass_kg)] or list(result.loads)


def _complete(load: LoadResult, frames: Sequence[str], in_flange: Spread | None) -> ExportLoad:
    if not math.isfinite(load.mass_kg):
        raise DataUnusable(f"load '{load.label}' has no mass to hand over: {load.refused or _unidentifiable(load)}")
    if load.com_flange_m is not None and "flange" in frames:
        return _checked(load, load.com_flange_m, None if in_flange is None else in_flange.com_std_m, "flange")
    if "link_6" in frames and load.com_m is not None:
        return _checked(load, load.com_m, load.com_std_m, _one_line(load.frame))
    if load.com_m is None or not all(map(math.isfinite, load.com_m)):
        raise DataUnusable(f"load '{load.label}' has no centre of gravity to hand over: {_unidentifiable(load)}")
    raise ConfigError(
        f"load '{load.label}': the controller wants the centre of gravity in the flange frame, and the flange is not "
        "given; add flange_xyz_m and flange_rpy_rad (flange in link_6) to the cell file, estimate again with --cell"
    )


def _checked(load: LoadResult, com: Vector, std: Vector | None, frame: str) -> ExportLoad:
    if not all(map(math.isfinite, com)):
        raise DataUnusable(
            f"load '{load.label}': the centre of gravity is not complete ({_unidentifiable(load)}); measure the poses "
            "that the result names under `next`"
        )
    far = max(map(abs, com))
    if not load.mass_kg > 0:
        raise DataUnusable(
            f"load '{load.label}' has a mass of {load.mass_kg:g} kg: no load weighs that, and a controller that is told"
            " so lets the arm fall; check signs and the bare run with diagnose, then measure again"
        )
    if far > LARGEST_LEVER_M:
        raise DataUnusable(
            f"load '{load.label}': its centre of gravity lies {far:.3g} m off, beyond {LARGEST_LEVER_M:g} m: so"
            " light a load does not say where it is; measure it again, or enter it by hand"
        )
    known = std is not None and all(map(math.isfinite, std))
    return ExportLoad(_one_line(load.label), load.mass_kg, load.mass_std_kg, com, std if known else None, frame)


def _unidentifiable(load: LoadResult) -> str:
    return f"not identifiable: {', '.join(load.unidentifiable)}" if load.unidentifiable else "it was not estimated"


def _number(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text


def _one_line(text: str) -> str:
    return "".join(character if character.isprintable() else " " for character in text).strip()


def _identifier(label: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_]", "_", label)
    return (name if name[:1].isalpha() else f"load_{name}")[:28]


def _accuracy(load: ExportLoad) -> str:
    mass = f"{load.mass_kg:.3f} kg"
    if math.isfinite(load.mass_std_kg):
        mass += f" +- {half_width(load.mass_std_kg):.3f} kg"
    if load.com_std_m is None:
        return f"{mass} ({SAID})"
    x, y, z = (1000 * half_width(value) for value in load.com_std_m)
    return f"{mass}, centre of gravity +- {x:.1f} {y:.1f} {z:.1f} mm ({SAID})"


def to_urdf(loads: Sequence[ExportLoad], robot: str) -> str:
    """Link and fixed joint per load below the frame that it is given in; no inertia, which is not known."""
    parts = [
        '<?xml version="1.0"?>',
        f"<!-- loads identified on {_comment(robot)} -->",
        f"<robot name={quoteattr(robot)}>",
    ]
    for frame in dict.fromkeys(load.frame for load in loads):
        parts += [
            f"  <!-- {_comment(frame)}: give this link and the parents below the name that it has in your robot -->",
            f"  <link name={quoteattr(frame)}/>",
        ]
    for load in loads:
        name = f"load_{_identifier(load.label)}"
        xyz = " ".join(_number(value, 6) for value in load.com_m)
        parts += [
            f"  <!-- {_comment(load.label)}: {_accuracy(load)}; {INERTIA_NOTE} -->",
            f'  <link name="{name}">',
            "    <inertial>",
            f'      <origin xyz="{xyz}" rpy="0 0 0"/>',
            f'      <mass value="{_number(load.mass_kg, 6)}"/>',
            "      <!-- add <inertia> from CAD, which readers of URDF ask for: zero would be wrong -->",
            "    </inertial>",
            "  </link>",
            f'  <joint name="{name}_joint" type="fixed">',
            f"    <parent link={quoteattr(load.frame)}/>",
            f'    <child link="{name}"/>',
            '    <origin xyz="0 0 0" rpy="0 0 0"/>',
            "  </joint>",
        ]
    return "\n".join([*parts, "</robot>", ""])


def _comment(text: str) -> str:
    return text.replace("--", "- -")


def to_json(loads: Sequence[ExportLoad], robot: str) -> str:
    """Mass and centre of gravity in SI, the frame named, inertia `null`."""
    from gateway.result.values import json_text

    handed = [asdict(load) | {"inertia_kg_m2": None, "note": INERTIA_NOTE} for load in loads]
    return json_text({"robot": robot, "loads": handed})


def to_abb(loads: Sequence[ExportLoad], robot: str) -> str:
    """RAPID `loaddata`: [mass kg, cog mm, axes of moment, ix, iy, iz kg m2]; all inertia 0 is a point mass there."""
    lines = [f"! loads identified on {robot}; frame: wrist (tool0)"]
    for load in loads:
        cog = ",".join(_number(1000 * value, 2) for value in load.com_m)
        lines += [
            f"! {load.label}: {_accuracy(load)}; {INERTIA_NOTE}: 0,0,0 lets RAPID take a point mass",
            f"PERS loaddata {_identifier(load.label)}:=[{_number(load.mass_kg, 3)},[{cog}],[1,0,0,0],0,0,0];",
        ]
    return "\n".join([*lines, ""])


def to_kuka(loads: Sequence[ExportLoad], robot: str) -> str:
    """KRL `LOAD_DATA[n]`: mass kg, CM in mm and degrees in the flange frame, J kg m2."""
    lines = [f"; loads identified on {robot}; frame: flange; copy to $CONFIG.DAT under the tool number used"]
    for number, load in enumerate(loads, start=1):
        x, y, z = (_number(1000 * value, 2) for value in load.com_m)
        mass = _number(load.mass_kg, 3)
        aggregate = f"{{M {mass},CM {{X {x},Y {y},Z {z},A 0.0,B 0.0,C 0.0}},J {{X 0.0,Y 0.0,Z 0.0}}}}"
        lines += [
            f"; {load.label}: {_accuracy(load)}; {INERTIA_NOTE}: J 0.0, enter J from CAD before fast motion",
            f"LOAD_DATA[{number}]={aggregate}",
            f"; or in a program: $LOAD={aggregate}",
        ]
    return "\n".join([*lines, ""])


def to_ur(loads: Sequence[ExportLoad], robot: str) -> str:
    """URScript `set_target_payload(m, cog)`; the inertia argument is left out, which the controller takes as zero."""
    lines = [f"# loads identified on {robot}; frame: tool flange"]
    for load in loads:
        cog = ", ".join(_number(value, 5) for value in load.com_m)
        lines += [
            f"# {load.label}: {_accuracy(load)}; {INERTIA_NOTE}: left out, the controller takes zero",
            f"def use_{_identifier(load.label)}():",
            f"  set_target_payload({_number(load.mass_kg, 3)}, [{cog}])",
            "end",
        ]
    return "\n".join([*lines, ""])


def to_fanuc(loads: Sequence[ExportLoad], robot: str) -> str:
    """TP program (ASCII, .LS) that fills payload schedules from 1 on: mass kg, centre of gravity cm from the faceplate.

    Inertia is written as 0. The program holds no motion; `PAYLOAD[n]` selects a schedule. Negative constants stand in
    brackets, a remark has at most 32 characters.
    """
    lines = [f"!{_remark(f'loads of {robot}')}", "!kg, cm from the faceplate"]
    for number, load in enumerate(loads, start=1):
        lines += [f"!{_remark(load.label)}", f"!{_remark(_short_accuracy(load))}", "!inertia not measured: 0"]
        lines.append(f"$PLST_GRP1[{number}].$PAYLOAD={_number(load.mass_kg, 3)}")
        for axis, value in zip("XYZ", load.com_m, strict=True):
            text = _number(100 * value, 3)
            lines.append(f"$PLST_GRP1[{number}].$PAYLOAD_{axis}={f'({text})' if text.startswith('-') else text}")
        lines += [f"$PLST_GRP1[{number}].$PAYLOAD_I{axis}=0" for axis in "XYZ"]
    lines.append("!select with PAYLOAD[n]")
    body = [f"{number:4d}:  {line} ;" for number, line in enumerate(lines, start=1)]
    head = ["/PROG  SETLOADS", "/ATTR", 'COMMENT = "identified loads";', "DEFAULT_GROUP = *,*,*,*,*;", "/MN"]
    return "\n".join([*head, *body, "/POS", "/END", ""])


def _remark(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9 .,:+=()_-]", " ", text)[:32].rstrip()


def _short_accuracy(load: ExportLoad) -> str:
    half = "" if math.isnan(load.mass_std_kg) else f" +- {half_width(load.mass_std_kg):.3f}"
    # a remark holds no percent sign
    return f"{load.mass_kg:.3f}{half} kg ({SAID.replace('%', 'pct')})"


def to_yaskawa(loads: Sequence[ExportLoad], robot: str) -> str:
    """Smart Pendant preset file (.yps) with a tool per load: weight kg, com mm from the mounting plate, moi kg m2.

    The pendant pre-fills a new tool's settings; the person there confirms them. The tool's own weight is not in it: the
    controller's "tool" is everything on the flange, which is what was identified. moi is written as 0, offset is left
    to the pendant's default.
    """
    lines = [
        f"// loads identified on {robot}; frame: tool mounting plate",
        "{",
        '  filetype: "presets",',
        "  presets: [",
    ]
    for load in loads:
        com = ", ".join(_number(1000 * value, 2) for value in load.com_m)
        name = _identifier(load.label)
        lines += [
            f"    // {load.label}: {_accuracy(load)}; {INERTIA_NOTE}: 0, enter it from CAD if it is large",
            "    {",
            '      preset: "tool",',
            f'      id: "local.{_identifier(robot).lower()}.{name.lower()}",',
            f'      displayNames: {{ en: "{name[:16]}" }},',
            f"      weight: {_number(load.mass_kg, 3)},",
            f"      com: [{com}],",
            "      moi: [0.0, 0.0, 0.0]",
            "    },",
        ]
    lines[-1] = "    }"
    return "\n".join([*lines, "  ]", "}", ""])


Writer = Callable[[Sequence[ExportLoad], str], str]

# format -> writer and the frames it may be given in, the preferred one first
FORMATS: dict[str, tuple[Writer, tuple[str, ...]]] = {
    "urdf": (to_urdf, ("flange", "link_6")),
    "json": (to_json, ("flange", "link_6")),
    "abb": (to_abb, ("flange",)),
    "kuka": (to_kuka, ("flange",)),
    "ur": (to_ur, ("flange",)),
    "fanuc": (to_fanuc, ("flange",)),
    "yaskawa": (to_yaskawa, ("flange",)),
}
