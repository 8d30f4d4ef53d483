"""Promises of the reader of recordings: of any bytes, and of sound files with odd content."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from hypothesis import strategies as st

from benchmarks.chaos.killing import few_samples
from benchmarks.chaos.processes import poses
from benchmarks.chaos.rig import rig
from benchmarks.fuzz.check_files import WORK, in_file
from benchmarks.fuzz.guard import bounded
from benchmarks.fuzz.mutate import edited
from gateway.acquire.planning import plan_of_poses
from gateway.acquire.session import record
from gateway.data.recording.reader import read
from gateway.data.recording.seal import SEAL_BYTES, sealed
from gateway.errors import InputError


def recordings() -> st.SearchStrategy[bytes]:
    """Bytes of a recording after a few edits."""
    return edited([seed_recording()])


@cache
def seed_recording() -> bytes:
    """A short recording of the simulated small arm."""
    path = Path(WORK.name) / "seed.h5"
    with rig(few_samples) as made, made.open() as opened:
        plan = plan_of_poses(opened.loaded, opened.config, opened.workspace, poses(2))
        record(opened, plan, "none", path)
    return path.read_bytes()


def check_recording(data: bytes) -> None:
    """Visits with finite torques, or `InputError`."""
    path = in_file(data, "run.h5")
    recording = bounded(lambda: read(path), (InputError,), len(data))
    if recording is not None:
        for arm in recording.arms:
            for visit in arm.visits:
                assert np.isfinite(visit.joint_torque_nm).all()
                assert len(visit.sync_index) == len(visit.q_rad)


@dataclass(frozen=True, slots=True)
class Change:
    """One change inside a recording: of an attribute, or of a dataset of a visit."""

    where: str
    name: str
    value: Any


VISIT = "arms/main/visits/0001"
_NAMES = ("schema", "exit_status", "cell", "profiles", "robot", "load", "pose", "approach", "complete", "unit")
_DATASETS = ("statusword", "position_count", "torque_permille", "q_rad", "joint_torque_nm", "sync_index", "time_s")


def changes() -> st.SearchStrategy[tuple[Change, ...]]:
    """Changes that keep the file a valid HDF5 file."""
    value = st.one_of(
        st.integers(-(2**40), 2**40),
        st.floats(),
        st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"), max_size=20),
        st.binary(max_size=8).filter(lambda data: b"\0" not in data and data),
        st.sampled_from([None, [], [1, 2], [[0.0] * 6] * 3, [[1] * 5] * 30, "{", "null", "[" * 2000, "nan"]),
    )
    attribute = st.builds(
        Change, st.sampled_from(["", "arms/main", VISIT, f"{VISIT}/q_rad"]), st.sampled_from(_NAMES), value
    )
    dataset = st.builds(Change, st.sampled_from([f"{VISIT}/{name}" for name in _DATASETS]), st.just(""), value)
    huge = st.builds(Change, st.sampled_from([f"{VISIT}/{name}" for name in _DATASETS]), st.just("huge"), st.none())
    gone = st.builds(Change, st.sampled_from([VISIT, "arms/main", f"{VISIT}/sync_index"]), st.just("gone"), st.none())
    return st.lists(st.one_of(attribute, attribute, dataset, huge, gone), min_size=1, max_size=3).map(tuple)


def check_changes(todo: tuple[Change, ...]) -> None:
    """As `check_recording`, for a file whose structure is sound and whose content is not."""
    path = in_file(seed_recording()[:-SEAL_BYTES], "changed.h5")
    with h5py.File(path, "r+") as file:
        for change in todo:
            _apply_change(file, change)
    check_recording(sealed(path.read_bytes()))


def _apply_change(file: h5py.File, change: Change) -> None:
    if change.where and change.where not in file:
        return
    if change.name == "gone":
        del file[change.where]
    elif change.name == "huge":
        data = file[change.where]
        if isinstance(data, h5py.Dataset):
            kind = data.dtype
            del file[change.where]
            file.create_dataset(change.where, (10**9, 6), kind, chunks=(1000, 6))
    elif change.name:
        place = file[change.where] if change.where else file
        place.attrs[change.name] = h5py.Empty("f8") if change.value is None else change.value
    else:
        del file[change.where]
        try:
            file[change.where] = h5py.Empty("f8") if change.value is None else change.value
        except (OverflowError, TypeError, ValueError):
            file[change.where] = 0
