"""CAN frame logs in the formats of python-can: pack frames for a log, write them, read a log, write a BLF file."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import can

#: How a frame log is read, by the suffix that picks its format; the first is preferred.
_READERS: Final[dict[str, tuple[Any, str]]] = {
    ".blf": (can.BLFReader, "rb"),
    ".log": (can.CanutilsLogReader, "r"),
    ".asc": (can.ASCReader, "r"),
}
SUFFIXES: Final = tuple(_READERS)
#: A packed frame: time [s], CAN id, flags, data length code, content.
FRAME: Final = struct.Struct("<dIBB8s")
RECEIVED, EXTENDED, REMOTE, ERROR = 1, 2, 4, 8


def packed_frame(frame: Any, received: bool, time_s: float) -> bytes:
    """Return a CAN frame as `FRAME`; a reused one may change afterwards."""
    flags = RECEIVED * received + EXTENDED * frame.is_extended_id
    flags += REMOTE * frame.is_remote_frame + ERROR * frame.is_error_frame
    return FRAME.pack(time_s, frame.arbitration_id, flags, min(frame.dlc, 8), frame.data[:8])


def open_log(path: Path) -> Any:
    """Open a frame log for writing; its suffix picks the format (.blf, .log, .asc ..).

    Returns
    -------
    context manager of the log, for `add_packed`

    Raises
    ------
    OSError, ValueError
        The file cannot be written, or its suffix is unknown.
    """
    return can.Logger(path)


def add_packed(log: Any, frames: bytes, channel: str | int | None) -> None:
    """Append packed frames to an open log.

    Parameters
    ----------
    log : as returned by `open_log`
    frames : bytes
        Any number of `FRAME`.
    channel : str or int or None
        Where they were received; unknown for sent ones.

    Raises
    ------
    OSError
        It cannot be written.
    """
    for time_s, can_id, flags, length, data in FRAME.iter_unpack(frames):
        message = can.Message(
            timestamp=time_s,
            arbitration_id=can_id,
            data=b"" if flags & REMOTE else data[:length],
            is_rx=bool(flags & RECEIVED),
            is_error_frame=bool(flags & ERROR),
            is_remote_frame=bool(flags & REMOTE),
            is_extended_id=bool(flags & EXTENDED),
            dlc=length,
            channel=channel if flags & RECEIVED else None,
        )
        log.on_message_received(message)


def read_frames(path: Path) -> list[can.Message]:
    """Every frame of a log, in its order.

    Parameters
    ----------
    path : Path
        Its suffix is one of `SUFFIXES`.

    Raises
    ------
    ValueError
        It is not a frame log, or damaged.
    OSError
        It cannot be read.
    """
    reader, mode = _READERS[path.suffix.lower()]
    try:
        with path.open(mode) as stream:
            return list(reader(stream))
    except OSError:
        raise
    except Exception as error:  # python-can's readers report damage by many kinds of exception
        raise ValueError(" ".join(str(error).split())[:200] or type(error).__name__) from error


def write_blf(path: Path, frames: Iterable[can.Message]) -> None:
    """Write frames as BLF, with the times that they have.

    Raises
    ------
    OSError
        It cannot be written.
    """
    with can.BLFWriter(path) as log:
        for frame in frames:
            log.on_message_received(frame)
