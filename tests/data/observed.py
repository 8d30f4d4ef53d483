"""SYNCs as the motion loop hands them to who looks on."""

from __future__ import annotations

import numpy as np

from drives.values import DriveReading
from gateway.data.visit import ArmSample
from gateway.motion.observer import Observed

ENABLED = 0x1237
PERIOD_S = 0.01


def reading(axis: int, sync: int, statusword: int = ENABLED) -> DriveReading:
    return DriveReading(axis + 1, sync, statusword, 0, 0, None, None, 0.0, 0.0, None, None)


def observed(sync: int, q_rad: np.ndarray, unresponsive: int | None = None, statusword: int = ENABLED) -> Observed:
    """One SYNC: the arm is at q, is commanded 1 mrad more, and gives a torque of its joint's number."""
    readings = [None if axis == unresponsive else reading(axis, sync, statusword) for axis in range(6)]
    measured = np.where([each is None for each in readings], np.nan, q_rad)
    torque_nm = np.where(np.isnan(measured), np.nan, np.arange(1.0, 7.0))
    sample = ArmSample(sync, sync * PERIOD_S, measured, torque_nm, tuple(readings))
    return Observed((sample,), (q_rad + 1e-3,), (np.arange(6.0),))
