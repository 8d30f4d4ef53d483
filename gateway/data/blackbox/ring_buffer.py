"""Ring buffer of the last seconds on disk: one file per part, the oldest deleted; it survives a killed process."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from drives.file_lock import lock_file
from gateway.data.blackbox.part import BoxHeader, BoxPart, unpack

#: So much is kept [s], by the time of the run; and no more than this by the wall clock, where the run stands still.
KEPT_S: Final = 30.0
MOST_WALL_S: Final = 120.0
SUFFIX: Final = ".part"
BOX_SUFFIX: Final = ".blackbox.h5"
#: Whose parts these are; locked while a process writes them.
HEADER: Final = "header.json"


def folder_of(recording: Path) -> Path:
    """Return the folder of the parts while a recording is written."""
    return recording.with_name(f".{box_of(recording).name.removesuffix(BOX_SUFFIX)}.blackbox")


def recording_of(folder: Path) -> Path:
    """Return the recording path that belongs to a folder of parts; inverse of `folder_of`."""
    return folder.with_name(folder.name.removeprefix(".").removesuffix(".blackbox") + BOX_SUFFIX)


def box_of(recording: Path) -> Path:
    """Return the path of the black box of a recording; its frames have the same name with `.blf`."""
    return recording if recording.name.endswith(BOX_SUFFIX) else recording.with_suffix(BOX_SUFFIX)


class Ring:
    """Parts of one run on disk, the newest seconds only.

    Parameters
    ----------
    folder : Path
        Parts of an earlier run in it are deleted.
    header : BoxHeader
        Stored with the parts.

    Raises
    ------
    OSError
        It cannot be written.
    """

    def __init__(self, folder: Path, header: BoxHeader) -> None:
        self._folder = folder
        self._kept: deque[tuple[Path, float, float]] = deque()
        self._number = 0
        remove(folder)
        folder.mkdir(parents=True)
        self._header = os.open(folder / HEADER, os.O_WRONLY | os.O_CREAT, 0o666)
        lock_file(self._header, wait=True)
        os.write(self._header, _header_text(header).encode())

    def add(self, content: bytes, time_s: float, wall_s: float) -> None:
        """Write one part and delete the parts that are too old.

        Raises
        ------
        OSError
            It cannot be written.
        """
        self._number += 1
        path = self._folder / f"{self._number:08d}{SUFFIX}"
        path.write_bytes(content)
        self._kept.append((path, time_s, wall_s))
        while time_s - self._kept[0][1] > KEPT_S or wall_s - self._kept[0][2] > MOST_WALL_S:
            self._kept.popleft()[0].unlink(missing_ok=True)

    def close(self) -> None:
        """Stop storing parts; the stored ones remain."""
        os.close(self._header)


def _header_text(header: BoxHeader) -> str:
    return json.dumps(
        {
            "recording": header.recording.name,
            "arms": header.arms,
            "cell": header.cell,
            "created": header.created,
            "software": header.software,
        }
    )


def header_in(folder: Path) -> BoxHeader | None:
    """Return the header stored with the parts of a folder; None if it is missing or truncated."""
    try:
        held = json.loads((folder / HEADER).read_bytes())
        arms = tuple((str(name), int(axes)) for name, axes in held["arms"])
        said = [str(held[name]) for name in ("cell", "created", "software")]
        return BoxHeader(folder.with_name(str(held["recording"])), arms, *said)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def parts_in(folder: Path) -> list[BoxPart]:
    """Return the parts of a folder in time order, without truncated ones."""
    found = [unpack(path.read_bytes()) for path in _files(folder)]
    return [part for part in found if part is not None]


def remove(folder: Path) -> None:
    """Delete the parts and their folder."""
    for path in (*_files(folder), folder / HEADER):
        path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _files(folder: Path) -> Iterable[Path]:
    return sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else ()
