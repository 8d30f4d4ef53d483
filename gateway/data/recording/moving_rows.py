"""Measured samples of the periods of a recording: one per SYNC, motion from the measured positions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drives.errors import ProfileError
from drives.profile_file import parse_profile
from gateway.cell.config import ArmConfig
from gateway.data.period import Period
from gateway.data.periodic import CUTOFF_HZ, by_harmonics, by_low_pass
from gateway.data.periods import EXCITATION, MOTION_HZ, PERIOD, PHASE_S
from gateway.data.rows import MOVING, Table
from gateway.errors import InputError


def torque_delay_s(config: ArmConfig, profiles: Mapping[str, str], where: str) -> float:
    """Return the mean delay [s] of the drives' torque words behind their positions, as the profiles state it.

    A first-order filter delays by its time constant. The estimation identifies the deviation of each axis from the
    mean.

    Raises
    ------
    InputError
        A profile is missing or cannot be used.
    """
    late = []
    for axis in config.axis:
        text = profiles.get(axis.profile)
        if not isinstance(text, str):
            raise InputError(f"{where}: the file contains no profile '{axis.profile}'")
        try:
            late.append(parse_profile(text, axis.profile).torque.filter_s)
        except ProfileError as error:
            raise InputError(f"{where}: {error}") from error
    return float(np.mean(late))


def period_rows(period: Period, tau_nm: np.ndarray, path: Path, harmonics: int, delay_s: float) -> Table:
    """Return the samples of a complete period.

    Parameters
    ----------
    period : Period
    tau_nm : array of shape (n, N)
        Joint torque as measured, efficiency not applied.
    path : Path
        Of the recording.
    harmonics : int
        Number of commanded harmonics; 0 if the excitation is not a Fourier series.
    delay_s : float
        Delay of the torques.
    """
    n = len(period)
    if period.kind == "series":
        motion = by_harmonics(period.q_rad, period.period_s, harmonics, delay_s)
    else:
        motion = by_low_pass(period.q_rad, period.period_s, delay_s)
    blank = np.full(period.q_rad.shape, np.nan)
    return Table(
        file=(str(path),) * n,
        line=np.full(n, period.number),
        run=np.array([f"{path.stem}/{period.number:04d}"] * n),
        load=np.array([period.load] * n),
        pose=np.full(n, MOVING),
        time_s=period.time_s,
        q_rad=motion.q_rad,
        qd_rad_s=motion.qd_rad_s,
        qdd_rad_s2=motion.qdd_rad_s2,
        moving=np.ones(n, dtype=bool),
        direction=np.zeros(period.q_rad.shape, dtype=np.int8),
        tau_nm=tau_nm,
        tau_std_nm=blank,
        count=np.ones(n, dtype=int),
        q2nd_rad=blank,
        temperature_c=blank if period.temperature_c is None else np.tile(period.temperature_c, (n, 1)),
        motor_torque_nm=period.motor_torque_nm,
        extra={
            EXCITATION: np.full(n, float(period.motion)),
            PERIOD: np.full(n, float(period.period)),
            PHASE_S: np.arange(n) * (period.period_s / n),
            MOTION_HZ: np.full(n, CUTOFF_HZ),
        },
    )
