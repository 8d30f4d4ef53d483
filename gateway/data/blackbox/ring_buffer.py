"""Ring buffer of the last seconds on disk: one file per part, the oldest deleted; it survives a killed process.

If the run fails, or the program ends without a final message, the parts become the black box; after a normal end they
are deleted. What is left after the process that stores them was killed too is recovered by the next run.

Black boxes of runs without recording are named by time, and the newest ones are kept (`place_in`).
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Generator, Iterable
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Final

from drives.files import lock_file
from gateway.data.blackbox.part import BoxHeader, BoxPart, checked, unpack, with_checksum

#: So much is kept [s], by the time of the run; and no more than this by the wall clock, where the run stands still.
KEPT_S: Final = 30.0
MOST_WALL_S: Final = 120.0
SUFFIX: Final = ".part"
BOX_SUFFIX: Final = ".blackbox.h5"
#: Whose parts these are; locked while a process writes them.
HEADER: Final = "header"
#: Reasons of a black box whose run gave none.
KILLED: Final = "the program that moved the arm was killed or ended without a final message: data until then"
BOTH_KILLED: Final = "the program that moved the arm and its recorder process were killed: data until then"
#: Boxes of one arm that stay: each holds half a minute, some megabytes.
MOST_BOXES: Final = 10


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
    header : BoxHeader
        Stored with the parts.
    again : bool
        Keep the parts that are on disk: the process that wrote them has ended. Otherwise parts of an earlier run are
        deleted.

    Raises
    ------
    OSError
        It cannot be written.
    """

    def __init__(self, header: BoxHeader, again: bool = False) -> None:
        self._header, self._again = header, again
        self._folder = folder_of(header.recording)
        self._kept: deque[tuple[Path, float, float]] = deque()
        self.finished = False
        if not again:
            remove(self._folder)
        self._folder.mkdir(parents=True, exist_ok=again)
        for path in _files(self._folder):
            if (content := checked(path.read_bytes())) is not None:
                self._keep(path, content)
        self._locked = os.open(self._folder / HEADER, os.O_WRONLY | os.O_CREAT, 0o666)
        lock_file(self._locked, wait=True)
        text = json.dumps(asdict(header) | {"recording": header.recording.name})
        os.write(self._locked, with_checksum(text.encode()))

    def add(self, number: int, content: bytes) -> None:
        """Write a part and delete the parts that are too old.

        Raises
        ------
        OSError
            It cannot be written.
        """
        path = self._folder / f"{number:08d}{SUFFIX}"
        path.write_bytes(with_checksum(content))
        self._keep(path, content)

    def _keep(self, path: Path, content: bytes) -> None:
        part = unpack(content)
        self._kept.append((path, part.time_s, part.wall_s))
        while part.time_s - self._kept[0][1] > KEPT_S or part.wall_s - self._kept[0][2] > MOST_WALL_S:
            self._kept.popleft()[0].unlink(missing_ok=True)

    def finish(self, reason: str | None) -> None:
        """Write the black box and delete the parts; only delete them if there is no reason of a stop (None).

        Raises
        ------
        OSError
            The black box cannot be written; the parts stay.
        """
        self.finished = True
        _finish(self._folder, self._header, reason, even_empty=not self._again)

    def close(self) -> None:
        """Stop storing parts; the stored ones remain."""
        os.close(self._locked)


@contextmanager
def open_ring(box: Path, header: BoxHeader, again: bool) -> Generator[Ring]:
    """Store the parts of a run in the process that writes (a kind of `Disk.open`).

    Without a final message, i.e. `Ring.finish`, they become the black box.

    Raises
    ------
    OSError
        They cannot be stored, or the black box of a killed run cannot be written.
    """
    if not again:
        recover_box(box)
    with closing(Ring(header, again)) as ring:
        yield ring
        if not ring.finished:
            _finish(folder_of(box), header, KILLED)


def recover_box(recording: Path) -> Path:
    """Write the black box from parts whose process has ended, if there are any, and delete them; return its path.

    Raises
    ------
    OSError
        It cannot be written; the parts stay.
    """
    folder = folder_of(recording)
    try:
        descriptor = os.open(folder / HEADER, os.O_RDWR)
    except FileNotFoundError:
        return box_of(recording)
    try:
        lock_file(descriptor)
        header = header_in(folder)
        if header is None:
            remove(folder)
        else:
            _finish(folder, header, BOTH_KILLED)
    except BlockingIOError:
        pass  # the run goes on, or its box is being written
    finally:
        os.close(descriptor)
    return box_of(recording)


def _finish(folder: Path, header: BoxHeader, reason: str | None, even_empty: bool = False) -> None:
    """Write the black box for a reason, if there are parts or `even_empty`; then delete the parts."""
    parts = parts_in(folder)
    if reason is not None and (parts or even_empty):
        from gateway.data.blackbox.box import write_box  # HDF5 takes its time to load, and is seldom needed

        write_box(recording_of(folder), header, parts, reason)
    remove(folder)


def header_in(folder: Path) -> BoxHeader | None:
    """Return the header stored with the parts of a folder; None if its checksum fails."""
    content = checked((folder / HEADER).read_bytes())
    if content is None:
        return None
    stored = json.loads(content)
    stored["arms"] = tuple((name, axes) for name, axes in stored["arms"])
    return BoxHeader(**stored | {"recording": folder.with_name(stored["recording"])})


def parts_in(folder: Path) -> list[BoxPart]:
    """Return the parts of a folder in time order, without those whose checksum fails."""
    contents = [checked(path.read_bytes()) for path in _files(folder)]
    return [unpack(content) for content in contents if content is not None]


def remove(folder: Path) -> None:
    """Delete the parts and their folder."""
    for path in (*_files(folder), folder / HEADER):
        path.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _files(folder: Path) -> Iterable[Path]:
    return sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else ()


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
