"""Sample of an arm at one SYNC, as reported by its drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drives.drive import DriveReading
from drives.values import InstrumentReading


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
