"""Results of a fit in motion: loads with their inertia, and friction, rotor inertia and delay of each axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.identify.inertia import LoadInertia, is_body, load_inertia, nearest_body
from gateway.identify.load_estimate import (
    CONSTANTS,
    DRIFT,
    FRICTION,
    LINKS,
    LoadEstimate,
    budget_by_priors,
    load_from_moment,
)
from gateway.identify.motion.columns import NUISANCES
from gateway.identify.motion.moving_fit import FittedMotion, MotionFit
from gateway.identify.motion.prior import FALL, UNTOLD, Fall, shown_fall
from gateway.identify.prior_loads import load_functions
from gateway.identify.solve import determined
from gateway.model.robot import Robot, reach_m
from gateway.result.numerals import holds_zero
from gateway.result.result import AxisMotion, NuisanceResult

Floats = NDArray[np.float64]


def loads_of(found: FittedMotion, robot: Robot) -> tuple[LoadEstimate, ...]:
    """Return every estimated load, refused ones last."""
    fit = found.fit
    if fit is None:
        return found.refused
    columns = fit.columns
    shape = (10 if columns.inertia else 4, len(fit.value))
    known = {label: body[: shape[0]] for label, body in columns.known.items()}
    functions = load_functions(columns.loads, known, columns.parts, shape)
    fitted = (_load(fit, label, *function, reach_m(robot)) for label, function in functions.items())
    return (*fitted, *found.refused)


def _load(fit: MotionFit, label: str, function: Floats, constant: Floats, longest_m: float) -> LoadEstimate:
    """Mass, centre of gravity and inertia of one load, whose parameters are `function @ value + constant`."""
    columns, solution = fit.columns, fit.settled.solution
    value, covariance = function @ solution.value + constant, function @ fit.spread.covariance @ function.T
    found = determined(solution, function[:4])
    found[1:] &= found[0]
    moment, inertia = value[:4], None
    if columns.inertia and found[0]:
        moment, inertia = _body(value, covariance)
    part_of = columns.parts.get(label)
    load = load_from_moment(label, moment, covariance[:4, :4], np.ones(4), found, longest_m, part_of)
    if part_of is not None and not np.isfinite(load.com_m).all():
        inertia = None
    sources = {
        CONSTANTS: columns.nuisances.get("gain", np.zeros(0, dtype=int)),
        LINKS: columns.links,
        FRICTION: columns.friction,
        DRIFT: columns.changes.ravel(),
    }
    lead, variance = fit.settled.free.covariance @ function[0], float(covariance[0, 0])
    budget = budget_by_priors(lead, columns.prior.precision, sources, variance) if np.isfinite(load.mass_kg) else {}
    return replace(load, budget=budget, inertia=inertia if load.refused is None else None)


def _body(ten: Floats, covariance: Floats) -> tuple[Floats, LoadInertia | None]:
    """[m, h] (4,) and inertia of a load from its ten parameters; no inertia for a mass of zero."""
    if not ten[0] > 0 or holds_zero(float(ten[0]), float(np.sqrt(covariance[0, 0]))):
        return ten[:4], None
    body = nearest_body(ten, covariance)
    return body[:4], load_inertia(body, covariance, free=is_body(ten))


def nuisances(fit: MotionFit) -> dict[str, NuisanceResult]:
    """Gain and load friction of each axis for the result."""
    value, std = fit.value, fit.std
    out = {
        name: NuisanceResult(tuple(value[index].tolist()), tuple(std[index].tolist()))
        for name, index in fit.columns.nuisances.items()
        if name in NUISANCES
    }
    if "gain" in out:
        # a change of an axis's constant moves its gain by what the rows contribute to it: the rest is of the prior
        prior, covariance = fit.columns.prior.precision, fit.settled.free.covariance
        by_prior = covariance * prior if prior.ndim == 1 else covariance @ prior
        index = fit.columns.nuisances["gain"]
        out["gain"] = replace(out["gain"], response=tuple((1.0 - by_prior[index, index]).tolist()))
    return out


def axis_motions(fit: MotionFit, qd_rad_s: Floats) -> tuple[AxisMotion, ...]:
    """Friction, rotor inertia and delay of each axis that moved and was measured."""
    moved = sorted({part.axis for part in fit.problem.parts})
    return tuple(_axis_motion(fit, axis, np.abs(qd_rad_s[:, axis])) for axis in moved)


def _axis_motion(fit: MotionFit, axis: int, speed_rad_s: Floats) -> AxisMotion:
    columns, std, open_gain = fit.columns, fit.std, _open_gain(fit, axis)
    place = {name: k for k, name in enumerate(columns.names)}

    def identified(name: str) -> tuple[float, float]:
        k = place.get(f"{name}[J{axis + 1}]")
        if k is None or not std[k] <= UNTOLD * columns.prior.std[k]:
            return np.nan, np.nan
        return float(fit.value[k]), float(std[k])

    def torque(name: str) -> tuple[float, float]:
        value, own = identified(name)
        return value, float(np.hypot(own, value * open_gain))

    coulomb, viscous, rotor = torque("coulomb"), torque("viscous"), torque("rotor_inertia")
    loss, delay = identified("load_friction"), identified("delay")
    fall, breakaway = _breakaway(fit, axis) if np.isfinite(coulomb[0]) else (None, (np.nan, np.nan))
    return AxisMotion(
        joint=axis + 1,
        coulomb_nm=coulomb[0],
        coulomb_std_nm=coulomb[1],
        viscous_nm_s_rad=viscous[0],
        viscous_std_nm_s_rad=viscous[1],
        breakaway_nm=breakaway[0],
        breakaway_std_nm=float(np.hypot(breakaway[1], breakaway[0] * open_gain)),
        stribeck_rad_s=np.nan if fall is None else fall.speed_rad_s,
        load_friction=loss[0],
        load_friction_std=loss[1],
        rotor_inertia_kg_m2=rotor[0],
        rotor_inertia_std_kg_m2=rotor[1],
        delay_s=delay[0],
        delay_std_s=delay[1],
        speed_rad_s=float(speed_rad_s.max(initial=0.0)),
    )


def _open_gain(fit: MotionFit, axis: int) -> float:
    """Share by which the true torque at the gear output may differ from the reported one; friction is given as
    reported.
    """
    if "gain" not in fit.columns.nuisances:
        return 0.0
    k = fit.columns.nuisances["gain"][axis]
    return float(np.hypot(fit.value[k], np.sqrt(max(float(fit.spread.covariance[k, k]), 0.0))))


def _breakaway(fit: MotionFit, axis: int) -> tuple[Fall | None, tuple[float, float]]:
    """Stribeck fall of the friction, if significant, and the breakaway friction with its standard deviation [Nm]."""
    falls_rad_s = fit.columns.falls_rad_s[axis]
    if not len(falls_rad_s):
        return None, (np.nan, np.nan)
    names = [f"{FALL}_{k + 1}[J{axis + 1}]" for k in range(len(falls_rad_s))]
    at = np.array([fit.columns.names.index(name) for name in (f"coulomb[J{axis + 1}]", *names)])
    value, covariance = fit.value[at], fit.spread.covariance[np.ix_(at, at)]
    fall = shown_fall(value[1:], covariance[1:, 1:], falls_rad_s)
    if fall is None:
        return None, (np.nan, np.nan)
    complete = np.append(1.0, fall.shares)
    return fall, (float(value[0] + fall.size_nm), float(np.sqrt(max(complete @ covariance @ complete, 0.0))))
