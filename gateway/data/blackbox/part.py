"""Part of a black box: the samples and CAN frames of about half a second, as one block of bytes.

The motion loop packs each value when it is taken, so that sending a part only copies bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

#: Rows, width of a row, and at the end of the part: time of the run [s], wall clock [s].
_HEAD: Final = struct.Struct("<IIdd")
_CHECKSUM: Final = struct.Struct("<I")
#: `FRAME` for numpy; its time is the wall clock [s].
FRAME_TYPE: Final = np.dtype(
    [("time_s", "<f8"), ("can_id", "<u4"), ("flags", "u1"), ("length", "u1"), ("data", "u1", 8)]
)
#: Columns before those of the axes.
HEAD: Final = ("wall_s", "time_s", "sync_index")
#: Per axis: name and unit; NaN where a drive did not answer or sends no such word.
FIELDS: Final = (
    ("q_rad", "rad"),
    ("target_rad", "rad, sent with this SYNC, due at the next"),
    ("joint_torque_nm", "Nm, joint side, gear efficiency not applied"),
    ("modelled_torque_nm", "Nm, joint side, from the robot model, without friction; 0: link masses unknown"),
    ("motor_current_a", "A, of the kind the torque constant refers to"),
    ("statusword", "bits of 0x6041"),
    ("position_count", "encoder counts"),
    ("torque_permille", "word of the profile's torque object, as received"),
)


def width_of(axes: int) -> int:
    """Return the number of values in a sample of arms with `axes` axes in total."""
    return len(HEAD) + len(FIELDS) * axes


@dataclass(frozen=True, slots=True)
class BoxHeader:
    """Constant data of a black box, known before any motion.

    Attributes
    ----------
    recording : Path
        The box is stored beside it.
    arms : tuple of (str, int)
        Name and number of axes, in the order of the samples.
    cell : str
        Text of the cell file.
    created, software : str
    """

    recording: Path
    arms: tuple[tuple[str, int], ...]
    cell: str
    created: str
    software: str


@dataclass(frozen=True, slots=True, eq=False)
class BoxPart:
    """Samples and frames of about half a second.

    Attributes
    ----------
    rows : array of shape (n, width)
        `HEAD`, then per arm each of `FIELDS` for its axes.
    frames : array of shape (m,) of `FRAME_TYPE`
    time_s, wall_s : float
        End of the part: run time, and wall clock.
    """

    rows: NDArray[np.float64]
    frames: NDArray[Any]
    time_s: float
    wall_s: float


def with_checksum(content: bytes) -> bytes:
    """Return a content with its checksum before it."""
    return _CHECKSUM.pack(zlib.crc32(content, 1)) + content


def checked(content: bytes) -> bytes | None:
    """Return the content without its checksum; None if it is truncated or changed."""
    rest = content[_CHECKSUM.size :]
    return rest if with_checksum(rest) == content else None


def pack(rows: NDArray[np.float64], frames: bytes | bytearray, time_s: float, wall_s: float) -> bytes:
    """Return the bytes of a part; `frames` are packed by `FRAME`."""
    return _HEAD.pack(len(rows), rows.shape[1], time_s, wall_s) + rows.tobytes() + frames


def unpack(content: bytes) -> BoxPart:
    """Decode the bytes of a part."""
    rows, width, time_s, wall_s = _HEAD.unpack_from(content)
    end = _HEAD.size + 8 * rows * width
    return BoxPart(
        np.frombuffer(content[_HEAD.size : end], dtype="<f8").reshape(rows, width),
        np.frombuffer(content[end:], dtype=FRAME_TYPE),
        time_s,
        wall_s,
    )
