"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def replace_file(path: Path, content: bytes | str) -> None:
    """Write a file so that a crash or a loss of power at any time leaves the old one or the new one, whole.

    Parameters
    ----------
    path : Path
        Its folder is made if need be.
    content : bytes or str
        Text is stored as UTF-8.

    Raises
    ------
    OSError
        It cannot be written (disk full, no permission); the old one is untouched.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        error.filename = str(path)  # the name that was asked for; a full disk comes without any
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
