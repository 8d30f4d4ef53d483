"""Definition of an effect: name, texts, where it is searched for, and the quantity that its page shows it over."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.motion import MovingRows
from gateway.model.term import Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


class Over(Enum):
    """What an effect is drawn over: the one quantity that it is a function of, or itself where there is none."""

    ANGLE = "angle"
    TORQUE = "torque"
    TORQUE_BY_DIRECTION = "torque by direction"
    SPEED = "speed"
    TIME = "time"
    ITSELF = "itself"


@dataclass(frozen=True, slots=True, eq=False)
class RestSetup:
    """What candidates at rest depend on besides the visits.

    Attributes
    ----------
    gear_ratio : N gear ratios, NaN where unknown
    common_scale : whether a load or the links are known, so that a common torque scale can be seen
    torque_nm : (n, N) modelled torque of the model without effects
    links : (4 N,) links [m, hx, hy, hz] as the robot model has them, NaN where it says nothing; None = not known
    """

    gear_ratio: tuple[float, ...]
    common_scale: bool
    torque_nm: Floats
    links: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MotionSetup:
    """What candidates in motion depend on besides the rows.

    Attributes
    ----------
    drawn : whether anything is known of the links
    loads : labels of the loads that are fitted
    residual_nm : (n, N) what the present model leaves
    """

    drawn: bool
    loads: tuple[str, ...]
    residual_nm: Floats


def nowhere(rows: object, setup: object) -> Iterable[Term]:
    """An effect that these rows cannot show as a term."""
    return ()


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that a model of an arm may lack.

    Attributes
    ----------
    name : as the result file calls it
    words : what a report calls it, in the middle of a sentence
    meaning : one line for the table of effects
    parameters : keys that its shapes report, with unit
    over : what it is drawn over
    at_rest, in_motion : candidates that the rows could show, every place and shape
    by_residual : whether the candidates in motion are read off the residual, again at each step
    drawn : whether a wrong drawing of the links can imitate it
    friction : whether it is friction, which has many shapes in any gear
    mistake : what is wrong and what to do, of a commissioning mistake
    told : words for parameters whose key does not say what they are
    """

    name: str
    words: str
    meaning: str
    parameters: tuple[str, ...] = ()
    over: Over = Over.ITSELF
    at_rest: Callable[[Visits, RestSetup], Iterable[Term]] = nowhere
    in_motion: Callable[[MovingRows, MotionSetup], Iterable[Term]] = nowhere
    by_residual: bool = False
    drawn: bool = False
    friction: bool = False
    mistake: tuple[str, str] | None = None
    told: Mapping[str, str] = field(default_factory=dict)


def measured_axes(rows: Visits) -> list[int]:
    """Axes, from 0, whose torque was measured at rest."""
    return [int(axis) for axis in np.flatnonzero(np.isfinite(rows.sum_nm).any(axis=0))]


def moving_axes(motion: MovingRows) -> list[int]:
    """Axes, from 0, that are measured and move."""
    return [int(axis) for axis in np.flatnonzero(motion.measured)]


def largest_torque_nm(setup: RestSetup) -> Floats:
    """Largest modelled torque (N,) of each axis, above 0."""
    return np.maximum(np.abs(setup.torque_nm).max(axis=0), LEAST_NM)


#: Below what any axis of an arm needs [Nm]; keeps a scale above 0.
LEAST_NM: Final = 1e-6
