"""Content of a recording in memory, and the measured table computed from it: visits at rest, periods in motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drives.errors import ProfileError
from drives.profile import DriveProfile
from drives.profile_file import parse_profile
from drives.scaling import Constants
from gateway.cell.config import ArmConfig, Cell
from gateway.cell.conversion import AxisConversion
from gateway.data.period import Period, harmonics_of
from gateway.data.periods import CUTOFF_HZ, EXCITATION, MOTION_HZ, PERIOD, PHASE_S, by_harmonics, by_low_pass
from gateway.data.rows import MOVING, Table, concatenate
from gateway.data.visit import RestPose, Visit
from gateway.errors import InputError

SIDES = (-1, 1)


@dataclass(frozen=True, slots=True, eq=False)
class ArmRecording:
    """Measurements of one arm.

    Attributes
    ----------
    name : str
    poses : tuple of RestPose
        Planned poses.
    visits : tuple of Visit
        In the order of measuring.
    periods : tuple of Period
        In the order of measuring.
    excitations : dict of int to dict
        Excitations of the periods by fingerprint, as plain values.
    constants : tuple of Constants
        Constants read from the drives; empty if the file lacks them.
    identities, ledger : lists of dict
    bus_statistics : dict
        Empty until the run has ended.
    """

    name: str
    poses: tuple[RestPose, ...]
    visits: tuple[Visit, ...]
    constants: tuple[Constants, ...]
    identities: list[Any]
    ledger: list[Any]
    bus_statistics: dict[str, Any]
    periods: tuple[Period, ...] = ()
    excitations: dict[int, dict[str, Any]] = field(default_factory=dict)

    def done(self, load: str) -> tuple[tuple[int, int], ...]:
        """Return (pose, approach) of the complete visits with a load."""
        return tuple((visit.pose, visit.approach) for visit in self.visits if visit.complete and visit.load == load)

    def missing(self, load: str) -> tuple[tuple[int, int], ...]:
        """Return (pose, approach) of the planned visits with a load that are not complete."""
        done = set(self.done(load))
        return tuple((pose.number, side) for pose in self.poses for side in SIDES if (pose.number, side) not in done)

    def driven(self, load: str) -> frozenset[tuple[int, float, int]]:
        """Return (excitation, speed, period) of the complete periods with a load."""
        return frozenset(
            (each.excitation, each.speed, each.period) for each in self.periods if each.complete and each.load == load
        )


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording in memory.

    Attributes
    ----------
    path : Path
    created, software, exit_status, reason : str
    cell : Cell
    cell_text, robot_text : str
        As stored; the robot text is empty for an arm defined by Denavit-Hartenberg parameters.
    profiles : dict of str to str
        Profile name -> TOML text.
    arms : tuple of ArmRecording
    calibration : str
        Text of the calibration file; empty where there was none.
    """

    path: Path
    created: str
    software: str
    exit_status: str
    reason: str
    cell: Cell
    cell_text: str
    robot_text: str
    profiles: dict[str, str]
    arms: tuple[ArmRecording, ...]
    calibration: str = ""

    def arm(self, name: str) -> ArmRecording | None:
        """Return the arm of that name, None if the recording has no data of it."""
        return next((arm for arm in self.arms if arm.name == name), None)

    @property
    def loads(self) -> tuple[str, ...]:
        """Labels of the loads, in measurement order."""
        return tuple(dict.fromkeys(each.load for arm in self.arms for each in (*arm.visits, *arm.periods)))

    def table(self, arm: str | None = None) -> Table:
        """Return the measured table: per pose and load one sample per approach direction; one per SYNC of a complete
        period.

        The sample of a visit contains the means over its readings.

        Parameters
        ----------
        arm : str, optional
            All arms if not given.

        Raises
        ------
        InputError
            No complete visit or period.
        """
        chosen = [part for part in self.arms if arm in (None, part.name)]
        parts = [part for part in map(self._arm_table, chosen) if len(part)]
        parts += [rows for part in chosen for rows in self._moving_rows(part)]
        if not parts:
            raise InputError(
                f"{self.path}: contains no complete visit and no complete period; measure again, or complete it with"
                " record --resume"
            )
        return concatenate(parts)

    def _moving_rows(self, arm: ArmRecording) -> list[Table]:
        config = arm_config(self.cell, arm.name, str(self.path))
        axes = AxisConversion.from_arm(config)
        delay_s = torque_delay_s(config, self.profiles, str(self.path)) if arm.periods else 0.0
        return [
            period_rows(
                each,
                axes.joint_torque(each.motor_torque_nm),
                self.path,
                harmonics_of(arm.excitations[each.excitation]),
                delay_s,
            )
            for each in arm.periods
            if each.complete
        ]

    def _arm_table(self, arm: ArmRecording) -> Table:
        visits = [visit for visit in arm.visits if visit.complete]
        axes = AxisConversion.from_arm(arm_config(self.cell, arm.name, str(self.path)))
        n_rows = len(visits)
        shape = (n_rows, len(axes.ratio))
        blank = np.full(shape, np.nan)
        motor = np.array([visit.motor_torque_nm.mean(axis=0) for visit in visits]).reshape(shape)
        joint = [axes.joint_torque(visit.motor_torque_nm) for visit in visits]
        return Table(
            file=(str(self.path),) * n_rows,
            line=np.array([visit.number for visit in visits], dtype=int),
            run=np.array([self.path.stem] * n_rows, dtype=str),
            load=np.array([visit.load for visit in visits], dtype=str),
            pose=np.array([visit.pose for visit in visits], dtype=int),
            time_s=np.array([visit.time_s[0] for visit in visits]),
            q_rad=np.array([visit.q_rad.mean(axis=0) for visit in visits]).reshape(shape),
            qd_rad_s=np.zeros(shape),
            qdd_rad_s2=np.zeros(shape),
            moving=np.zeros(n_rows, dtype=bool),
            direction=np.array([visit.direction for visit in visits], dtype=np.int8).reshape(shape),
            tau_nm=axes.joint_torque(motor),
            tau_std_nm=np.array(
                [samples.std(axis=0, ddof=1) if len(samples) > 1 else blank[0] for samples in joint]
            ).reshape(shape),
            count=np.array([len(visit) for visit in visits], dtype=int),
            q2nd_rad=blank,
            temperature_c=np.array(
                [blank[0] if visit.temperature_c is None else visit.temperature_c for visit in visits]
            ).reshape(shape),
            motor_torque_nm=motor,
            extra={"x_validation": np.array([float(visit.purpose == "validation") for visit in visits])},
        )


