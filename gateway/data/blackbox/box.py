"""Write and read the file of a black box: samples and frames as HDF5, and the frames as BLF for CAN tools."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from drives.files import replace_file
from drives.frame_log import add_packed, open_log
from gateway.data.blackbox.part import FIELDS, FRAME_TYPE, HEAD, BoxHeader, BoxPart, width_of
from gateway.data.recording.hdf5_text import open_recording
from gateway.data.recording.seal import refuse_damaged, sealed
from gateway.errors import InputError

SCHEMA: Final = 1
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ArmBox:
    """Last samples of one arm: arrays (n, N) by the names of `FIELDS`."""

    name: str
    values: dict[str, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class BlackBox:
    """Content of a black box.

    Attributes
    ----------
    path : Path
    recording, reason, created, software, cell : str
        Name of the recording; reason of the stop; creation time, program version, and text of the cell file.
    wall_s, time_s : arrays of shape (n,)
        Wall clock and time of the run of each SYNC.
    sync_index : int64 array of shape (n,)
    arms : tuple of ArmBox
    frames : array of shape (m,) of `FRAME_TYPE`
        Received frames, including those of the stop; time stamps of the wall clock.
    """

    path: Path
    recording: str
    reason: str
    created: str
    software: str
    cell: str
    wall_s: Floats
    time_s: Floats
    sync_index: NDArray[np.int64]
    arms: tuple[ArmBox, ...]
    frames: NDArray[Any]


def write_box(path: Path, header: BoxHeader, parts: Sequence[BoxPart], reason: str) -> None:
    """Write the black box, and its frames as BLF beside it; replace each file only when it is complete.

    Raises
    ------
    OSError
        It cannot be written.
    """
    width = width_of(sum(axes for _, axes in header.arms))
    rows = np.concatenate([np.empty((0, width)), *(part.rows for part in parts if part.rows.shape[1] == width)])
    frames = np.concatenate([np.empty(0, FRAME_TYPE), *(part.frames for part in parts)])
    with h5py.File(f"{path} in memory", "w", driver="core", backing_store=False) as file:
        file.attrs["schema"], file.attrs["kind"] = SCHEMA, "black box"
        file.attrs["recording"], file.attrs["reason"] = header.recording.name, reason.replace("\0", "")
        file.attrs["created"], file.attrs["software"], file.attrs["cell"] = header.created, header.software, header.cell
        file.attrs["arms"] = json.dumps(header.arms)
        for column, (name, unit) in enumerate(zip(HEAD, ("s, wall clock", "s", "SYNC number"), strict=True)):
            _dataset(file, name, rows[:, column].astype(np.int64) if name == "sync_index" else rows[:, column], unit)
        at = len(HEAD)
        for name, axes in header.arms:
            group = file.require_group(f"arms/{name}")
            for field, unit in FIELDS:
                _dataset(group, field, rows[:, at : at + axes], unit)
                at += axes
        held = file.require_group("frames")
        units = {"time_s": "s, wall clock", "flags": "1 received, 2 extended, 4 remote, 8 error", "length": "bytes"}
        for name in FRAME_TYPE.names or ():
            _dataset(held, name, frames[name], units.get(name, ""))
        file.flush()
        content = sealed(file.id.get_file_image())
    replace_file(path, content)
    with open_log(path.with_suffix(".blf")) as log:
        add_packed(log, frames.tobytes(), 0)


def _dataset(group: h5py.Group, name: str, values: np.ndarray, unit: str) -> None:
    group.create_dataset(name, data=values).attrs["unit"] = unit


def read_box(path: Path) -> BlackBox:
    """Read a black box.

    Raises
    ------
    InputError
        The file is missing, damaged, or not a black box.
    """
    try:
        refuse_damaged(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    with open_recording(path) as root:
        if root.text("kind", "recording") != "black box" or root.integer("schema") != SCHEMA:
            raise InputError(f"{path}: not a black box of schema {SCHEMA}")
        arms = [(str(name), int(axes)) for name, axes in root.document("arms", list, [])]
        held = root.inside("frames")
        frames = np.empty(len(held.array("time_s", None, "f")), FRAME_TYPE)
        for name in ("time_s", "can_id", "flags", "length"):
            frames[name] = held.array(name, None, "fu")
        frames["data"] = held.array("data", 8, "u")
        return BlackBox(
            path=path,
            **{name: root.text(name) for name in ("recording", "reason", "created", "software", "cell")},
            wall_s=root.array("wall_s", None, "f"),
            time_s=root.array("time_s", None, "f"),
            sync_index=root.array("sync_index", None, "i"),
            arms=tuple(
                ArmBox(name, {field: root.inside("arms").inside(name).array(field, axes, "f") for field, _ in FIELDS})
                for name, axes in arms
            ),
            frames=frames,
        )
