"""All samples of a recording, as stored: the source of every open format.

Datasets are copied by name with their units and not recomputed; unknown datasets are exported too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gateway.data.recording.hdf5_text import Hdf5Group, open_recording
from gateway.data.recording.reader import read
from gateway.errors import InputError

#: Groups of an arm that hold samples, and what one of them is called.
GROUPS: Final = {"visits": "visit", "periods": "period"}
#: Units of attributes, by the last word of their name.
_UNITS: Final = {"rad": "rad", "nm": "Nm", "s": "s"}


@dataclass(frozen=True, slots=True, eq=False)
class Measurand:
    """One quantity over all samples of an arm.

    Attributes
    ----------
    name : str
        As in the recording.
    unit, remark : str
        The recording's unit text, before and after its first comma.
    values : array of shape (n,) or (n, N)
        As stored; 0, NaN or an empty text where absent.
    present : bool array of the shape of `values`
        False where the visit has no such quantity, or the drive sent no such word.
    """

    name: str
    unit: str
    remark: str
    values: np.ndarray
    present: np.ndarray

    @property
    def there(self) -> np.ndarray:
        """Return whether each sample has the quantity (n,)."""
        return np.atleast_1d(self.present if self.present.ndim == 1 else self.present.any(axis=1))

    def columns(self) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Return name, values (n,) and presence (n,) of each column: one, or one per axis."""
        if self.values.ndim == 1:
            yield self.name, self.values, self.present
            return
        for joint in range(self.values.shape[1]):
            yield column_name(self.name, joint + 1), self.values[:, joint], self.present[:, joint]


@dataclass(frozen=True, slots=True, eq=False)
class ArmSamples:
    """Samples of one arm in measurement order.

    Attributes
    ----------
    name : str
    axes : int
    measurands : dict of str to Measurand
        By name; `group` (visit, period), `number`, `time_s` and `sync_index` are always there.
    about : dict of str to str
        Attributes of the arm.
    """

    name: str
    axes: int
    measurands: dict[str, Measurand]
    about: dict[str, str]

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.measurands["time_s"].values)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """All samples of a recording; `about` are its attributes: cell, profiles, robot, exit status."""

    about: dict[str, str]
    arms: tuple[ArmSamples, ...]

    def __len__(self) -> int:
        """Number of samples of all arms."""
        return sum(map(len, self.arms))


def column_name(name: str, axis: int) -> str:
    """Return the column name of an axis, from 1: `q_rad` becomes `q1_rad`, `statusword` becomes `statusword1`."""
    head, _, unit = name.rpartition("_")
    return f"{head}{axis}_{unit}" if head else f"{name}{axis}"


def read_samples(path: Path, arm_name: str | None = None, label: str | None = None) -> Samples:
    """Return all samples of a recording, or of one arm or one load.

    Raises
    ------
    InputError
        As `gateway.data.recording.reader.read`, or the file holds no such arm or load.
    """
    recording = read(path)
    names = [arm.name for arm in recording.arms]
    if arm_name not in (None, *names):
        raise InputError(
            f"{recording.path}: contains the arms {', '.join(names) or 'none'}: name one of them with --arm"
        )
    if label not in (None, *recording.loads):
        held = ", ".join(recording.loads) or "no sample yet"
        raise InputError(f"{recording.path}: load '{label}' is not in the recording; it contains {held}")
    axes = {arm.name: len(arm.axis) for arm in recording.cell.arm}
    with open_recording(path) as root:
        arms = root.inside("arms")
        return Samples(
            about={name: str(value) for name, value in root.attributes().items()},
            arms=tuple(
                _arm(arms.inside(arm.name), arm.name, axes[arm.name], label)
                for arm in recording.arms
                if arm_name in (None, arm.name)
            ),
        )


def _arm(place: Hdf5Group, name: str, axes: int, label: str | None) -> ArmSamples:
    groups = [
        _group(kind, int(number), place.inside(where).inside(number), axes)
        for where, kind in GROUPS.items()
        if place.has(where)
        for number in place.inside(where).names()
    ]
    groups = [part for part in groups if label in (None, part["load"].values[0])]
    groups.sort(key=lambda part: int(part["number"].values[0]))
    about = {key: str(value) for key, value in place.attributes().items()}
    if place.has("excitations"):
        about |= {f"excitations/{key}": str(text) for key, text in place.inside("excitations").attributes().items()}
    return ArmSamples(name, axes, _joined(groups), about)


def _group(kind: str, number: int, place: Hdf5Group, axes: int) -> dict[str, Measurand]:
    """Return the quantities of one visit or period: its datasets, and its attributes repeated per sample."""
    found: dict[str, Measurand] = {}
    for name in place.names():
        values = place.columns(name, axes)
        attributes = place.group[name].attrs
        unit, _, remark = str(attributes.get("unit", "")).partition(", ")
        missing = attributes.get("missing")
        present = np.ones(values.shape, dtype=bool) if missing is None else values != missing
        found[name] = Measurand(name, unit, remark, values, present)
    samples = len(found["time_s"].values)
    stored: Mapping[str, Any] = {"group": kind, "number": number, **place.attributes()}
    heads = {name: _repeated(name, value, samples, axes) for name, value in stored.items() if name not in found}
    return heads | found


def _repeated(name: str, value: Any, samples: int, axes: int) -> Measurand:
    once = np.asarray(value, dtype=object) if isinstance(value, str) else np.asarray(value)
    if once.shape not in ((), (axes,)):
        once = np.asarray(str(once.tolist()), dtype=object)
    values = np.broadcast_to(once, (samples, *once.shape)).copy()
    return Measurand(name, _UNITS.get(name.rpartition("_")[2], ""), "", values, np.ones(values.shape, dtype=bool))


def _joined(groups: list[dict[str, Measurand]]) -> dict[str, Measurand]:
    """Concatenate groups; a quantity that a group lacks is absent in its samples."""
    if not groups:
        empty = {
            "group": ("", np.zeros(0, dtype=object)),
            "number": ("", np.zeros(0, dtype=np.int64)),
            "load": ("", np.zeros(0, dtype=object)),
            "sync_index": ("SYNC number since the bus was opened", np.zeros(0, dtype=np.int64)),
            "time_s": ("s", np.zeros(0)),
        }
        return {
            name: Measurand(name, unit, "", values, np.zeros(0, dtype=bool)) for name, (unit, values) in empty.items()
        }
    names = dict.fromkeys(name for part in groups for name in part)
    lengths = [len(part["time_s"].values) for part in groups]
    return {name: _one(name, [part.get(name) for part in groups], lengths) for name in names}


def _one(name: str, parts: list[Measurand | None], lengths: list[int]) -> Measurand:
    held = [part for part in parts if part is not None]
    kind = np.result_type(*(part.values.dtype for part in held))
    shape = max((part.values.shape[1:] for part in held), key=len)
    values, present = [], []
    for part, length in zip(parts, lengths, strict=True):
        blank = np.full((length, *shape), {"f": np.nan, "O": "", "b": False}.get(kind.kind, 0), dtype=kind)
        values.append(blank if part is None else _widened(part.values, blank))
        present.append(np.zeros(blank.shape, dtype=bool) if part is None else _widened(part.present, blank == blank))
    reported = max(held, key=lambda part: bool(part.remark))
    return Measurand(name, reported.unit, reported.remark, np.concatenate(values), np.concatenate(present))


def _widened(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return values if values.ndim == like.ndim else np.broadcast_to(values[:, None], like.shape)
