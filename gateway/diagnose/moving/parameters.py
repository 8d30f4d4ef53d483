"""Conversion of fitted coefficients to the parameters of the result file, with standard deviations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.penalised_fit import MovingFit, MovingProblem, fit
from gateway.diagnose.moving.select import coupling_cost
from gateway.diagnose.moving.trial import MovingState, Trial, extend, spread_of
from gateway.identify.spread import jackknife, wider
from gateway.model.effects.axis_coupling import MotorCoupling
from gateway.model.effects.current_rms_peak import EFFECT as RMS_PEAK
from gateway.model.effects.current_rms_peak import is_rms_peak
from gateway.model.effects.velocity_friction import FRACTIONS, Stribeck
from gateway.model.term import Named, Term

Floats = NDArray[np.float64]

#: Relative step [-] of a derivative by differences.
STEP = 1e-3
#: How near to an end of its range a parameter is at the edge, as a share of the range.
EDGE = 0.02
#: Ranges of shapes that are kept off 0 and 1 by their form.
SHARES = {"lever_ratio": (0.0, 1.0), "gas_stroke": (0.0, 0.97)}
#: Standard deviation of a decay between those that are tried, a factor of 2 apart, as a share of it.
STEP_SHARE = 0.2


def parameters_of(problem: MovingProblem, state: MovingState, terms: Sequence[Term]) -> tuple[str, Named, Named]:
    """Name, parameters and standard deviations of an effect that consists of `terms`."""
    first = terms[0]
    values, std = _law(problem, state, first) if first.with_friction else ({}, {})
    for term in terms:
        more, spread = term.report(*_with_shape(problem, state, term))
        values, std = values | more, std | spread
    for term in terms:
        if isinstance(term, Stribeck):
            std = _over_decays(problem, state, term, values, std)
    if isinstance(first, MotorCoupling):
        # Standard deviation of the coefficient from the curvature of the cost
        centre, step = first.coefficient, 0.1
        others = [other for other in state.terms if other != first]
        low, middle, high = (
            coupling_cost(problem, others, first, centre * (1.0 + move)) for move in (-step, 0.0, step)
        )
        curvature = (low + high - 2.0 * middle) / (step * centre) ** 2
        std["coefficient"] = float(np.sqrt(2.0 / curvature)) if curvature > 0 else abs(centre) * step
    if first.scales_reading and is_rms_peak(values["scale"], std["scale"]):
        scale = values["scale"]
        return RMS_PEAK.name, {"factor": 1.0 / scale}, {"factor": std["scale"] / scale**2}
    return first.name, values, std | dict.fromkeys(at_edge(problem, terms, values), np.nan)


def at_edge(problem: MovingProblem, terms: Sequence[Term], values: Named) -> list[str]:
    """Names of parameters at a limit of the tried or plausible range; the true value may be beyond."""
    found = []
    for term in terms:
        if isinstance(term, Stribeck):
            share = term.decay_rad_s / float(problem.motion.speed_rad_s[term.axis])
            if not FRACTIONS[0] * (1.0 + EDGE) < share < FRACTIONS[-1] * (1.0 - EDGE):
                found.append("stribeck_velocity_rad_s")
        limits = SHARES | dict(term.bounds)
        for key, (low, high) in limits.items():
            edge = EDGE * (high - low)
            if key in values and not low + edge < values[key] < high - edge:
                found.append(key)
    return found


def _over_decays(problem: MovingProblem, state: MovingState, term: Stribeck, values: Named, std: Named) -> Named:
    """Standard deviations including that of the decay, averaged over the tried decays by their likelihood."""
    motion, others = problem.motion, [other for other in state.terms if other != term]
    index = problem.null.friction[term.axis, :2]
    keys = ("coulomb_nm", "viscous_nm_s_rad", "stribeck_nm", "stribeck_velocity_rad_s")
    costs, found = [], []
    for share in FRACTIONS:
        member = Stribeck(term.axis, share * float(motion.speed_rad_s[term.axis]))
        one = fit(problem, (*others, member), ~motion.held_out, motion.held_out, state.full)
        costs.append(one.cost)
        found.append([*one.value[index], one.value[-1], member.decay_rad_s])
    weight = np.exp(-0.5 * (np.array(costs) - min(costs)))
    off = np.array(found) - np.array([values[key] for key in keys])
    spread = weight @ off**2 / weight.sum()
    spread[-1] += (STEP_SHARE * term.decay_rad_s) ** 2
    return std | {
        key: float(np.hypot(std.get(key, 0.0), np.sqrt(more))) for key, more in zip(keys, spread, strict=True)
    }


def figures_of(trial: Trial) -> tuple[Named, Named]:
    """Parameters and standard deviations of a tried effect, in the tried shape."""
    term = trial.term
    covariance = np.zeros((len(term.linear),) * 2)
    covariance[: term.count, : term.count] = trial.covariance
    values, std = term.report(term.completed(trial.value), covariance)
    return values, {key: spread for key, spread in std.items() if spread > 0}


def certain(problem: MovingProblem, state: MovingState, terms: Sequence[Term]) -> bool:
    """Return True if a scale of a reading differs enough from 1 for a failing finding; True for other effects."""
    if not terms[0].scales_reading:
        return True
    _, parameters, std = parameters_of(problem, state, terms)
    return all(abs(parameters[key] - 1.0) > MOVING.certain_scale * std[key] for key in std)


def _law(problem: MovingProblem, state: MovingState, term: Term) -> tuple[Named, Named]:
    """Coulomb and viscous friction of the effect's axis."""
    index = problem.null.friction[term.joints[0] - 1, :2]
    covariance = spread_of(problem, state, index)
    names = ("coulomb_nm", "viscous_nm_s_rad")
    values = zip(names, state.full.value[index].tolist(), strict=True)
    return dict(values), dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))


