"""Period of an excitation trajectory as driven: raw drive words and SI values of every SYNC."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields
from typing import Any, Final, TypeVar

import numpy as np

from gateway.data.visit import NO_WORD, ArmSample, Visit
from gateway.errors import InputError

#: `series`: all joints at once; `sweep`: steady speeds of one joint.
KINDS: Final = ("series", "sweep")
#: SYNCs that a period must have at least, and for each of its harmonics: the torque has overtones of them.
LEAST_PER_PERIOD: Final = 20
LEAST_PER_HARMONIC: Final = 8
_WORDS: Final = ("statusword", "position_count", "torque_word", "current_word", "velocity_word")


@dataclass(frozen=True, slots=True)
class PeriodLabel:
    """Identification of a period before it has samples.

    Attributes
    ----------
    load : str
    excitation : int
        Fingerprint of the excitation at full speed.
    name, kind : str
        Of the excitation.
    joint : int
        Joint moved by a sweep, from 1; 0 = all.
    period : int
        Number of the period within the excitation, from 1.
    speed : float
        Fraction of full speed, in (0, 1].
    period_s : float
        Duration at that speed: a whole number of SYNC periods.
    """

    load: str
    excitation: int
    name: str
    kind: str
    joint: int
    period: int
    speed: float
    period_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Period(PeriodLabel):
    """Samples of one period, from rest at its beginning to the last SYNC before its end.

    Attributes
    ----------
    number : int
        Group name in the file, from 1, counted on from the visits and periods before; 0 = not stored yet.
    complete : bool
        Whether it contains every SYNC.
    incomplete_epochs : int
        Number of SYNCs that an axis did not answer.
    target_rad : array of shape (n, N)
        Joint setpoints sent with each SYNC; the drive reaches them one SYNC later.
    statusword, position_count, torque_word, current_word, velocity_word : int64 arrays of shape (n, N)
        Raw values as received; `NO_WORD` where the drive sends none.
    q_rad, motor_torque_nm, joint_torque_nm, motor_current_a : arrays of shape (n, N)
        Current NaN where the drive sends none.
    sync_index : int64 array of shape (n,)
    time_s : array of shape (n,)
    temperature_c : array of shape (N,) or None
        As in `Visit`.
    """

    number: int
    complete: bool
    incomplete_epochs: int
    target_rad: np.ndarray
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
    temperature_c: np.ndarray | None = None

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.sync_index)

    @property
    def motion(self) -> int:
        """Number of the motion, equal for equal motion and speed in all files."""
        return motion_number(self.excitation, self.speed)


#: What a recording holds as a group of its own.
Measured = TypeVar("Measured", bound=Visit | Period)


def motion_number(excitation: int, speed: float) -> int:
    """Return the fingerprint of an excitation at a fraction of its speed; at full speed its own fingerprint."""
    return excitation if speed == 1.0 else zlib.crc32(f"{excitation} at {speed!r}".encode())


def harmonics_of(excitation: dict[str, Any]) -> int:
    """Return the order of the highest harmonic of an excitation; 0 if it is not a Fourier series."""
    rows = excitation.get("cosine_rad")
    return len(rows[0]) if isinstance(rows, list) and rows and isinstance(rows[0], list) else 0


def why_aliased(count: int, harmonics: int) -> str | None:
    """Return why `count` SYNCs per period undersample the harmonics of an excitation; None if they suffice."""
    least = max(LEAST_PER_PERIOD, LEAST_PER_HARMONIC * harmonics)
    if count >= least:
        return None
    return (
        f"{count} SYNCs in a period of {harmonics} harmonics are too few, {least} are needed: use a longer period, "
        "fewer harmonics, or a shorter sync_period_s"
    )


class PeriodLog:
    """Collects the samples of one period in preallocated arrays.

    Parameters
    ----------
    label : PeriodLabel
    count, axes : int
        SYNCs of the period; axes.

    Attributes
    ----------
    incomplete_epochs : int
        Number of SYNCs so far that an axis did not answer.
    silent : set of int
        Axes, from 1, whose drive did not answer a SYNC.
    """

    def __init__(self, label: PeriodLabel, count: int, axes: int) -> None:
        self.incomplete_epochs = 0
        self.silent: set[int] = set()
        self._label, self._count, self._taken = label, count, 0
        self._words = np.full((len(_WORDS), count, axes), NO_WORD, dtype=np.int64)
        self._target, self._q, self._motor, self._joint, self._current = np.full((5, count, axes), np.nan)
        self._sync, self._time = np.zeros(count, dtype=np.int64), np.zeros(count)

    def add(self, sample: ArmSample, target_rad: np.ndarray) -> None:
        """Add the sample of one SYNC and the setpoints (N,) sent with it; of an incomplete sample only the count is
        kept.
        """
        readings = [reading for reading in sample.readings if reading is not None]
        if len(readings) < len(sample.readings):
            self.incomplete_epochs += 1
            self.silent.update(sample.silent)
            return
        row = self._taken
        for k, name in enumerate(_WORDS):
            words = [getattr(reading, name) for reading in readings]
            self._words[k, row] = [NO_WORD if word is None else word for word in words]
        self._target[row], self._q[row], self._joint[row] = target_rad, sample.q_rad, sample.joint_torque_nm
        self._motor[row] = [reading.torque_nm for reading in readings]
        self._current[row] = [np.nan if reading.current_a is None else reading.current_a for reading in readings]
        self._sync[row], self._time[row] = sample.sync_index, sample.time_s
        self._taken += 1

    def __len__(self) -> int:
        """Samples so far."""
        return self._taken

    def period(self, temperature_c: np.ndarray | None = None) -> Period:
        """Return the collected period, marked complete if no SYNC is missing, with the temperatures (N,) [deg C].

        Raises
        ------
        InputError
            No sample.
        """
        n = self._taken
        if not n:
            where = f"period {self._label.period} of '{self._label.name}'"
            raise InputError(f"{where}: the drives answered no SYNC; check power and bus")
        stated: dict[str, Any] = {item.name: getattr(self._label, item.name) for item in fields(self._label)}
        words: dict[str, Any] = {name: self._words[k, :n] for k, name in enumerate(_WORDS)}
        return Period(
            **stated,
            number=0,
            complete=n == self._count,
            incomplete_epochs=self.incomplete_epochs,
            target_rad=self._target[:n],
            **words,
            q_rad=self._q[:n],
            motor_torque_nm=self._motor[:n],
            joint_torque_nm=self._joint[:n],
            motor_current_a=self._current[:n],
            sync_index=self._sync[:n],
            time_s=self._time[:n],
            temperature_c=temperature_c,
        )
