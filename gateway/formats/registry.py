"""Writers of the open formats, by name: MCAP, Parquet, MDF 4, the frames as BLF, and a copy to pass on.

Parquet has one row per sample and one column per quantity and axis; units are field metadata, cell and profiles file
metadata. MDF 4 has one group per arm; cell, robot and profiles are attached. The copy to pass on has every sample and
setting, without serial numbers of drives and folder names.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, Final

import h5py
import numpy as np

from drives.frame_log import SUFFIXES, read_frames, write_blf
from gateway.data.extras import needed
from gateway.data.recording.reader import read
from gateway.data.recording.seal import sealed
from gateway.errors import InputError
from gateway.formats.mcap_file import to_mcap
from gateway.formats.samples import ArmSamples, Samples, read_samples
from gateway.result.origin import software


def exported(path: Path, fmt: str, arm_name: str | None, label: str | None) -> tuple[bytes, int]:
    """Return the content of a file in an open format, and the number of its samples or frames.

    Parameters
    ----------
    path : Path
        Of the recording.
    fmt : str
        A key of `FORMATS` or `COMPLETE`.
    arm_name, label : str or None
        Only this arm; only this load.

    Raises
    ------
    InputError
        The recording cannot be used, or holds no such part.
    ConfigError
        The library of the format is not installed.
    """
    if fmt in COMPLETE:
        if arm_name or label:
            raise InputError(f"{path}: --format {fmt} is of the complete run: omit --arm and --load")
        return COMPLETE[fmt](path)
    samples = read_samples(path, arm_name, label)
    return FORMATS[fmt](samples), len(samples)


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


def blf_of(recording: Path) -> tuple[bytes, int]:
    """Content of a BLF file with the frames of a recording's trace, and how many they are.

    A recording holds words, not frames: the frames are those that `--trace` logged under the recording's name.

    Raises
    ------
    InputError
        The recording or its trace cannot be used, or there is none.
    """
    read(recording)
    traces = [path for suffix in SUFFIXES if (path := recording.with_suffix(suffix)).is_file()]
    if not traces:
        raise InputError(
            f"{recording}: no frame trace is beside it ({', '.join(recording.stem + suffix for suffix in SUFFIXES)});"
            f" a recording holds no frames: record with --trace {recording.with_suffix(SUFFIXES[0])}"
        )
    try:
        frames = read_frames(traces[0])
    except ValueError as error:
        raise InputError(f"{traces[0]}: cannot be read as a frame trace: {error}") from error
    except OSError as error:
        raise InputError(f"{traces[0]}: cannot be read: {error.strerror or error}") from error
    if not frames:
        raise InputError(f"{traces[0]}: holds no frame; record again with --trace {traces[0]}")
    with TemporaryDirectory(prefix="servo-gateway-") as folder:
        path = Path(folder) / "frames.blf"
        write_blf(path, frames)
        return path.read_bytes(), len(frames)


def to_mf4(samples: Samples) -> bytes:
    """Return the content of an MF4 file.

    The time of every group is that of the recording, which starts at zero when the bus is opened. A missing value has
    its invalidation bit set; a recorded NaN is a valid NaN.

    Raises
    ------
    ConfigError
        asammdf is not installed.
    """
    asammdf: Any = needed("asammdf", "MF4", "formats")
    with TemporaryDirectory(prefix="servo-gateway-") as folder, asammdf.MDF(version="4.10") as file:
        file.header.start_time = _begun(samples.about.get("created", ""))
        file.header.comment = f"{samples.about.get('exit_status', '')}: {samples.about.get('reason', '')}"
        about = dict(samples.about)
        texts = {"cell.toml": about.pop("cell", ""), "robot.urdf": about.pop("robot", "")}
        profiles = json.loads(about.pop("profiles", "{}"))
        texts |= {f"{name}.profile.toml": str(text) for name, text in profiles.items()}
        reported = about | {f"arms/{arm.name}/{name}": text for arm in samples.arms for name, text in arm.about.items()}
        for name, text in (texts | {"recording.json": json.dumps(reported, indent=1)}).items():
            file.attach(text.encode(), file_name=name, mime="text/plain", comment=f"{software()}: {name}")
        for arm in samples.arms:
            file.append(
                list(_signals(asammdf, arm)), acq_name=arm.name, comment=f"arm {arm.name}", common_timebase=True
            )
        path = Path(folder) / "recording.mf4"
        file.save(path, compression=2)
        return path.read_bytes()


def _begun(created: str) -> datetime:
    try:
        return datetime.fromisoformat(created)
    except ValueError:
        return datetime.fromtimestamp(0, UTC)


def _signals(asammdf: Any, arm: ArmSamples) -> Iterator[Any]:
    times_s = arm.measurands["time_s"].values
    for measurand in arm.measurands.values():
        for name, values, present in measurand.columns():
            text = values.dtype.kind == "O"
            yield asammdf.Signal(
                samples=_stored(values),
                timestamps=times_s,
                name=name,
                unit=measurand.unit,
                comment=measurand.remark,
                encoding="utf-8" if text else None,
                invalidation_bits=None if present.all() else ~present,
            )


def _stored(values: np.ndarray) -> np.ndarray:
    """Return text as UTF-8 bytes, booleans as 0 and 1."""
    if values.dtype.kind == "O":
        return np.array([str(text).encode() for text in values.tolist()], dtype=np.bytes_)
    return values.astype(np.uint8) if values.dtype.kind == "b" else values


def to_parquet(samples: Samples) -> bytes:
    """Return the content of a Parquet file.

    Missing values are null; a recorded NaN is NaN. The rows of all arms follow one another, with the column `arm`.
    The columns of axes that an arm lacks are null.

    Raises
    ------
    ConfigError
        pyarrow is not installed.
    """
    pa: Any = needed("pyarrow", "Parquet", "formats")
    parquet: Any = needed("pyarrow.parquet", "Parquet", "formats")
    tables = [_table(pa, arm) for arm in samples.arms]
    complete = (
        pa.concat_tables(tables, promote_options="default") if tables else pa.table({"arm": pa.array([], pa.string())})
    )
    about = dict(samples.about)
    for arm in samples.arms:
        about |= {f"arms/{arm.name}/{name}": text for name, text in arm.about.items()}
    sink = io.BytesIO()
    parquet.write_table(complete.replace_schema_metadata(about), sink, compression="zstd")
    return sink.getvalue()


def _table(pa: Any, arm: ArmSamples) -> Any:
    fields, columns = [pa.field("arm", pa.string())], [pa.array([arm.name] * len(arm), pa.string())]
    for measurand in arm.measurands.values():
        reported = {"unit": measurand.unit, "remark": measurand.remark}
        about = {name: text for name, text in reported.items() if text}
        for name, values, present in measurand.columns():
            kind = pa.string() if values.dtype.kind == "O" else pa.from_numpy_dtype(values.dtype)
            column = pa.array(values, kind, mask=None if present.all() else ~present, from_pandas=False)
            fields.append(pa.field(name, column.type, metadata=about))
            columns.append(column)
    return pa.table(columns, schema=pa.schema(fields))


#: format -> content of its file, from every sample.
FORMATS: Final[Mapping[str, Callable[[Samples], bytes]]] = {"mcap": to_mcap, "parquet": to_parquet, "mf4": to_mf4}
#: The format that holds frames.
FRAMES: Final = "blf"
#: Formats of a complete run, from the recording's file: content, and number of what it holds.
COMPLETE: Final[Mapping[str, Callable[[Path], tuple[bytes, int]]]] = {FRAMES: blf_of, "h5": copy_to_pass_on}
