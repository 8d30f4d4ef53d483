"""Spool of black boxes of runs without recording: named by time, the newest ones kept."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Final

from gateway.data.blackbox.ring_buffer import BOX_SUFFIX, recording_of, recover_box

#: Boxes of one arm that stay: each holds half a minute, some megabytes.
MOST_BOXES: Final = 10


def place_in(folder: Path, kind: str, now: datetime) -> Path:
    """Return the path of the next black box; recover the parts of a killed program and delete the oldest boxes.

    Parameters
    ----------
    folder : Path
    kind : str
        Name prefix of the boxes: cell and arm.
    now : datetime
        Wall clock, with its zone.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    name = "".join(part if part.isalnum() or part in "-_" else "_" for part in kind)
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.glob(f".{name}.*Z.blackbox"):
        recover_box(recording_of(left))
    boxes = sorted(folder.glob(f"{name}.*Z{BOX_SUFFIX}"))
    for old in boxes[: max(0, len(boxes) - MOST_BOXES + 1)]:
        old.unlink(missing_ok=True)
        old.with_suffix(".blf").unlink(missing_ok=True)
    return folder / f"{name}.{now:%Y%m%dT%H%M%S}Z{BOX_SUFFIX}"
