"""One period of an excitation, as it was driven and sampled: raw words and SI values of every SYNC."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np

from gateway.data.sample import ArmSample
from gateway.data.visit import NO_WORD, Visit
from gateway.errors import InputError

#: `series`: all joints at once; `sweep`: steady speeds of one joint.
KINDS: Final = ("series", "sweep")
#: SYNCs that a period must have at least, and for each of its harmonics: the torque has overtones of them.
LEAST_PER_PERIOD: Final = 20
LEAST_PER_HARMONIC: Final = 8
_WORDS: Final = ("statusword", "position_count", "torque_word", "current_word", "velocity_word")


@dataclass(frozen=True, slots=True)
class PeriodLabel:
    """What a period is called, before it has samples.

    Attributes
    ----------
    load : str
    excitation : int
        Fingerprint of what is driven, at full speed.
    name, kind : str
        Of the excitation.
    joint : int
        Joint that a sweep turns, from 1; 0 = all.
    period : int
        Which of the excitation's periods, from 1.
    speed : float
        Share of the full speed, in (0, 1].
    period_s : float
        Duration as it is driven: a whole number of SYNCs.
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
class Period:
    """Samples of one period, from rest at its beginning to the last SYNC before its end.

    Attributes
    ----------
    number : int
        Group name in the file, from 1, counted on from the visits and periods before; 0 = not stored yet.
    load, excitation, name, kind, joint, period, speed, period_s
        As in `PeriodLabel`.
    complete : bool
        Whether every SYNC of it is here.
    incomplete_epochs : int
        SYNCs that some axis left unanswered.
    target_rad : array of shape (n, N)
        Joint positions that were sent with each SYNC; they are due one SYNC later.
    statusword, position_count, torque_word, current_word, velocity_word : int64 arrays of shape (n, N)
        As received; `NO_WORD` where the drive sends none.
    q_rad, motor_torque_nm, joint_torque_nm, motor_current_a : arrays of shape (n, N)
        Current NaN where the drive sends none.
    sync_index : int64 array of shape (n,)
    time_s : array of shape (n,)
    temperature_c : array of shape (N,) or None
        As in `Visit`.
    """

    number: int
    load: str
    excitation: int
    name: str
    kind: str
    joint: int
    period: int
    speed: float
    period_s: float
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
        """The same number for the same motion at the same speed, in any file."""
        return motion_number(self.excitation, self.speed)


#: What a recording holds as a group of its own.
Measured = TypeVar("Measured", bound=Visit | Period)


def motion_number(excitation: int, speed: float) -> int:
    """Fingerprint of an excitation driven at a share of its speed: at full speed, its own."""
    return excitation if speed == 1.0 else zlib.crc32(f"{excitation} at {speed!r}".encode())


def harmonics_of(excitation: dict[str, Any]) -> int:
    """Number of the fastest harmonic of a series, from its plain values; 0 where it is not made of harmonics."""
    rows = excitation.get("cosine_rad")
    return len(rows[0]) if isinstance(rows, list) and rows and isinstance(rows[0], list) else 0


def why_aliased(count: int, harmonics: int) -> str | None:
    """Why so many SYNCs do not hold a period of so many harmonics, in words; None = they do."""
    least = max(LEAST_PER_PERIOD, LEAST_PER_HARMONIC * harmonics)
    if count >= least:
        return None
    return (
        f"{count} SYNCs in a period of {harmonics} harmonics are too few, {least} are needed: use a longer period, "
        "fewer harmonics, or a shorter sync_period_s"
    )


class PeriodLog:
    """Takes the samples of one period as they come, so that nothing is left to be put together at its end.

    Parameters
    ----------
    label : PeriodLabel
    count, axes : int
        SYNCs of the period; axes.

    Attributes
    ----------
    incomplete_epochs : int
        SYNCs so far that some axis left unanswered.
    silent : set of int
        Axes, from 1, whose drive left one unanswered.
    """

    def __init__(self, label: PeriodLabel, count: int, axes: int) -> None:
        self.incomplete_epochs = 0
        self.silent: set[int] = set()
        self._label, self._count, self._taken = label, count, 0
        self._words = np.full((len(_WORDS), count, axes), NO_WORD, dtype=np.int64)
        self._target, self._q, self._motor, self._joint, self._current = np.full((5, count, axes), np.nan)
        self._sync, self._time = np.zeros(count, dtype=np.int64), np.zeros(count)

    def add(self, sample: ArmSample, target_rad: np.ndarray) -> None:
        """One SYNC and the joint positions (N,) that were sent with it; one that is incomplete is counted alone."""
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
        """What was taken, complete if it is all of it; with the temperatures (N,) [deg C] that were read meanwhile.

        Raises
        ------
        InputError
            No sample.
        """
        n = self._taken
        if not n:
            raise InputError(f"period {self._label.period} of '{self._label.name}': not one SYNC was answered")
        label = self._label
        words = {name: self._words[k, :n] for k, name in enumerate(_WORDS)}
        return Period(
            number=0,
            load=label.load,
            excitation=label.excitation,
            name=label.name,
            kind=label.kind,
            joint=label.joint,
            period=label.period,
            speed=label.speed,
            period_s=label.period_s,
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
