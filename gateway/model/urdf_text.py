"""Read a robot description file and parse it to XML elements: encoding, format, limits; xacro, MJCF and SDF are
recognised.

Documents with a DTD are refused before anything is expanded, which prevents entity expansion attacks. Undeclared
namespace prefixes are accepted as written, as in robotics software.
"""

from __future__ import annotations

import codecs
import re
import shlex
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from xml.parsers import expat

from gateway.data.regular_file import read_bounded
from gateway.errors import ConfigError

MOST_BYTES: Final = 20_000_000
MAX_DEPTH: Final = 100
_MARKS: Final = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_DECLARED: Final = re.compile(rb"""<\?xml[^>]*?\bencoding\s*=\s*["']([A-Za-z0-9._:-]+)["']""")
#: Prefixes of Python's names of text encodings.
_TEXT: Final = ("utf-8", "utf-16", "iso8859", "cp", "ascii", "gb", "big5", "shift_jis", "euc", "koi8", "mac-")
#: Pattern of attribute values in a xacro file that is not expanded.
_MACRO: Final = re.compile(r"\$[({]")
#: Root elements of other formats: kind of the file, and how to convert it to a URDF (`{file}`, `{urdf}`).
_SDF: Final = (
    "an SDF file",
    "convert it first: `rosrun pysdf sdf2urdf.py {file} {urdf}`, or name the URDF or xacro that it was made from",
)
_OTHERS: Final = {
    "mujoco": (
        "a MuJoCo model (MJCF)",
        'convert it first: `pip install mjcf-urdf-simple-converter`, then `python -c "from'
        " mjcf_urdf_simple_converter import convert; convert('{file}', '{urdf}')\"`",
    ),
    "sdf": _SDF,
    "gazebo": _SDF,
    "COLLADA": ("a COLLADA file, which holds a mesh", "name the URDF of the arm"),
    "launch": ("a ROS launch file", "name the URDF that it loads"),
}


def read_urdf(path: Path) -> str:
    """Return the text of a robot description, in the encoding declared in its first line, else UTF-8.

    Raises
    ------
    ConfigError
        The file cannot be read, is not a regular file, is too large, or is not in the declared encoding.
    """
    try:
        data = read_bounded(path, MOST_BYTES)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name the URDF of the arm") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}; name the URDF of the arm") from error
    where = str(path)
    marked = next((encoding for mark, encoding in _MARKS if data.startswith(mark)), None)
    declared = _DECLARED.search(data[:200])
    name = marked or (declared[1].decode("ascii") if declared else "utf-8")
    try:
        if not codecs.lookup(name).name.startswith(_TEXT):
            raise LookupError(name)
        return data.decode(name)
    except LookupError as error:
        raise ConfigError(f"{where}: encoding '{name}' is not known; save the file as UTF-8") from error
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{where}:{line}: byte 0x{data[error.start]:02X} is not {name}; save the file as UTF-8, or write its"
            ' encoding into the first line: <?xml version="1.0" encoding="ISO-8859-1"?>'
        ) from error


def parse_urdf(text: str, where: str) -> ET.Element:
    """Return the root element `<robot>` of a URDF.

    Raises
    ------
    ConfigError
        Not XML, document type or entities, nested too deep, or another format; the message names the file and a
        corrective action.
    """
    if len(text) > MOST_BYTES:
        raise ConfigError(
            f"{where}: {len(text)} characters are too many for a robot description (limit {MOST_BYTES}); name the"
            " URDF of the arm"
        )
    root = _elements(text, where)
    if root.tag in _OTHERS:
        what, advice = _OTHERS[root.tag]
        advice = advice.format(file=where, urdf=_beside(where, ".xml"))
        raise ConfigError(f"{where}: the outermost element is <{root.tag}>: this is {what}, not a URDF; {advice}")
    if root.tag != "robot":
        raise ConfigError(
            f"{where}: the outermost element is <{root.tag}>, a URDF starts with <robot>; name the URDF of the arm"
        )
    if _is_xacro(root):
        typed = f"xacro {shlex.quote(where)} > {shlex.quote(_beside(where, '.xacro'))}"
        raise ConfigError(
            f"{where}: this is a xacro file: expand it first: `{typed}` (`pip install xacro`, or the ROS package), and"
            " name the new file"
        )
    return root


def _beside(where: str, suffix: str) -> str:
    """Return a name for the URDF made from a file, different from the name of the file."""
    stem = where.removesuffix(suffix).removesuffix(".sdf").removesuffix(".urdf")
    return f"{stem}.urdf" if f"{stem}.urdf" != where else f"{stem}.expanded.urdf"


def _is_xacro(root: ET.Element) -> bool:
    """Return True if the file contains macros; an expanded file may still declare the namespace."""
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        return True
    described = (part for tag in ("link", "joint") for element in root.findall(tag) for part in element.iter())
    return any(_MACRO.search(value) for part in described for value in part.attrib.values())


def _elements(text: str, where: str) -> ET.Element:
    """Return the elements with their names as written, including the prefix."""
    builder, depth = ET.TreeBuilder(), 0

    def refuse(*_: object) -> None:
        raise ConfigError(f"{where}: a document type or entity declaration is not allowed in a URDF; remove it")

    def start(tag: str, attributes: Mapping[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ConfigError(f"{where}: elements are nested more than {MAX_DEPTH} deep; name the URDF of the arm")
        builder.start(tag, dict(attributes))

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    scanner = expat.ParserCreate()
    scanner.StartDoctypeDeclHandler = refuse
    scanner.EntityDeclHandler = refuse
    scanner.StartElementHandler = start
    scanner.EndElementHandler = end
    try:
        scanner.Parse(text, True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(
            f"{where}: not readable as XML: {error}; name the URDF of the arm, or export it again"
        ) from error
