"""Plan files of rest poses or excitation trajectories: JSON with a checksum, so that only a checked plan is driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from gateway.cell.config import ArmConfig
from gateway.data.visit import Purpose
from gateway.errors import InputError
from gateway.excite.excitation import Excitation, MovingPlan, Series
from gateway.excite.sweep_choice import Sweep
from gateway.result.names import SILENT
from gateway.result.origin import read_sealed, sealed
from gateway.result.values import NAN, Matrix, Number, Numbers, decoded, plain_values

SCHEMA: Final = 1
_AGAIN: Final = "with servo-gateway plan CELL -o PLAN.json"
#: More harmonics or periods than any plan has.
_MOST: Final = 1000


def plan_as_plain(plan: MovingPlan) -> dict[str, Any]:
    """Return a plan of excitation trajectories as plain values with its checksum."""
    excitations = tuple(excitation.plain() for excitation in plan.excitations)
    return PlanFile(plan.arm, "moving_plan", excitations=excitations, expected=plan.expected).as_plain()


def read_plan(path: Path, config: ArmConfig) -> PlanFile | MovingPlan:
    """Read the plan of an arm that `plan -o` wrote, without checking it against the limits of the arm.

    Raises
    ------
    InputError
        The file cannot be read, is of another kind or arm, was edited, or holds no pose and no valid motion.
    """
    where = str(path)
    plan = decoded(PlanFile, read_sealed(path, SCHEMA, _AGAIN, "rest_plan", "moving_plan"), where)
    is_moving = plan.kind == "moving_plan"
    motions = [excitation_of(each, f"{where}: excitations[{row}]") for row, each in enumerate(plan.excitations)]
    if not motions and (is_moving or not plan.duration_s > 0.0 or all(pose.purpose != "fit" for pose in plan.poses)):
        raise InputError(f"{where}: holds no motion, and no duration and pose with purpose 'fit'; write it {_AGAIN}")
    axes = {len(motion.start_rad) for motion in motions} | {len(pose.q_rad) for pose in plan.poses}
    if plan.arm != config.name or axes != {len(config.axis)}:
        raise InputError(
            f"{where}: is a plan for arm '{plan.arm}' with {' or '.join(map(str, sorted(axes)))} axes, not for "
            f"'{config.name}' with {len(config.axis)}; write it {_AGAIN}"
        )
    return MovingPlan(plan.arm, tuple(motions), dict(plan.expected or {})) if is_moving else plan


def excitation_of(plain: Mapping[str, Any], where: str) -> Excitation:
    """Return the excitation from the values that `Excitation.plain` returned.

    Raises
    ------
    InputError
        A key is missing or of the wrong kind, or the motion does not begin and end at rest.
    """
    kind = plain.get("kind")
    if kind == "series":
        held = decoded(_Series, plain, where)
        _refuse_numbers((held.start_rad, *held.cosine_rad, *held.sine_rad), (held.period_s,), held.periods, where)
        start, cosine, sine = np.array(held.start_rad), _matrix(held.cosine_rad), _matrix(held.sine_rad)
        same = cosine.shape == sine.shape and cosine.ndim == 2 and len(cosine) == len(start)
        if not same or not 1 < cosine.shape[1] < _MOST:
            raise InputError(f"{where}: cosine_rad and sine_rad: each joint needs a row of at least two numbers")
        series = Series(held.name, start, cosine, sine, held.period_s, held.periods)
        _, speed, acceleration, _ = series.at(np.zeros(1))
        _, most_speed, most_acceleration, _ = series.at(np.linspace(0.0, series.period_s, 64))
        for what, value, most in (("speed", speed, most_speed), ("acceleration", acceleration, most_acceleration)):
            if np.abs(value).max() > 1e-6 * np.abs(most).max():
                raise InputError(f"{where}: does not start at rest: its {what} at the start of a period is not zero")
        return series
    if kind != "sweep":
        raise InputError(f"{where}: kind: {kind!r} must be 'series' or 'sweep'")
    held = decoded(_Sweep, plain, where)
    positive = (*held.speeds_rad_s, held.acceleration_rad_s2, held.jerk_rad_s3)
    _refuse_numbers((held.start_rad, held.ends_rad), positive, held.periods, where)
    if not 1 <= held.joint <= len(held.start_rad):
        raise InputError(f"{where}: joint: {held.joint} does not exist, the arm has {len(held.start_rad)} joints")
    if not held.speeds_rad_s or len(held.speeds_rad_s) != len(held.ends_rad):
        raise InputError(f"{where}: speeds_rad_s and ends_rad: one end for each of the speeds is needed")
    start, ends = np.array(held.start_rad), np.array(held.ends_rad)
    if (ends == start[held.joint - 1]).any():
        raise InputError(f"{where}: ends_rad: a stroke must not end in its start posture")
    return Sweep(
        held.name, held.joint, start, np.array(held.speeds_rad_s), ends,
        held.acceleration_rad_s2, held.jerk_rad_s3, held.periods,
    )  # fmt: skip


def _matrix(rows: Matrix) -> np.ndarray:
    return np.array(rows) if len({len(row) for row in rows}) == 1 else np.zeros(0)


def _refuse_numbers(lists: Matrix, positive: Numbers, periods: int, where: str) -> None:
    """Refuse values that are not finite, durations and limits that are not positive, and a wrong number of periods."""
    if not all(np.isfinite(each).all() for each in lists):
        raise InputError(f"{where}: a joint angle or a coefficient is not a finite number")
    if not all(0.0 < value < np.inf for value in positive) or not 1 <= periods <= _MOST:
        raise InputError(f"{where}: periods, durations, speeds and limits: positive numbers are needed")


@dataclass(frozen=True, slots=True)
class PlannedPose:
    """Rest pose of a plan file: number in the plan, purpose, joint angles [rad]."""

    pose: int
    purpose: Purpose
    q_rad: Numbers


@dataclass(frozen=True, slots=True)
class PlanFile:
    """Content of a plan file: rest poses, or the plain values of excitation trajectories.

    Attributes
    ----------
    arm, kind : str
    poses : tuple of PlannedPose
        In the order in which they are measured.
    duration_s : float
        Expected duration of a run of rest poses under one load.
    excitations : tuple of dict
    expected : dict or None
        Expected uncertainty, for the operator.
    distinguish : dict
        As `Plan.distinguish`.
    """

    arm: str
    kind: Literal["rest_plan", "moving_plan"]
    poses: tuple[PlannedPose, ...] = field(default=(), metadata=SILENT)
    duration_s: Number = field(default=NAN, metadata=SILENT)
    excitations: tuple[dict[str, Any], ...] = field(default=(), metadata=SILENT)
    expected: Mapping[str, Any] | None = None
    distinguish: Mapping[str, Any] = field(default_factory=dict, metadata=SILENT)
    schema: int = SCHEMA

    def as_plain(self) -> dict[str, Any]:
        """Return the plain values of the file, with their checksum."""
        return sealed(plain_values(self))


@dataclass(frozen=True, slots=True)
class _Series:
    name: str
    start_rad: Numbers
    cosine_rad: Matrix
    sine_rad: Matrix
    period_s: float
    periods: int


@dataclass(frozen=True, slots=True)
class _Sweep:
    name: str
    joint: int
    start_rad: Numbers
    speeds_rad_s: Numbers
    ends_rad: Numbers
    acceleration_rad_s2: float
    jerk_rad_s3: float
    periods: int
