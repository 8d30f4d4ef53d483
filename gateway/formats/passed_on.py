"""Copy of a recording to pass on: every sample and setting, without serial numbers of drives and folder names."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path, PurePath
from typing import Final

import h5py

from gateway.data.recording.reader import read
from gateway.data.recording.seal import sealed

#: Serial numbers in the texts that `cell new` and `calibrate` write.
_SERIAL: Final = re.compile(r", serial 0x[0-9A-F]+|^serial_number = \d+\n", re.MULTILINE)
#: Folder of a file that the cell names: of those keys, and of every absolute path.
_FOLDER: Final = re.compile(
    r"""(\b(?:robot|profile|file|identified)\s*=\s*["'])[^"'\n]*[/\\]|(["'])(?:/|~|[A-Za-z]:)[^"'\n]*[/\\]"""
)


def copy_to_pass_on(path: Path) -> tuple[bytes, int]:
    """Return the content of the copy, and the number of its samples.

    Drives have no serial number in it, and files that the cell names have no folder. What a user wrote remains: name of
    the cell, sources, comments, labels, robot and profiles.

    Raises
    ------
    InputError
        The recording cannot be used.
    """
    recording = read(path)
    image = io.BytesIO()
    # edited in memory and copied once more: HDF5 keeps the bytes of a replaced attribute in the edited file
    with (
        h5py.File(path, "r") as source,
        h5py.File(f"{path} edited", "w", driver="core", backing_store=False) as edited,
        h5py.File(image, "w") as copy,
    ):
        cell_text, profiles = recording.cell_text, dict[str, str]()
        for number, (name, text) in enumerate(recording.profiles.items(), start=1):
            short = PurePath(name).name
            short = f"{number}-{short}" if short in profiles else short
            cell_text = re.sub(rf"""(?<=["']){re.escape(name)}(?=["'])""", short, cell_text)
            profiles[short] = text
        texts = {"cell": _FOLDER.sub(r"\1\2", cell_text), "calibration": recording.calibration}
        copy.attrs.update(
            dict(source.attrs)
            | {name: _SERIAL.sub("", text) for name, text in texts.items()}
            | {"profiles": json.dumps(profiles)}
        )
        for arm in recording.arms:
            source.copy(f"arms/{arm.name}", edited, arm.name)
            for name, entries in (("identities", arm.identities), ("ledger", arm.ledger)):
                edited[arm.name].attrs[name] = json.dumps([entry | {"serial_number": None} for entry in entries])
            edited.copy(arm.name, copy.require_group("arms"))
    parts = [part for arm in recording.arms for part in (*arm.visits, *arm.periods)]
    return sealed(image.getvalue()), sum(len(part.time_s) for part in parts)
