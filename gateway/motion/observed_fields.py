"""Write the values of one SYNC into a row of numbers, for the live page and the black box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drives.values import DriveReading
from gateway.motion.observer import Observed

Field = Callable[[Observed, int], Sequence[float] | NDArray[np.float64]]


def _of_readings(word: Callable[[DriveReading], float | None]) -> Field:
    """A word of every drive of an arm; NaN where it did not answer, or sends no such word."""

    def values(observed: Observed, arm: int) -> list[float]:
        values = [None if reading is None else word(reading) for reading in observed.samples[arm].readings]
        return [np.nan if value is None else value for value in values]

    return values


#: By the names of the black box: one number per axis of an arm (its place in `Observed`).
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
    """Write fields of one arm into a row, each with one number per axis.

    Parameters
    ----------
    row : array of shape (n,)
    at : int
        Where the first one begins.
    observed : Observed
    arm : int
        Its place in `observed`.
    fields : sequence of str
        Of `FIELDS`, in the order of the row.

    Returns
    -------
    int
        Where they end.
    """
    axes = len(observed.targets_rad[arm])
    for name in fields:
        row[at : at + axes] = FIELDS[name](observed, arm)
        at += axes
    return at
