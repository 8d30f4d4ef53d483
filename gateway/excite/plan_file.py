"""Plan of excitation trajectories as a JSON file with a checksum, so that only a checked plan is driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gateway.errors import InputError
from gateway.excite.excitation import Excitation, MovingPlan, Series
from gateway.excite.sweep_choice import Sweep
from gateway.result.origin import KEY, refuse_edited, sealed
from gateway.result.values import Matrix, Numbers, check_kind, decoded, json_object, plain_values, text_of

SCHEMA: Final = 1
KIND: Final = "moving_plan"
_ADVICE: Final = "name the file that `plan CELL -o PLAN.json` wrote"
_AGAIN: Final = "with servo-gateway plan CELL --moving -o PLAN.json"
#: More harmonics or periods than any plan has.
_MOST: Final = 1000


def plan_as_plain(plan: MovingPlan) -> dict[str, Any]:
    """Return a plan as plain values with its checksum."""
    excitations = [excitation.plain() for excitation in plan.excitations]
    head = {"schema": SCHEMA, "kind": KIND, "arm": plan.arm}
    return sealed(plain_values(head | {"excitations": excitations, "expected": plan.expected}))


def is_moving_plan(path: Path) -> bool:
    """Return whether a plan file holds excitation trajectories, and not rest poses.

    Raises
    ------
    InputError
        The file cannot be read, or is not JSON.
    """
    return json_object(text_of(path, _ADVICE), str(path)).get("kind") == KIND


def read_moving_plan(path: Path) -> MovingPlan:
    """Read the plan that `plan --moving -o` wrote, without checking it for an arm.

    Raises
    ------
    InputError
        The file cannot be read, is of another kind, holds an invalid motion, or was edited.
    """
    where = str(path)
    data = json_object(text_of(path, _ADVICE), where)
    check_kind(data, SCHEMA, KIND, where)
    if KEY not in data:
        raise InputError(f"{where}: has no {KEY}, so its content is not verified; write it {_AGAIN}")
    refuse_edited(data, where, _AGAIN)
    held = decoded(_Plan, data, where)
    if not held.excitations:
        raise InputError(f"{where}: holds no motion; write it {_AGAIN}")
    excitations = [excitation_of(each, f"{where}: excitations[{row}]") for row, each in enumerate(held.excitations)]
    return MovingPlan(held.arm, tuple(excitations), held.expected)


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
class _Plan:
    arm: str
    excitations: tuple[dict[str, Any], ...]
    expected: dict[str, Any]


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
