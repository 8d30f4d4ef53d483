"""Writer of a recording: after each visit or period the file is written under a temporary name, synced, renamed.

The file is built in memory, so that the file on disk is always complete: the last version or the one before. A
recording has one writer at a time: that of a killed run may still be active at the next run.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from drives.files import lock_file, replace_file
from drives.scaling import Constants
from gateway.data.period import Measured, Period
from gateway.data.recording.reader import SCHEMA, Recording, read
from gateway.data.recording.seal import sealed
from gateway.data.visit import NO_WORD, RestPose, Visit
from gateway.errors import InputError

#: Puts a content in the place of a file, whole or not at all; raises InputError.
Write = Callable[[Path, bytes], None]
#: What to do where a recording would be replaced.
NOT_REPLACED = "continue it with --resume, or choose another name"
#: How long the writer of a run that was killed may still be busy with what it was given [s].
PATIENCE_S = 20.0
UNFINISHED = "not finished: still running, or killed"

#: dataset -> (field of Visit and of Period, unit)
WORDS = {
    "statusword": ("statusword", "bits of 0x6041"),
    "position_count": ("position_count", "encoder counts"),
    "torque_permille": ("torque_word", "word of the profile's torque object, as received"),
    "current_permille": ("current_word", "word of the profile's current object, as received"),
    "velocity_word": ("velocity_word", "word of the profile's velocity object, as received"),
}
VALUES = {
    "q_rad": ("q_rad", "rad"),
    "motor_torque_nm": ("motor_torque_nm", "Nm, motor side"),
    "joint_torque_nm": ("joint_torque_nm", "Nm, joint side, gear efficiency not applied"),
    "motor_current_a": ("motor_current_a", "A, of the kind the torque constant refers to"),
}
_LOOK_S = 0.02


@dataclass(frozen=True, slots=True)
class ArmHeader:
    """Constant data of one arm in a recording.

    Attributes
    ----------
    name : str
    poses : tuple of RestPose
    constants : tuple of Constants, one per drive
        Read from the drives.
    identities, ledger : lists of dict
        Identity of the drives; every object written, with its old value.
    excitations : dict of int to dict
        Excitations of the periods by fingerprint, as plain values.
    """

    name: str
    poses: tuple[RestPose, ...]
    constants: tuple[Constants, ...]
    identities: list[dict[str, Any]] = field(default_factory=list)
    ledger: list[dict[str, Any]] = field(default_factory=list)
    excitations: dict[int, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RecordingHeader:
    """Constant data of a recording; texts are the contents of the input files."""

    created: str
    cell: str
    profiles: dict[str, str]
    robot: str
    software: str
    calibration: str = ""


class Numbering:
    """Continues the numbers and the time of the visits and periods of a file.

    Parameters
    ----------
    earlier : Recording or None
        The file's content so far.
    """

    def __init__(self, earlier: Recording | None) -> None:
        stored = [] if earlier is None else [each for arm in earlier.arms for each in (*arm.visits, *arm.periods)]
        self._number = max((each.number for each in stored), default=0)
        self._last_s = max((float(each.time_s[-1]) for each in stored), default=-np.inf)
        self._shift_s: float | None = None

    def next(self, visit: Measured) -> Measured:
        """Return the visit or the period with its number and stored time."""
        if self._shift_s is None:
            period_s = float(np.diff(visit.time_s).min()) if len(visit) > 1 else 1.0
            late = self._last_s + period_s - float(visit.time_s[0])
            self._shift_s = max(0.0, late)
        self._number += 1
        return replace(visit, number=self._number, time_s=visit.time_s + self._shift_s)


def refuse_other_cell(earlier: Recording | None, cell_text: str) -> None:
    """Raise an error if a recording was made with another cell file.

    Raises
    ------
    InputError
    """
    if earlier is not None and earlier.cell_text != cell_text:
        what = "was recorded with another cell file; choose another name for the new recording"
        raise InputError(f"{earlier.path} {what}")


class RecordingWriter:
    """Appends visits and periods to one file; `visits` counts both.

    Parameters
    ----------
    path : Path
    header : RecordingHeader
    earlier : Recording or None
        The file's content so far, to go on with; None = the file must not exist.
    write : callable, optional
        Replaces the file by the content, atomically; default `write_recording`.

    Raises
    ------
    InputError
        The file exists, was made with another cell, or holds other visits than `earlier`.
    """

    def __init__(
        self, path: Path, header: RecordingHeader, earlier: Recording | None, write: Write | None = None
    ) -> None:
        self.path = path
        self._write = write or write_recording
        if earlier is None and path.exists():
            raise InputError(f"{path} exists; {NOT_REPLACED}")
        refuse_other_cell(earlier, header.cell)
        # in memory; the name must differ from those of other files that the process has open
        self._file = h5py.File(f"{path} in memory", "w", driver="core", backing_store=False)
        if earlier is not None:
            with h5py.File(path, "r") as source:
                source.copy("arms", self._file)
            if _stored(self._file.require_group("arms")) != {
                (arm.name, each.number) for arm in earlier.arms for each in (*arm.visits, *arm.periods)
            }:
                self._file.close()
                raise InputError(f"{path} an earlier run was still writing it; continue it again")
        root = self._file.attrs
        root["schema"] = SCHEMA
        root["created"] = header.created if earlier is None else earlier.created
        root["cell"], root["robot"], root["software"] = header.cell, header.robot, header.software
        root["calibration"] = header.calibration
        root["profiles"] = json.dumps(header.profiles)
        self._arms = self._file.require_group("arms")
        self.visits = 0
        self._numbering = Numbering(earlier)

    def begin(self, header: ArmHeader) -> None:
        """Store the constant data of an arm; an arm already in the file keeps its visits and periods."""
        arm = self._arms.require_group(header.name)
        arm.require_group("visits")
        if header.excitations:
            known = arm.require_group("excitations")
            for number, plain in header.excitations.items():
                known.attrs[str(number)] = json.dumps(plain)
        arm.attrs["constants"] = json.dumps([asdict(constants) for constants in header.constants])
        arm.attrs["identities"] = json.dumps(header.identities)
        arm.attrs["ledger"] = json.dumps(header.ledger)
        if "pose_q_rad" in arm:
            del arm["pose_q_rad"], arm["pose_number"], arm["pose_validation"]
        if not header.poses:
            return
        dataset = arm.create_dataset("pose_q_rad", data=np.array([pose.q_rad for pose in header.poses]))
        dataset.attrs["unit"] = "rad"
        arm["pose_number"] = np.array([pose.number for pose in header.poses], dtype=np.int64)
        arm["pose_validation"] = np.array([pose.purpose == "validation" for pose in header.poses], dtype=np.int8)

    def add(self, arm: str, visit: Measured) -> Measured:
        """Store a visit or a period and write the file.

        Returns
        -------
        Visit or Period
            With its number; its time continues that of the previous visits.

        Raises
        ------
        InputError
            The file cannot be written; the previous version is unchanged.
        """
        stored = self._numbering.next(visit)
        self.store(arm, stored)
        return stored

    def store(self, arm: str, visit: Visit | Period) -> None:
        """Store a visit or a period that has its number, and write the file; nothing if the file holds it already.

        Raises
        ------
        InputError
            The file cannot be written; the previous version is unchanged, and the next write includes this visit.
        """
        group = self._arms.require_group(f"{arm}/{'periods' if isinstance(visit, Period) else 'visits'}")
        if (name := f"{visit.number:04d}") in group:
            return
        if isinstance(visit, Period):
            _write_period(group.create_group(name), visit)
        else:
            _write_visit(group.create_group(name), visit)
        self._save("abort", UNFINISHED)
        self.visits += 1

    def finish(self, arm: str, status: str, reason: str, statistics: dict[str, Any]) -> None:
        """Store the result of the run (`success`, `abort`, `fail`) and write the file.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        if arm in self._arms:
            self._arms[arm].attrs["bus_statistics"] = json.dumps(statistics)
        self._save(status, reason)

    def close(self) -> None:
        """Free the memory; the file on disk is unchanged."""
        self._file.close()

    def _save(self, status: str, reason: str) -> None:
        self._file.attrs["exit_status"] = status
        self._file.attrs["reason"] = reason.replace("\0", "")
        self._file.flush()
        self._write(self.path, sealed(self._file.id.get_file_image()))