def _with_shape(problem: MovingProblem, state: MovingState, term: Term) -> tuple[Floats, Floats]:
    """All parameters of a term with their covariance, including that of its shape."""
    index = state.full.part([term])
    if all(term.linear):
        return state.full.value[index], spread_of(problem, state, index)
    at, precision = np.array(term.start[term.count :]), np.array(term.spread[term.count :]) ** -2.0
    axes = list(term.enters(problem.motion.axes))
    slopes = _slopes(problem, state.full, term, state.full.value[index])
    extended = [extend(fit, axes, slopes, precision) for fit in (state.full, *state.fits)]
    thetas = [
        np.concatenate([fit.value[index] - (step[2][index] if step else 0.0), at + (step[0] if step else 0.0)])
        for fit, step in zip((state.full, *state.fits), extended, strict=True)
    ]
    weight = state.full.weight[:, axes, None] ** 2
    taken = state.full.inverse @ state.full.cross(axes, weight * slopes)
    shape = np.diag(1.0 / precision) if extended[0] is None else extended[0][1]
    lead = -taken[index] @ shape
    own = state.full.inverse[np.ix_(index, index)] - lead @ taken[index].T
    complete = np.block([[own, lead], [lead.T, shape]])
    return thetas[0], wider(complete, jackknife(np.array(thetas[1:])))


def _slopes(problem: MovingProblem, full: MovingFit, term: Term, value: Floats) -> Floats:
    """Derivative (n, axes entered, shape parameters) of the effect's torque by the parameters of its shape."""
    at = np.array(term.start[term.count :])
    parts = []
    for position, spread in enumerate(term.spread[term.count :]):
        step = STEP * spread * (np.arange(len(at)) == position)
        sides = [term.shaped(at + sign * step).columns(problem.motion, full.modelled) @ value for sign in (1.0, -1.0)]
        parts.append((sides[0] - sides[1]) / (2.0 * STEP * spread))
    return np.stack(parts, axis=2)
