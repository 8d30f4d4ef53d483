"""Zip archive of one measurement: its files, each with a SHA-256 checksum in `manifest.json`.

Reading rejects the whole archive if a file is missing, not listed in the manifest, or has another checksum; the error
names every such file. File names are checked before anything is written.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from gateway.errors import InputError

MANIFEST: Final = "manifest.json"
SCHEMA: Final = 1
#: Largest content that is read, of one file and of all [bytes]: a recording of one hour has less.
MOST_BYTES: Final = 4 << 30
#: A relative path of plain names: no root, no drive letter, no backslash; `..` is refused part by part.
_NAME: Final = re.compile(r"[^/\\:\0]+(/[^/\\:\0]+)*")
#: Every archive of the same files has the same bytes.
_TIME: Final = (1980, 1, 1, 0, 0, 0)
#: Damaged data, an unknown method and a password, as `zipfile` reports them.
_DAMAGED: Final = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError, ValueError)


@dataclass(frozen=True, slots=True)
class Archive:
    """Files of an archive by name, without the manifest, and the other entries of the manifest."""

    files: Mapping[str, bytes]
    stated: Mapping[str, Any]


def archive_bytes(archive: Archive) -> bytes:
    """Return the content of the zip file of an archive."""
    listed = {name: hashlib.sha256(content).hexdigest() for name, content in archive.files.items()}
    manifest = json.dumps({"schema": SCHEMA, **archive.stated, "files": listed}, indent=1, allow_nan=False) + "\n"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as written:
        for name, content in {MANIFEST: manifest.encode(), **archive.files}.items():
            written.writestr(zipfile.ZipInfo(name, _TIME), content, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def read_archive(path: Path) -> Archive:
    """Read an archive that is complete and unchanged.

    Raises
    ------
    InputError
        It cannot be read, is not an archive, has an unsafe name, or files are missing, edited or not listed: each
        is named.
    """
    try:
        with zipfile.ZipFile(path) as opened:
            return _read(opened, path)
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as a zip file: {error}; name one that --archive wrote") from error


def _read(opened: zipfile.ZipFile, path: Path) -> Archive:
    members = opened.infolist()
    names = [member.filename for member in members]
    for name in names:
        if not is_safe(name):
            raise InputError(f"{path}: {name!r} is not a plain relative file name: nothing is extracted")
        if names.count(name) > 1:
            raise InputError(f"{path}: {name!r} is in it twice: nothing is extracted")
    if sum(member.file_size for member in members) > MOST_BYTES:
        raise InputError(f"{path}: holds more than {MOST_BYTES >> 30} GiB: nothing is extracted")
    stated = _manifest(opened, path, names)
    listed = stated.pop("files")
    files, wrong = dict[str, bytes](), [f"{name} is not listed" for name in names if name not in (MANIFEST, *listed)]
    for name, checksum in listed.items():
        content = _content(opened, name) if name in names else None
        if name not in names:
            wrong.append(f"{name} is missing")
        elif content is None:
            wrong.append(f"{name} is damaged")
        elif hashlib.sha256(content).hexdigest() != checksum:
            wrong.append(f"{name} was edited")
        else:
            files[name] = content
    if wrong:
        intact = f"{len(files)} of {len(listed)} files are intact" if files else "no file is intact"
        raise InputError(f"{path}: {'; '.join(wrong)}; {intact}. Use a copy that was not changed")
    return Archive(files, stated)


def is_safe(name: str) -> bool:
    """Return whether a file name stays inside the folder that it is written to, on every operating system."""
    return bool(_NAME.fullmatch(name)) and not {"..", "."} & set(name.split("/"))


def _content(opened: zipfile.ZipFile, name: str) -> bytes | None:
    """Return the content of a file; None if it is damaged."""
    try:
        return opened.read(name)
    except _DAMAGED:
        return None


def _manifest(opened: zipfile.ZipFile, path: Path, names: list[str]) -> dict[str, Any]:
    content = _content(opened, MANIFEST) if MANIFEST in names else None
    try:
        stated = None if content is None else json.loads(content)
    except (ValueError, RecursionError):
        stated = None
    listed = stated.get("files") if isinstance(stated, dict) else None
    if not isinstance(stated, dict) or not isinstance(listed, dict) or stated.get("schema") != SCHEMA:
        raise InputError(f"{path}: {MANIFEST} is missing, damaged or of another version: not a stored measurement")
    if not all(isinstance(checksum, str) and is_safe(name) for name, checksum in listed.items()):
        raise InputError(f"{path}: {MANIFEST} lists a name or a checksum that is none")
    return stated
