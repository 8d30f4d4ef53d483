"""Origin of a result: program, time, drives and files; and its checksum, so that an edited number is not exported.

`sha256` is that of the sorted compact JSON (keys in order, no blanks, ASCII) of all other values in the file. `truth`
is excluded, since a simulator adds it afterwards. The checksum detects accidental edits, not forgery.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from drives import files
from drives.printable import one_line
from gateway import __version__
from gateway.errors import InputError
from gateway.result.names import REHEARSAL, SILENT
from gateway.result.values import check_kind, json_object, text_of

PROGRAM = "servo-gateway"
KEY: Final = files.SEAL
#: Keys that the checksum leaves out.
UNSEALED: Final = (KEY, "truth")
#: What writes a result again.
FROM_DATA: Final = "from the data (servo-gateway estimate DATA --json OUT.json)"


@dataclass(frozen=True, slots=True)
class DriveOrigin:
    """Identity reported by a drive; None where it lacks the object."""

    joint: int
    node_id: int
    name: str | None = field(default=None, metadata=SILENT)
    vendor_id: int | None = field(default=None, metadata=SILENT)
    product_code: int | None = field(default=None, metadata=SILENT)
    serial_number: int | None = field(default=None, metadata=SILENT)
    hardware_version: str | None = field(default=None, metadata=SILENT)
    software_version: str | None = field(default=None, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class FileOrigin:
    """Input file and the checksum of its content."""

    file: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Origin:
    """Time, program, drives and files of a result, and the operator if named."""

    created: str
    software: str
    drives: tuple[DriveOrigin, ...] = field(default=(), metadata=SILENT)
    files: tuple[FileOrigin, ...] = field(default=(), metadata=SILENT)
    operator: str | None = field(default=None, metadata=SILENT)


def software() -> str:
    """Return the name and version of this program."""
    return f"{PROGRAM} {__version__}"


def in_words(moment: datetime) -> str:
    """Return the text of a time (UTC), as on the pages."""
    return moment.strftime("%Y-%m-%d %H:%M UTC")


def file_sha256(path: Path) -> str:
    """Return the SHA-256 checksum of a file.

    Raises
    ------
    InputError
        It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


def files_of(paths: Iterable[Path]) -> tuple[FileOrigin, ...]:
    """Return files with their checksums.

    Raises
    ------
    InputError
        One of them cannot be read.
    """
    return tuple(FileOrigin(str(path), file_sha256(path)) for path in paths)


def drives_of(identities: Sequence[Mapping[str, Any]]) -> tuple[DriveOrigin, ...]:
    """Return the drives of a recording, one per axis; a value of an unexpected type is omitted."""
    found: list[DriveOrigin] = []
    for joint, said in enumerate(identities, start=1):
        found.append(
            DriveOrigin(
                joint=joint,
                node_id=_complete(said.get("node_id")) or 0,
                name=_text(said.get("name")),
                vendor_id=_complete(said.get("vendor_id")),
                product_code=_complete(said.get("product_code")),
                serial_number=_complete(said.get("serial_number")),
                hardware_version=_text(said.get("hardware_version")),
                software_version=_text(said.get("software_version")),
            )
        )
    return tuple(found)


def _complete(value: Any) -> int | None:
    return value if isinstance(value, int) else None


def _text(value: Any) -> str | None:
    return one_line(value) or None if isinstance(value, str) else None


def checksum(plain: Mapping[str, Any]) -> str:
    """Return the checksum (64 hexadecimal digits) of plain values, without the keys in `UNSEALED`.

    Raises
    ------
    RecursionError
        Nested deeper than any file is.
    """
    return files.checksum({key: value for key, value in plain.items() if key not in UNSEALED})


def sealed(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values with their checksum as last key."""
    return {key: value for key, value in plain.items() if key != KEY} | {KEY: checksum(plain)}


def read_sealed(path: Path, schema: int, again: str, *kinds: str) -> dict[str, Any]:
    """Return the plain values of a file that the program wrote; `again` as in `refuse_edited`.

    Raises
    ------
    InputError
        It cannot be read, has another schema, is of none of these kinds, has no checksum, or was edited.
    """
    plain = json_object(text_of(path, f"write it {again}"), str(path))
    check_kind(plain, schema, str(path), *kinds)
    refuse_edited(plain, str(path), again)
    return plain


def read_rehearsal(path: Path) -> dict[str, Any]:
    """Return the answer of a rehearsal from its file; errors as of `read_sealed`."""
    return read_sealed(path, 1, "with servo-gateway rehearse CELL -o REHEARSAL.json", REHEARSAL)


def refuse_edited(plain: Mapping[str, Any], where: str, again: str = FROM_DATA) -> None:
    """Raise an error if a file was edited since it was written, or has no checksum.

    `again` is the source, or the command, that writes the file again.

    Raises
    ------
    InputError
        The checksum is absent, or differs from that of the values.
    """
    if plain.get(KEY) != checksum(plain):
        edited = f"was edited: its {KEY} differs from that of its values. Use the original, or"
        state = edited if KEY in plain else f"has no {KEY}, so its content is not verified;"
        raise InputError(f"{where}: {state} write it again {again}")
