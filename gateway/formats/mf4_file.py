"""ASAM MDF 4 for CANape and asammdf: one group per arm; cell, robot and profiles attached."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gateway.data.extras import needed
from gateway.formats.samples import ArmSamples, Samples
from gateway.result.origin import software


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
        for name, text in _texts(samples).items():
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


def _texts(samples: Samples) -> dict[str, str]:
    """Return the attached files, by name."""
    about = dict(samples.about)
    texts = {"cell.toml": about.pop("cell", ""), "robot.urdf": about.pop("robot", "")}
    profiles = json.loads(about.pop("profiles", "{}"))
    texts |= {f"{name}.profile.toml": str(text) for name, text in profiles.items()}
    reported = about | {f"arms/{arm.name}/{name}": text for arm in samples.arms for name, text in arm.about.items()}
    return texts | {"recording.json": json.dumps(reported, indent=1)}


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
