"""Checksum of a recording, stored after the HDF5 data and checked before libhdf5 opens the file.

libhdf5 may crash or loop on damaged metadata, which no exception handler can catch. A file whose checksum differs is
rejected. A file without checksum (from another program) is first read in a separate process; so is a file whose
global heaps cannot be traversed. The checksum does not protect against forgery. HDF5 software ignores bytes after the
end of the data.
"""

from __future__ import annotations

import hashlib
import re
import struct
import subprocess
import sys
from pathlib import Path

from gateway.errors import InputError

SIGNATURE = b"\x89HDF\r\n\x1a\n"
#: Begin of a global heap collection, and size of its header and of those of its objects (format specification, III.E).
_HEAP, _HEADER_BYTES = re.compile(rb"GCOL\x01\0\0\0"), 16
MARK = b"\nservo-gateway recording sha256 "
SEAL_BYTES = len(MARK) + 64 + 1
PROBE_TIMEOUT_S = 60.0


def sealed(content: bytes) -> bytes:
    """Return an HDF5 file image with its checksum appended."""
    return content + MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


def refuse_damaged(path: Path) -> None:
    """Check that libhdf5 can open a file safely.

    Raises
    ------
    InputError
        Not HDF5, changed since it was written, or not readable in a separate process.
    FileNotFoundError, OSError
        The file cannot be read.
    """
    content = path.read_bytes()
    if not content.startswith(SIGNATURE):
        raise InputError(f"{path}: not an HDF5 file, or its beginning is damaged")
    body, seal = content[:-SEAL_BYTES], content[-SEAL_BYTES:]
    if seal.startswith(MARK):
        if sealed(body) != content:
            raise InputError(f"{path}: is damaged: its content does not match its checksum; use a backup copy")
        if _heaps_end(body):
            return
    elif MARK in content[-2 * SEAL_BYTES :] or _end_of_data(content) > len(content):
        raise InputError(f"{path}: is truncated; use a backup copy")
    _probe(path)


def _end_of_data(content: bytes) -> int:
    """Return the end-of-file address of the superblock (HDF5 format specification, II.A); 0 = unknown."""
    version = content[8] if len(content) > 8 else 0
    at = {0: 40, 1: 44, 2: 28, 3: 28}.get(version, 0)
    return int.from_bytes(content[at : at + 8], "little") if at and len(content) >= at + 8 else len(content) + 1


def _heaps_end(content: bytes) -> bool:
    """Return whether all global heaps can be traversed: libhdf5 does not return from free space of size 0."""
    left = len(content) // _HEADER_BYTES
    for found in _HEAP.finditer(content):
        at = found.start() + _HEADER_BYTES
        end = min(found.start() + int.from_bytes(content[at - 8 : at], "little"), len(content))
        while at + _HEADER_BYTES <= end:
            index, size = struct.unpack_from("<H6xQ", content, at)
            at += _HEADER_BYTES + (size + 7) // 8 * 8 if index else size
            left -= 1
            if left < 0:  # free space of size 0, or collections that overlap
                return False
    return True


def _probe(path: Path) -> None:
    """Read the file in a separate process, which may crash or hang."""
    command = [sys.executable, "-m", "gateway.data.recording.seal_probe", str(path.resolve())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{path}: is damaged: reading it does not end; use a backup copy") from error
    if done.returncode != 0:
        raise InputError(f"{path}: is damaged: libhdf5 fails on it (exit {done.returncode}); use a backup copy")
