"""Observers of the motion loop: notified after every SYNC and of every event; they must not block.

The motion loop calls an observer from its own thread, after each SYNC. An observer stores the data and returns at once:
it does not wait, lock, write to a disk or use the bus. An observer that raises is removed and does not affect the
motion. To stop an arm, use a stop request (`gateway.motion.stops`) instead.

`fill` writes the values of one SYNC into a numeric array, for the live page and the black box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drives.values import DriveReading
from gateway.data.visit import ArmSample
from gateway.motion.arms import Arms
from gateway.motion.state import StateTracker
from gateway.motion.workspace import Workspace


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Data of one SYNC; each tuple has one member per arm.

    Attributes
    ----------
    samples : tuple of ArmSample
        Answers of the drives.
    targets_rad : tuple of arrays of shape (N,)
        Joint setpoints sent with this SYNC.
    modelled_nm : tuple of arrays of shape (N,)
        Modelled torque without friction at these setpoints; 0 where the links are unknown.
    """

    samples: tuple[ArmSample, ...]
    targets_rad: tuple[np.ndarray, ...]
    modelled_nm: tuple[np.ndarray, ...]


class Observer:
    """Observer of the motion loop that ignores everything; its methods must return at once."""

    def began(self, arms: Arms, workspaces: tuple[Workspace, ...], period_s: float, state: StateTracker, /) -> None:
        """Called before the arms are powered, with a workspace per arm, the SYNC period and the state of the arms."""

    def sampled(self, observed: Observed, /) -> None:
        """Called after every answered SYNC, including the one that ends the motion, before anything is stopped."""

    def reported(self, event: object, /) -> None:
        """Called with an event of `gateway.acquire.events`, or a `MotionProgress`."""

    def ended(self, failure: BaseException | None, /) -> None:
        """Called when the brakes are on, or the stop is finished otherwise; `error` is None without an error."""


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Progress of a motion: its description, the present sample number and the number of samples."""

    what: str
    row: int
    rows: int


class Observers:
    """Observers of one command; one that raises is removed.

    Parameters
    ----------
    observers : Observer

    Attributes
    ----------
    troubles : list of Exception
        Exceptions of the removed observers.
    """

    def __init__(self, *observers: Observer) -> None:
        self.troubles: list[Exception] = []
        self._present = list(observers)

    def add(self, observer: Observer) -> None:
        """Add an observer from now on."""
        self._present.append(observer)

    def notify(self, call: Callable[[Observer], None]) -> None:
        """Call a method of every observer, as given by a function of the observer."""
        for observer in tuple(self._present):
            try:
                call(observer)
            except Exception as error:
                self._present.remove(observer)
                self.troubles.append(error)


Field = Callable[[Observed, int], Sequence[float] | NDArray[np.float64]]


def _of_readings(word: Callable[[DriveReading], float | None]) -> Field:
    """Return one value of every drive of an arm; NaN without an answer or if the drive does not send it."""

    def values(observed: Observed, arm: int) -> list[float]:
        values = [None if reading is None else word(reading) for reading in observed.samples[arm].readings]
        return [np.nan if value is None else value for value in values]

    return values


#: Field names of the black box; each returns one number per axis of an arm (index in `Observed`).
FIELDS: Final[dict[str, Field]] = {
    "q_rad": lambda observed, arm: observed.samples[arm].q_rad,
    "target_rad": lambda observed, arm: observed.targets_rad[arm],
    "joint_torque_nm": lambda observed, arm: observed.samples[arm].joint_torque_nm,
    "modelled_torque_nm": lambda observed, arm: observed.modelled_nm[arm],
    "motor_current_a": _of_readings(lambda reading: reading.current_a),
    "statusword": _of_readings(lambda reading: reading.statusword),
    "position_count": _of_readings(lambda reading: reading.position_count),
    "torque_permille": _of_readings(lambda reading: reading.torque_word),
}


def fill(row: NDArray[np.float64], at: int, observed: Observed, arm: int, fields: Sequence[str]) -> int:
    """Write the fields of one arm into an array, each with one number per axis.

    Parameters
    ----------
    row : array of shape (n,)
    at : int
        Start index of the first field.
    observed : Observed
    arm : int
        Index of the arm in `observed`.
    fields : sequence of str
        Names from `FIELDS`, in the order of the array.

    Returns
    -------
    int Index after the last field.
    """
    axes = len(observed.targets_rad[arm])
    for name in fields:
        row[at : at + axes] = FIELDS[name](observed, arm)
        at += axes
    return at