def arm_config(cell: Cell, name: str, where: str) -> ArmConfig:
    """Return the arm of a cell by name.

    Raises
    ------
    InputError
        There is none.
    """
    for arm in cell.arm:
        if arm.name == name:
            return arm
    raise InputError(f"{where}: contains visits of arm '{name}', which its cell file does not have")


def torque_delay_s(config: ArmConfig, profiles: Mapping[str, str], where: str) -> float:
    """Return the mean delay [s] of the drives' torque words behind their positions, as the profiles state it.

    A first-order filter delays by its time constant. The estimation identifies the deviation of each axis from the
    mean.

    Raises
    ------
    InputError
        A profile is missing or cannot be used.
    """
    return float(np.mean([profile.torque.filter_s for profile in parsed_profiles(config, profiles, where)]))


def parsed_profiles(config: ArmConfig, profiles: Mapping[str, str], where: str) -> list[DriveProfile]:
    """Return the profile of each axis, from texts by name.

    Raises
    ------
    InputError
        A profile is missing or cannot be used.
    """
    parsed: dict[str, DriveProfile] = {}
    for name in dict.fromkeys(axis.profile for axis in config.axis):
        text = profiles.get(name)
        if not isinstance(text, str):
            raise InputError(f"{where}: the file contains no profile '{name}'")
        try:
            parsed[name] = parse_profile(text, name)
        except ProfileError as error:
            raise InputError(f"{where}: {error}") from error
    return [parsed[axis.profile] for axis in config.axis]


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
        run=np.array([path.stem] * n),
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