@contextmanager
def open_recording(
    path: Path, header: RecordingHeader, arm: ArmHeader, earlier: Recording | None, write: Write, again: bool
) -> Generator[RecordingWriter]:
    """Open a recording in the process that writes it (a kind of `Disk.open`); it has no other writer meanwhile.

    `again`: the process that wrote it before has ended, and the file holds what was written until then.

    Raises
    ------
    InputError
        As `RecordingWriter`, or another run is writing it.
    """
    with sole_writer(path, PATIENCE_S):
        if again and path.exists():
            earlier = read(path)
        with closing(RecordingWriter(path, header, earlier, write)) as writer:
            writer.begin(arm)
            yield writer


def write_recording(path: Path, content: bytes) -> None:
    """Write a file atomically: a crash leaves the complete previous file or the complete new one.

    Raises
    ------
    InputError
        It cannot be written (disk full, no permission); the previous file is unchanged.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written: {error.strerror or error}; the file still contains the earlier data"
        ) from error


def _stored(arms: h5py.Group) -> set[tuple[str, int]]:
    """Return arm and number of every visit and period."""
    groups = [(str(arm), f"{arm}/{kind}") for arm in arms for kind in ("visits", "periods")]
    return {(arm, int(str(number))) for arm, group in groups if group in arms for number in arms.require_group(group)}


def _write_visit(group: h5py.Group, visit: Visit) -> None:
    attributes: dict[str, Any] = {
        "load": visit.load,
        "pose": visit.pose,
        "purpose": visit.purpose,
        "approach": visit.approach,
        "complete": visit.complete,
        "incomplete_epochs": visit.incomplete_epochs,
        "direction": visit.direction,
        "target_rad": visit.target_rad,
    }
    if visit.gravity_nm is not None and visit.friction_band_nm is not None:
        attributes |= {"gravity_nm": visit.gravity_nm, "friction_band_nm": visit.friction_band_nm}
    _write_samples(group, attributes, visit)


def _write_period(group: h5py.Group, period: Period) -> None:
    names = ("load", "excitation", "name", "kind", "joint", "period", "period_s", "speed", "complete")
    attributes = {name: getattr(period, name) for name in (*names, "incomplete_epochs")}
    _write_samples(group, attributes, period)
    _dataset(group, "target_rad", period.target_rad, "rad, sent with this SYNC, due at the next")


def _write_samples(group: h5py.Group, attributes: dict[str, Any], visit: Visit | Period) -> None:
    if visit.temperature_c is not None:
        attributes = attributes | {"temperature_c": visit.temperature_c}
    for name, value in attributes.items():
        group.attrs[name] = value
    for name, (source, unit) in WORDS.items():
        words = getattr(visit, source)
        if (words != NO_WORD).any():
            _dataset(group, name, words.astype(np.uint16 if name == "statusword" else np.int32), unit)
            if (words == NO_WORD).any():
                group[name].attrs["missing"] = NO_WORD
    for name, (source, unit) in VALUES.items():
        values = getattr(visit, source)
        if np.isfinite(values).any():
            _dataset(group, name, values, unit)
    _dataset(group, "sync_index", visit.sync_index, "SYNC number since the bus was opened")
    _dataset(group, "time_s", visit.time_s, "s")


def _dataset(group: h5py.Group, name: str, values: np.ndarray, unit: str) -> None:
    group.create_dataset(name, data=values).attrs["unit"] = unit


@contextmanager
def sole_writer(path: Path, patience_s: float) -> Generator[None]:
    """Hold the lock of a recording; a lock file whose process has ended is ignored.

    Parameters
    ----------
    path : Path
        The recording.
    patience_s : float
        Time to wait for another writer to end.

    Raises
    ------
    InputError
        Another process still writes it, or the folder is not writable.
    """
    mark = path.with_name(path.name + ".lock")
    until_s = time.monotonic() + patience_s
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        while (descriptor := _taken(mark)) is None:
            if time.monotonic() >= until_s:
                raise InputError(f"{path}: another run is writing it; wait for its end, or choose another name")
            time.sleep(_LOOK_S)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    try:
        yield
    finally:
        mark.unlink(missing_ok=True)
        os.close(descriptor)


def _taken(mark: Path) -> int | None:
    """Return the locked file; None if another process holds it or has just deleted it."""
    descriptor = os.open(mark, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        lock_file(descriptor)
        if os.path.samestat(os.fstat(descriptor), os.stat(mark)):
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None
