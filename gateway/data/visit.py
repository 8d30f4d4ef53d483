"""Sample of an arm at one SYNC, rest pose, and its visit from one approach direction: raw drive words and SI values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from drives.drive import DriveReading
from drives.values import InstrumentReading
from gateway.errors import InputError

Purpose = Literal["fit", "validation"]
#: Stands for a word that the drive does not send.
NO_WORD = -(2**31)


def following_error_rad(target_rad: np.ndarray, position_rad: np.ndarray) -> np.ndarray:
    """Return the following error [rad], target minus actual position (ISO 9283; CiA 402 object 0x60F4)."""
    return target_rad - position_rad


@dataclass(frozen=True, slots=True, eq=False)
class ArmSample:
    """Sample of an arm of N axes at one SYNC, joint side, as reported by its drives.

    Attributes
    ----------
    sync_index : int
    time_s : float
    q_rad : array of shape (N,)
        NaN where a drive did not answer.
    joint_torque_nm : array of shape (N,)
        Ratio, sign and coupling applied, efficiency not; NaN where a drive did not answer.
    readings : tuple of DriveReading or None
        Motor side, raw and SI.
    instruments : tuple of InstrumentReading or None
        Measuring devices on the same bus, at the same SYNC; None where one did not answer.
    """

    sync_index: int
    time_s: float
    q_rad: np.ndarray
    joint_torque_nm: np.ndarray
    readings: tuple[DriveReading | None, ...]
    instruments: tuple[InstrumentReading | None, ...] = ()

    @property
    def complete(self) -> bool:
        """Return whether every drive answered this SYNC."""
        return None not in self.readings

    @property
    def silent(self) -> tuple[int, ...]:
        """Axes, from 1, whose drive did not answer."""
        return tuple(axis for axis, reading in enumerate(self.readings, start=1) if reading is None)


@dataclass(frozen=True, slots=True)
class RestPose:
    """Static posture to measure; `number` identifies it in every file."""

    number: int
    q_rad: tuple[float, ...]
    purpose: Purpose


@dataclass(frozen=True, slots=True, eq=False)
class VisitLabel:
    """Identification of a visit before it has samples.

    Attributes
    ----------
    load : str
    pose : int
    purpose : str
        `fit` or `validation`.
    approach : int
        Sign of the last motion of all joints.
    direction : int8 array of shape (N,)
        Sign of each joint's last commanded motion.
    target_rad : array of shape (N,)
    """

    load: str
    pose: int
    purpose: str
    approach: int
    direction: np.ndarray
    target_rad: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Visit(VisitLabel):
    """Samples of an arm at rest in one pose, approached from one direction.

    Attributes
    ----------
    number : int
        Group name in the file, from 1; 0 = not stored yet.
    complete : bool
        Whether it contains all requested samples.
    incomplete_epochs : int
        Number of SYNCs during sampling that an axis did not answer.
    statusword, position_count, torque_word, current_word, velocity_word : int64 arrays of shape (n, N)
        Raw values as received; `NO_WORD` where the drive sends none.
    q_rad, motor_torque_nm, joint_torque_nm, motor_current_a : arrays of shape (n, N)
        Current NaN where the drive sends none.
    sync_index : int64 array of shape (n,)
    time_s : array of shape (n,)
    gravity_nm, friction_band_nm : arrays of shape (N,) or None
        Half-sum and half-difference of the torques of both approach directions, each with its gear efficiency;
        stored with the second direction only.
    temperature_c : array of shape (N,) or None
        Of motor or drive, read once during the visit; NaN where the drive reports none, None where none does.
    """

    number: int
    complete: bool
    incomplete_epochs: int
    statusword: np.ndarray
    position_count: np.ndarray
    torque_word: np.ndarray
    current_word: np.ndarray
    velocity_word: np.ndarray
    q_rad: np.ndarray
    motor_torque_nm: np.ndarray
    joint_torque_nm: np.ndarray
    motor_current_a: np.ndarray
    sync_index: np.ndarray
    time_s: np.ndarray
    gravity_nm: np.ndarray | None = None
    friction_band_nm: np.ndarray | None = None
    temperature_c: np.ndarray | None = None

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.sync_index)


def visit_from_samples(
    label: VisitLabel,
    samples: Sequence[ArmSample],
    complete: bool,
    incomplete_epochs: int,
    temperature_c: np.ndarray | None = None,
) -> Visit:
    """Return a visit from complete samples.

    Raises
    ------
    InputError
        There is no sample, or one is incomplete.
    """
    rows = [[reading for reading in sample.readings if reading is not None] for sample in samples]
    if not rows or any(len(row) != len(label.direction) for row in rows):
        raise InputError(f"pose {label.pose}: a visit is made of complete samples only")

    def words(name: str) -> np.ndarray:
        values = [[getattr(reading, name) for reading in row] for row in rows]
        return np.array([[NO_WORD if word is None else word for word in row] for row in values], dtype=np.int64)

    current = [[np.nan if reading.current_a is None else reading.current_a for reading in row] for row in rows]
    stated: dict[str, Any] = {item.name: getattr(label, item.name) for item in fields(label)}
    stated["direction"] = np.asarray(label.direction, dtype=np.int8)
    return Visit(
        **stated,
        number=0,
        complete=complete,
        incomplete_epochs=incomplete_epochs,
        statusword=words("statusword"),
        position_count=words("position_count"),
        torque_word=words("torque_word"),
        current_word=words("current_word"),
        velocity_word=words("velocity_word"),
        q_rad=np.array([sample.q_rad for sample in samples]),
        motor_torque_nm=np.array([[reading.torque_nm for reading in row] for row in rows]),
        joint_torque_nm=np.array([sample.joint_torque_nm for sample in samples]),
        motor_current_a=np.array(current),
        sync_index=np.array([sample.sync_index for sample in samples], dtype=np.int64),
        time_s=np.array([sample.time_s for sample in samples]),
        temperature_c=temperature_c,
    )
