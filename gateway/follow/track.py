"""Recorded pass of a path (commands, measurements, offsets per SYNC), and the figures of its following error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.data.visit import ArmSample, following_error_rad
from gateway.result.follow import FedLoad, FollowedSetting
from gateway.result.values import numbers

Floats = NDArray[np.float64]

#: Rows that are left out after an incompletely answered SYNC: answers may be delayed by one SYNC.
DOUBTFUL_ROWS = 2
#: Motion of the target between two SYNCs [rad] beyond which six unchanged readings count as old.
STALE_MOTION_RAD = 1e-3
#: Speed of the target below which an axis counts as at rest [rad/s].
STILL_RAD_S = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Record of one pass of the path.

    Attributes
    ----------
    setting : str
    period_s : float
    target_rad, measured_rad : arrays of shape (n, 6)
        Setpoint and position of each joint at a SYNC. NaN if a drive did not answer, in the next rows after that, and
        if all six readings are unchanged although the arm moves.
    torque_nm : array of shape (n, 6)
        Measured torque, motor side.
    velocity_offset_rad_s, torque_offset_nm : arrays of shape (n, 6)
        Offsets sent to the drives, motor side.
    computing_s : array of shape (n,)
        Computing time of all offsets; 0 if none were computed.
    """

    setting: str
    period_s: float
    target_rad: Floats
    measured_rad: Floats
    torque_nm: Floats
    velocity_offset_rad_s: Floats
    torque_offset_nm: Floats
    computing_s: Floats

    @property
    def time_s(self) -> Floats:
        """Time (n,) of every sample."""
        return np.arange(len(self.target_rad), dtype=float) * self.period_s

    @property
    def error_rad(self) -> Floats:
        """Following error (n, 6): target less measured."""
        return following_error_rad(self.target_rad, self.measured_rad)

    @property
    def velocity_rad_s(self) -> Floats:
        """Velocity (n, 6) of the target, by central differences."""
        return np.gradient(self.target_rad, self.period_s, axis=0)

    @property
    def acceleration_rad_s2(self) -> Floats:
        """Acceleration (n, 6) of the target, by central differences; 0 at both ends."""
        second = np.zeros_like(self.target_rad)
        second[1:-1] = np.diff(self.target_rad, 2, axis=0) / self.period_s**2
        return second


@dataclass(slots=True)
class Recorder:
    """Recorder of a track; call `fed` once before each `add`."""

    setting: str
    period_s: float
    _rows: list[tuple[Floats, Floats, list[float]]] = field(default_factory=list)
    _fed: list[tuple[list[float], list[float], float]] = field(default_factory=list)

    def fed(self, velocity_rad_s: list[float], torque_nm: list[float], computing_s: float) -> None:
        """Store what is sent with the next SYNC."""
        self._fed.append((velocity_rad_s, torque_nm, computing_s))

    def add(self, target_rad: Floats, sample: ArmSample) -> None:
        """Store the answer: the target that the drives had reached by then, and the readings."""
        torque = [float("nan") if reading is None else reading.torque_nm for reading in sample.readings]
        self._rows.append((target_rad, sample.q_rad, torque))

    def track(self) -> Track:
        """Return the recorded track."""
        count = len(self._rows)
        fed = self._fed[:count]
        target, measured, torque = (
            np.array([row[part] for row in self._rows], dtype=float).reshape(-1, 6) for part in range(3)
        )
        velocity, offset = (np.array([row[part] for row in fed], dtype=float).reshape(-1, 6) for part in range(2))
        computing = np.array([row[2] for row in fed], dtype=float)
        # readings that are missing, may be delayed, or are old ones
        missing: NDArray[np.bool_] = np.asarray(~np.isfinite(measured).all(axis=1))
        doubtful = missing.copy()
        for step in range(1, DOUBTFUL_ROWS + 1):
            doubtful[step:] |= missing[:-step]
        moved = np.abs(np.diff(target, axis=0, prepend=target[:1])).max(axis=1) > STALE_MOTION_RAD
        repeated = np.abs(np.diff(np.nan_to_num(measured), axis=0, prepend=np.inf)).max(axis=1) == 0.0
        measured = np.where((doubtful | (moved & repeated))[:, None], np.nan, measured)
        return Track(self.setting, self.period_s, target, measured, torque, velocity, offset, computing)


def following(track: Track, load: FedLoad | None = None) -> FollowedSetting:
    """Return the figures of one pass.

    Parameters
    ----------
    track : Track
    load : FedLoad, optional
        Load in the feedforward.

    Raises
    ------
    ValueError
        No row is complete.
    """
    error = track.error_rad
    known: NDArray[np.bool_] = np.asarray(np.isfinite(error).all(axis=1))
    if not known.any():
        raise ValueError("no SYNC was answered by every drive")
    rate = track.velocity_rad_s
    moving = (np.abs(rate) > STILL_RAD_S) & known[:, None]
    power = np.sum(np.where(moving, rate**2, 0.0), axis=0)
    lag = np.sum(np.where(moving, error * rate, 0.0), axis=0)
    return FollowedSetting(
        name=track.setting,
        load=load,
        peak_rad=numbers(np.abs(error[known]).max(axis=0)),
        rms_rad=numbers(np.sqrt((error[known] ** 2).mean(axis=0))),
        lag_s=numbers(np.divide(lag, power, out=np.full_like(lag, np.nan), where=power > 0)),
        overshoot_rad=numbers(_overshoot(track, known)),
    )


def _overshoot(track: Track, known: NDArray[np.bool_]) -> Floats:
    """Return the overshoot: largest position beyond the target in the direction of the last motion, over all rests."""
    sense = np.sign(np.diff(track.target_rad, axis=0, prepend=track.target_rad[:1]))
    rows = np.arange(len(sense))[:, None]
    last = np.maximum.accumulate(np.where(sense != 0, rows, 0), axis=0)
    led = np.take_along_axis(sense, last, axis=0)
    past = np.where((sense == 0) & known[:, None], -led * track.error_rad, 0.0)
    return np.maximum(past.max(axis=0), 0.0)
