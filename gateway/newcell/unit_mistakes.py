"""Detect unit errors in answers: values that the cell file refuses are refused at the input."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from typing import Any, Final

from gateway.cell import plausible
from gateway.cell.plausible import Found, beyond, speeds
from gateway.model.load_bounds import LoadBounds
from gateway.newcell import questions

Check = Callable[[Any], Iterable[Found]]

_CHECKS: Final[Mapping[str, Check]] = {
    questions.GEAR_RATIO.key: lambda values: map(plausible.ratio, values),
    questions.POSITION_LIMIT.key: lambda pairs: (beyond("joint angle", "position_limit_rad", *pair) for pair in pairs),
    questions.ZERO_OFFSET.key: lambda values: [beyond("joint angle", "zero_offset_rad", *values)],
    questions.SPEED_LIMIT.key: lambda values: [speeds(values)],
    questions.FLANGE.key: lambda values: [beyond("length", "flange_xyz_m", *values)],
    questions.FLANGE_TURN.key: lambda values: [beyond("angle of a frame", "flange_rpy_rad", *values)],
    questions.MOUNTING.key: lambda values: [plausible.gravity(values)],
    questions.TORQUE_LIMIT.key: lambda values: (beyond("torque", "torque_limit_nm", v) for v in values),
    "dh_alpha_rad": lambda values: [beyond("joint angle", "dh_alpha_rad", *values)],
    "dh_theta_offset_rad": lambda values: [beyond("joint angle", "dh_theta_offset_rad", *values)],
    "dh_a_m": lambda values: [beyond("length", "dh_a_m", *values)],
    "dh_d_m": lambda values: [beyond("length", "dh_d_m", *values)],
}


def slips(key: str, value: Any, ratio: Iterable[float], bounds: LoadBounds) -> Iterator[str]:
    """Return the error of an answer and a proposed correction; empty if it is plausible.

    Parameters
    ----------
    key : str
        Key of the question.
    value
        Value in the format of the question.
    ratio : iterable of float
        Known gear ratios, for the check of a torque constant.
    bounds : LoadBounds
        Largest plausible load, if known.
    """
    if key in (questions.RATED_LOAD.key, questions.MAX_LOAD.key):
        wrong = "" if value is None else bounds.violation(value, ())
        if wrong:
            yield f"{key}: {wrong}"
        return
    if key == questions.TORQUE_CONSTANT.key:
        found = [plausible.torque_constant(each, gear) for each, gear in zip(value, ratio, strict=False)]
    else:
        found = _CHECKS[key](value) if key in _CHECKS else []
    yield from (message for _, message in chain.from_iterable(found))
