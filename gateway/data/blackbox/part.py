"""Part of a black box: the samples and CAN frames of about half a second, as one block of bytes.

The motion loop packs each value when it is taken, so that sending a part only copies bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MAGIC: Final = b"SGBB"
#: Rows, width of a row, frames, and at its end: time of the run [s], wall clock [s].
_HEAD: Final = struct.Struct("<4sIIIdd")
#: Wall clock [s], CAN id, flags, length, content.
FRAME: Final = struct.Struct("<dIBB8s")
FRAME_TYPE: Final = np.dtype(
    [("time_s", "<f8"), ("can_id", "<u4"), ("flags", "u1"), ("length", "u1"), ("data", "u1", 8)]
)
RECEIVED, EXTENDED, REMOTE, ERROR = 1, 2, 4, 8
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


def pack(rows: NDArray[np.float64], frames: bytes | bytearray, time_s: float, wall_s: float) -> bytes:
    """Return the bytes of a part; `frames` are packed by `FRAME`."""
    head = _HEAD.pack(MAGIC, len(rows), rows.shape[1], len(frames) // FRAME.size, time_s, wall_s)
    return head + rows.tobytes() + frames


def unpack(content: bytes) -> BoxPart | None:
    """Decode the bytes of a part; return None if they are truncated."""
    if len(content) < _HEAD.size or content[:4] != MAGIC:
        return None
    _, rows, width, frames, time_s, wall_s = _HEAD.unpack_from(content)
    end = _HEAD.size + 8 * rows * width
    if len(content) != end + FRAME.size * frames:
        return None
    return BoxPart(
        np.frombuffer(content[_HEAD.size : end], dtype="<f8").reshape(rows, width),
        np.frombuffer(content[end:], dtype=FRAME_TYPE),
        time_s,
        wall_s,
    )
