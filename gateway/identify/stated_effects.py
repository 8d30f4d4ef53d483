"""Torque of an arm at rest with the effects that a result states.

A result holds the parameters that an effect reports, not those it was fitted by. Each effect of the library that has
the same keys is solved for the parameters that report the stated ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gateway.errors import DataUnusable
from gateway.model.effect import RestSetup
from gateway.model.effects import terms_at_rest
from gateway.model.effects.torque_ripple import TorqueRipple
from gateway.model.rest import AlteredModel, neutral
from gateway.model.term import Term
from gateway.model.visits import Gears, visits_at
from gateway.result.result import EffectResult

Floats = NDArray[np.float64]
Stated = tuple[Term, Floats]

#: Effects that act at rest in the same way in any later run.
LASTING: Final = frozenset(
    (
        "joint_zero_offset",
        "torque_constant_scale",
        "torque_offset",
        "load_dependent_friction",
        "balancer_spring",
        "cable_torque",
        "joint_elasticity",
        "torque_ripple",
        "axis_coupling",
        "link_mass",
    )
)
#: Effects whose torque at rest is a part of the unloaded arm's own offsets.
IN_OFFSETS: Final = frozenset(("static_friction",))
#: Effects of parts that the arm has: a spring, a cable, a body on a link.
OF_PARTS: Final = frozenset(("balancer_spring", "cable_torque", "link_mass"))
#: Largest relative deviation of what is reported from what is stated.
SAME: Final = 1e-6


def stated_terms(effects: Iterable[EffectResult], gears: Gears, axes: int) -> tuple[Stated, ...]:
    """Terms and their parameters for the effects of a result.

    Raises
    ------
    DataUnusable
        An effect that changes with time, is a mistake to correct first, or is not determined by what is stated.
    """
    found = []
    for effect in effects:
        if effect.name in IN_OFFSETS:
            continue
        if effect.name not in LASTING:
            raise DataUnusable(
                f"the result holds the effect {effect.name}, which does not stay as it is or is to be corrected in the "
                "cell file: remove its cause, measure the unloaded arm and the load in one run, and estimate again"
            )
        solved = next(_solutions(effect, gears, axes), None)
        if solved is None:
            raise DataUnusable(
                f"the torque of the effect {effect.name} is not determined by the parameters that the result states; "
                "diagnose the recording again with this version"
            )
        found.append(solved)
    return tuple(found)


def with_stated(stated: Iterable[Stated], q_rad: Floats, gears: Gears) -> AlteredModel:
    """Return the setting at postures (n, N) in which these effects act and nothing else."""
    rows = visits_at(q_rad, gears)
    setting = neutral(*q_rad.shape)
    for term, theta in stated:
        setting = term.apply(setting, theta, rows)
    return setting


def _solutions(effect: EffectResult, gears: Gears, axes: int) -> Iterator[Stated]:
    """Terms and parameters that report what an effect states."""
    stated = {key: float(value) for key, value in effect.parameters.items()}
    for term in _candidates(effect, gears, axes):
        if term.label != (effect.name, tuple(effect.joints)):
            continue
        theta = _solved(term, stated)
        if theta is not None:
            yield term, theta


def _candidates(effect: EffectResult, gears: Gears, axes: int) -> Iterable[Term]:
    if effect.name == "torque_ripple":
        per_revolution = float(effect.parameters.get("per_revolution", np.nan))
        return [TorqueRipple(joint - 1, per_revolution) for joint in effect.joints]
    rows = visits_at(np.zeros((1, axes)), gears)
    setup = RestSetup((np.nan,) * axes, True, np.ones((1, axes)))
    return terms_at_rest(rows, setup, (effect.name,))


def _solved(term: Term, stated: Mapping[str, float]) -> Floats | None:
    """Parameters of a term that report the stated values; None where there are none."""
    begin = np.array([1.0 if linear else start for linear, start in zip(term.linear, term.start, strict=True)])
    if term.reported(begin).keys() != stated.keys():
        return None
    wanted = np.array(list(stated.values()))
    size = np.maximum(np.abs(wanted), SAME)

    def off(theta: Floats) -> Floats:
        reported = term.reported(theta)
        return np.nan_to_num((np.array([reported[key] for key in stated]) - wanted) / size, nan=1e3)

    # linear parameters differ by orders of magnitude from effect to effect: the largest stated value sets the scale
    for scale in (1.0, float(np.abs(wanted).max())):
        first = np.where(np.array(term.linear), scale * begin, begin)
        solved = least_squares(off, first, x_scale=np.maximum(np.abs(first), SAME), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.abs(solved.fun).max() < SAME:
            return solved.x
    return None
