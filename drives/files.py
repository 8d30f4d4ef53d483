"""Atomic replacement of files: after a crash a file holds its old content or its new content, complete.

Documents that the program reads again carry a checksum. It detects damage and accidental edits, not forgery.
`lock_file` keeps other processes from a file.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import stat
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

#: Key of the checksum in a document.
SEAL: Final = "sha256"


def checksum(document: Mapping[str, Any]) -> str:
    """Return SHA-256 (64 hexadecimal digits) of the sorted compact JSON (no blanks, ASCII) of all values but `SEAL`.

    Raises
    ------
    RecursionError
        Nested deeper than any file is.
    """
    body = {key: value for key, value in document.items() if key != SEAL}
    return hashlib.sha256(json.dumps(body, sort_keys=True, separators=(",", ":")).encode("ascii")).hexdigest()


def write_sealed(path: Path, document: Mapping[str, Any]) -> str:
    """Write a document as JSON with its checksum, and return the text; raises as `replace_file`."""
    text = json.dumps({**document, SEAL: checksum(document)}) + "\n"
    replace_file(path, text)
    return text


def read_sealed(path: Path) -> dict[str, Any]:
    """Return a document that `write_sealed` has written.

    Raises
    ------
    OSError
        It cannot be read.
    ValueError
        It was damaged or edited since.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get(SEAL) != checksum(document):
            raise ValueError(f"its {SEAL} is not that of its values: it was damaged or edited")
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error
    return document


def replace_file(path: Path, content: bytes | str) -> None:
    """Write a file so that a crash or a loss of power at any time leaves the old content or the new one, complete.

    Parameters
    ----------
    path : Path
        Its folder is made if need be. An existing file keeps its permissions.
    content : bytes or str
        Text is stored as UTF-8.

    Raises
    ------
    OSError
        It cannot be written (disk full, no permission), or the path is not a regular file; the old content is
        untouched.
    """
    data = content.encode() if isinstance(content, str) else content

    def write(descriptor: int) -> None:
        with os.fdopen(os.dup(descriptor), "wb") as stream:
            stream.write(data)

    place_file(temporary_file(path, write), path)


def temporary_file(path: Path, write: Callable[[int], None]) -> Path:
    """Write a new file with a random name into the folder of a path; `place_file` then moves it there.

    Parameters
    ----------
    path : Path
        File that it is to replace.
    write : callable
        Writes the content to an open file descriptor.

    Returns
    -------
    Path
        The new file, on disk (fsync).

    Raises
    ------
    OSError
        As `replace_file`.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = _mode_of(path)
        temporary, descriptor = _create(path.parent)
        try:
            if mode is not None:
                os.chmod(descriptor if os.chmod in os.supports_fd else temporary, mode)
            write(descriptor)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except BaseException as error:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(path)  # the name that was asked for; a full disk comes without any
        raise
    return temporary


def place_file(temporary: Path, path: Path) -> None:
    """Move a file of `temporary_file` to its path, and make that durable.

    Raises
    ------
    OSError
        It cannot be moved; the temporary file is removed.
    """
    try:
        os.replace(temporary, path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        error.filename = str(path)
        raise
    if os.name == "nt":  # there a folder cannot be opened, and the move is durable by itself
        return
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _mode_of(path: Path) -> int | None:
    """Permissions of the file that is replaced; None = there is none yet.

    Raises
    ------
    OSError
        It is a folder, a device, a pipe or a socket.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is a device, pipe or socket; only a regular file is replaced", str(path))
    return stat.S_IMODE(mode)


def _create(folder: Path) -> tuple[Path, int]:
    """Create a file with a random name, never an existing one and never through a link; path and descriptor."""
    while True:
        path = folder / f".{secrets.token_hex(8)}.tmp"
        with suppress(FileExistsError):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
            for name in ("O_NOFOLLOW", "O_CLOEXEC", "O_BINARY"):  # not every system has each
                flags |= getattr(os, name, 0)
            return path, os.open(path, flags, 0o666)


def lock_file(descriptor: int, *, wait: bool = False) -> None:
    """Lock a file for this process until its descriptor is closed.

    Parameters
    ----------
    descriptor : int
        Of the open file.
    wait : bool
        Wait for another holder; else it is refused at once.

    Raises
    ------
    BlockingIOError
        Another process holds it.
    OSError
        This system has no such locks: what writes a recording or drives needs Linux or macOS.
    """
    try:
        import fcntl  # Windows has none; reading data needs none
    except ImportError as error:
        what = "this system has no file locks: what moves an arm or writes a recording needs Linux"
        raise OSError(errno.ENOTSUP, what) from error
    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
