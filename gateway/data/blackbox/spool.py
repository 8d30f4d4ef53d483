"""Black boxes of what is not recorded: named by the time, the newest ones kept."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Final

from gateway.data.blackbox.recovery import salvage
from gateway.data.blackbox.ring_buffer import BOX_SUFFIX, recording_of

#: Boxes of one arm that stay: each holds half a minute, some megabytes.
MOST_BOXES: Final = 10


def place_in(folder: Path, kind: str, now: datetime) -> Path:
    """Where the next box lies; what a killed program has left there becomes a box, and the oldest ones go.

    Parameters
    ----------
    folder : Path
    kind : str
        Whose boxes these are: cell and arm.
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
        salvage(recording_of(left))
    boxes = sorted(folder.glob(f"{name}.*Z{BOX_SUFFIX}"))
    for old in boxes[: max(0, len(boxes) - MOST_BOXES + 1)]:
        old.unlink(missing_ok=True)
        old.with_suffix(".blf").unlink(missing_ok=True)
    return folder / f"{name}.{now:%Y%m%dT%H%M%S}Z{BOX_SUFFIX}"
