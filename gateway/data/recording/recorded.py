"""Content of a recording in memory, and the measured table computed from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drives.scaling import Constants
from gateway.cell.config import ArmConfig, Cell
from gateway.cell.conversion import AxisConversion
from gateway.data.period import Period, harmonics_of
from gateway.data.recording.moving_rows import period_rows, torque_delay_s
from gateway.data.rest_pose import RestPose
from gateway.data.rows import Table, concatenate
from gateway.data.visit import Visit
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
            tau_std_nm=np.array([_std(samples) for samples in joint]).reshape(shape),
            count=np.array([len(visit) for visit in visits], dtype=int),
            q2nd_rad=blank,
            temperature_c=np.array(
                [blank[0] if visit.temperature_c is None else visit.temperature_c for visit in visits]
            ).reshape(shape),
            motor_torque_nm=motor,
            extra={"x_validation": np.array([float(visit.purpose == "validation") for visit in visits])},
        )


def _std(samples: np.ndarray) -> np.ndarray:
    return samples.std(axis=0, ddof=1) if len(samples) > 1 else np.full(samples.shape[1], np.nan)


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
