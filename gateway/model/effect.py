"""Definition of an effect: name, texts, candidate generators, and the quantity over which its page plots it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.motion import MovingRows
from gateway.model.robot import Robot
from gateway.model.term import Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]


class Over(Enum):
    """Quantity over which an effect is plotted: the quantity that it is a function of, or its own size."""

    ANGLE = "angle"
    TORQUE = "torque"
    TORQUE_BY_DIRECTION = "torque by direction"
    SPEED = "speed"
    TIME = "time"
    ITSELF = "itself"


@dataclass(frozen=True, slots=True, eq=False)
class RestSetup:
    """Context for candidates at rest, in addition to the visits.

    Attributes
    ----------
    gear_ratio : N gear ratios, NaN where unknown
    common_scale : a load or the links are known, so that a common torque scale is identifiable
    torque_nm : (n, N) modelled torque of the model without effects
    links : (4 N,) links [m, hx, hy, hz] of the robot model, NaN where it has no value; None = not known
    robot : gives the plausible size of a body on a link; None = any size
    """

    gear_ratio: tuple[float, ...]
    common_scale: bool
    torque_nm: Floats
    links: Floats | None = None
    robot: Robot | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MotionSetup:
    """Context for candidates in motion, in addition to the samples.

    Attributes
    ----------
    drawn : the robot model has link masses
    loads : labels of the loads that are fitted
    residual_nm : (n, N) residual of the present model
    """

    drawn: bool
    loads: tuple[str, ...]
    residual_nm: Floats


def nowhere(rows: object, setup: object) -> Iterable[Term]:
    """Return no candidates: for an effect that these samples cannot show."""
    return ()


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect that a model of an arm may lack.

    Attributes
    ----------
    name : name in the result file
    words : name in a report, within a sentence
    meaning : one line for the table of effects
    parameters : keys that its terms report, with unit
    over : quantity over which it is plotted
    at_rest, in_motion : functions that return the candidates for the samples, at every location and in every form
    by_residual : candidates in motion are derived from the residual, again at each step
    drawn : wrong link parameters of the robot model can imitate it
    by_odds : the odds alone decide it, not left-out samples
    friction : it is friction, which has many forms in a gear
    mistake : error and corrective action, for a commissioning mistake
    parameter_texts : descriptions of parameters whose key is not self-explanatory
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
    by_odds: bool = False
    friction: bool = False
    mistake: tuple[str, str] | None = None
    parameter_texts: Mapping[str, str] = field(default_factory=dict)


def measured_axes(rows: Visits | MovingRows) -> list[int]:
    """Return the axes (from 0) whose torque was measured; in motion those that move."""
    return np.flatnonzero(rows.measured).tolist()


def on_each_axis(term: Callable[[int], Term]) -> Callable[[Visits | MovingRows, object], Iterable[Term]]:
    """Return the generator of one candidate on each measured axis."""
    return lambda rows, setup: map(term, measured_axes(rows))


def largest_torque_nm(setup: RestSetup) -> Floats:
    """Return the largest modelled torque (N,) of each axis, always above 0."""
    return np.maximum(np.abs(setup.torque_nm).max(axis=0), LEAST_NM)


#: Lower limit of a torque scale [Nm], below the torque of any axis.
LEAST_NM: Final = 1e-6
