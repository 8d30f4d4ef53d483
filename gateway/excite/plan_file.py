"""A plan of motions as a JSON file: sealed, so that what was checked is what is driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gateway.errors import InputError
from gateway.excite.excitation import Excitation, MovingPlan, Series
from gateway.result.seal import KEY, refuse_edited, sealed
from gateway.result.values import Matrix, Numbers, check_kind, decoded, json_object, plain_values, text_of

SCHEMA: Final = 1
KIND: Final = "moving_plan"
_ADVICE: Final = "name the JSON that `plan CELL --moving --json OUT.json` wrote"
_AGAIN: Final = "with servo-gateway plan CELL --moving --json OUT.json"
#: More harmonics or periods than any plan has.
_MOST: Final = 1000


def plan_as_plain(plan: MovingPlan) -> dict[str, Any]:
    """A plan as plain values, with its checksum."""
    excitations = [excitation.plain() for excitation in plan.excitations]
    head = {"schema": SCHEMA, "kind": KIND, "arm": plan.arm}
    return sealed(plain_values(head | {"excitations": excitations, "expected": plan.expected}))


def read_moving_plan(path: Path) -> MovingPlan:
    """The plan that `plan --moving --json` wrote; whether an arm may drive it is not looked at.

    Raises
    ------
    InputError
        It cannot be read, is of another kind, holds a motion that is none, or was edited since.
    """
    where = str(path)
    data = json_object(text_of(path, _ADVICE), where)
    check_kind(data, SCHEMA, KIND, where)
    if KEY not in data:
        raise InputError(f"{where}: carries no {KEY}: nobody has checked what it says; write it {_AGAIN}")
    refuse_edited(data, where, _AGAIN)
    held = decoded(_Plan, data, where)
    if not held.excitations:
        raise InputError(f"{where}: holds no motion; write it {_AGAIN}")
    excitations = [excitation_of(each, f"{where}: excitations[{row}]") for row, each in enumerate(held.excitations)]
    return MovingPlan(held.arm, tuple(excitations), held.expected)


def excitation_of(plain: Mapping[str, Any], where: str) -> Excitation:
    """An excitation as `Excitation.plain` gave it.

    Raises
    ------
    InputError
        A key is missing or of the wrong kind, or it does not begin and end at rest.
    """
    if plain.get("kind") != "series":
        raise InputError(f"{where}: kind: {plain.get('kind')!r} is not 'series'")
    held = decoded(_Series, plain, where)
    start, cosine, sine = np.array(held.start_rad), _matrix(held.cosine_rad), _matrix(held.sine_rad)
    if cosine.shape != sine.shape or cosine.ndim != 2 or len(cosine) != len(start) or not 1 < cosine.shape[1] < _MOST:
        raise InputError(f"{where}: cosine_rad and sine_rad: a row of two and more numbers is needed for each joint")
    series = Series(held.name, start, cosine, sine, held.period_s, held.periods)
    _refuse_counts(held.period_s, held.periods, where)
    if not all(np.isfinite(values).all() for values in (start, cosine, sine)):
        raise InputError(f"{where}: a coefficient is no finite number")
    _refuse_moving_start(series, where)
    return series


def _matrix(rows: Matrix) -> np.ndarray:
    return np.array(rows) if len({len(row) for row in rows}) == 1 else np.zeros(0)


def _refuse_counts(period_s: float, periods: int, where: str) -> None:
    if not (0.0 < period_s < np.inf and 1 <= periods <= _MOST):
        raise InputError(f"{where}: period_s and periods: positive numbers are needed")


def _refuse_moving_start(series: Series, where: str) -> None:
    """Speed and acceleration at the start, which are rounding where the file was not made by hand."""
    _, speed, acceleration, _ = series.at(np.zeros(1))
    _, most_speed, most_acceleration, _ = series.at(np.linspace(0.0, series.period_s, 64))
    for what, value, most in (("speed", speed, most_speed), ("acceleration", acceleration, most_acceleration)):
        if np.abs(value).max() > 1e-6 * np.abs(most).max():
            raise InputError(f"{where}: does not start at rest: its {what} at the start of a period is not zero")


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
