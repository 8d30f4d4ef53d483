"""Write the values of one SYNC into a numeric array, for the live page and the black box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drives.values import DriveReading
from gateway.motion.observer import Observed

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
