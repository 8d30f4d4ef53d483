"""From fitted coefficients to the parameters of the result file, with their standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.motion_fit import MovingProblem
from gateway.diagnose.motion_load import over_blocks
from gateway.diagnose.motion_refine import coupling_cost
from gateway.diagnose.motion_state import MovingState
from gateway.model.motion_terms import ANCHOR_M, LEVER_M, POLYTROPIC, MovingTerm

Floats = NDArray[np.float64]
Named = dict[str, float]
Conversion = Callable[[Floats], Named]

RMS_PEAK = np.sqrt(2.0)
RMS_PEAK_TOLERANCE = 0.05
STEP = 1e-6
SURE = 4.0


def parameters_of(problem: MovingProblem, state: MovingState, terms: Sequence[MovingTerm]) -> tuple[str, Named, Named]:
    """Name, parameters and standard deviations of an effect that consists of `terms`."""
    where = _positions(problem, state, terms)
    name = terms[0].name
    convert = _conversion(problem, terms)
    extra = list(problem.base.friction[terms[0].axes[0], :2]) if name == "velocity_friction" else []
    index = np.array([*where, *extra])
    value, covariance = state.full.value[index], state.full.inverse[np.ix_(index, index)]
    covariance = covariance + over_blocks(problem, state, index)
    parameters, std = _with_spread(convert, value, covariance)
    parameters |= {key: float(x) for term in terms for key, x in term.fixed}
    if name == "axis_coupling" and terms[0].shape == "motor":
        std["coefficient"] = _coupling_spread(problem, state, terms[0])
    if name == "torque_constant_scale" and _is_rms_peak(parameters["scale"], std["scale"]):
        return (
            "current_rms_peak",
            {"factor": 1.0 / parameters["scale"]},
            {"factor": std["scale"] / parameters["scale"] ** 2},
        )
    return name, parameters, std


def converted(
    problem: MovingProblem, terms: Sequence[MovingTerm], value: Floats, covariance: Floats
) -> tuple[Named, Named]:
    """Parameters and standard deviations of coefficients (k,) with their covariance (k, k)."""
    if terms[0].name == "velocity_friction":
        # the Coulomb and viscous part belong to the model that is in the fit
        std = np.sqrt(np.diag(covariance))
        symbols = [symbol for term in terms for symbol in term.symbols]
        named = zip(symbols, value, std, strict=True)
        listed = [(symbol, float(x), float(spread)) for symbol, x, spread in named]
        return {symbol: x for symbol, x, _ in listed}, {symbol: spread for symbol, _, spread in listed}
    return _with_spread(_conversion(problem, terms), np.asarray(value, dtype=float), covariance)


def certain(problem: MovingProblem, state: MovingState, terms: Sequence[MovingTerm]) -> bool:
    """Whether a scale of a reading is so far from 1 that a failing finding may be made of it; other effects are."""
    if terms[0].name != "torque_constant_scale":
        return True
    _, parameters, std = parameters_of(problem, state, terms)
    return all(abs(parameters[key] - 1.0) > SURE * std[key] for key in std)


def _positions(problem: MovingProblem, state: MovingState, terms: Sequence[MovingTerm]) -> list[int]:
    start, found = problem.base.columns.shape[2], []
    for term in state.terms:
        if term in terms:
            found.extend(range(start, start + len(term.symbols)))
        start += len(term.symbols)
    return found


def _with_spread(convert: Conversion, value: Floats, covariance: Floats) -> tuple[Named, Named]:
    """Converted values and their standard deviations to first order."""
    here = convert(value)
    scale = np.maximum(np.abs(value), np.sqrt(np.diag(covariance))) * STEP + 1e-300
    change = np.zeros((len(here), len(value)))
    for position in range(len(value)):
        moved = value.copy()
        moved[position] += scale[position]
        change[:, position] = (np.array(list(convert(moved).values())) - np.array(list(here.values()))) / scale[
            position
        ]
    std = np.sqrt(np.maximum(np.diag(change @ covariance @ change.T), 0.0))
    return here, dict(zip(here, (float(x) for x in std), strict=True))


def _conversion(problem: MovingProblem, terms: Sequence[MovingTerm]) -> Conversion:
    first = terms[0]
    symbols = [symbol for term in terms for symbol in term.symbols]

    def plain(value: Floats) -> Named:
        return {symbol: float(x) for symbol, x in zip(symbols, value, strict=True)}

    def friction(value: Floats) -> Named:
        law = {"coulomb_nm": float(value[-2]), "viscous_nm_s_rad": float(value[-1])}
        return law | {symbol: float(x) for symbol, x in zip(symbols, value, strict=False)}

    def coil(value: Floats) -> Named:
        amplitude = float(np.hypot(value[0], value[1]))
        return {
            "stiffness_n_m": amplitude / (LEVER_M * ANCHOR_M),
            "phase_rad": float(np.arctan2(-value[0], value[1])),
            "amplitude_nm": amplitude,
        }

    def gas(value: Floats) -> Named:
        stroke_m = (np.hypot(LEVER_M, ANCHOR_M) - abs(ANCHOR_M - LEVER_M)) / dict(first.fixed)["stroke_ratio"]
        return {"stiffness_n_m": float(POLYTROPIC * value[0] / stroke_m), "force_n": float(value[0])}

    def swing(value: Floats) -> Named:
        return {"amplitude_nm": float(np.hypot(value[0], value[1]))}

    def wound(value: Floats) -> Named:
        size = float(np.hypot(value[0], value[1]))
        return {"stiffness_nm_rad": size, "neutral_rad": float(np.arctan2(-value[1], value[0]))}

    def scale(value: Floats) -> Named:
        return {"scale": float(1.0 / (1.0 + value[0]))}

    def body(value: Floats) -> Named:
        return plain(value) | {"first_moment_kg_m": float(np.linalg.norm(value[1:]))}

    def moved(value: Floats) -> Named:
        mass = max(_heaviest(problem), 1e-9)
        return {"shift_m": float(np.linalg.norm(value)) * problem.motion.duration_s / mass}

    special: dict[tuple[str, str], Conversion] = {
        ("balancer_spring", "coil"): coil,
        ("balancer_spring", "gas"): gas,
        ("torque_ripple", ""): swing,
        ("cable_torque", "harmonic"): wound,
        ("torque_constant_scale", ""): scale,
        ("link_mass", ""): body,
        ("payload_shift", ""): moved,
    }
    return friction if first.name == "velocity_friction" else special.get((first.name, first.shape), plain)


def _heaviest(problem: MovingProblem) -> float:
    return float(np.nanmax(np.append(np.nan_to_num(problem.motion.robot.mass_kg), 1.0)))


def _is_rms_peak(scale: float, std: float) -> bool:
    near = [abs(scale * factor - 1.0) for factor in (RMS_PEAK, 1.0 / RMS_PEAK)]
    return min(near) < min(RMS_PEAK_TOLERANCE, 3.0 * std / scale)


def _coupling_spread(problem: MovingProblem, state: MovingState, term: MovingTerm) -> float:
    """Standard deviation of the coefficient from the curvature of the cost."""
    centre, step = dict(term.fixed)["coefficient"], 0.1
    pair = (term.joints[0], term.joints[1])
    others = [other for other in state.terms if other != term]
    low, middle, high = (coupling_cost(problem, others, pair, centre * (1.0 + move)) for move in (-step, 0.0, step))
    curvature = (low + high - 2.0 * middle) / (step * centre) ** 2
    return float(np.sqrt(2.0 / curvature)) if curvature > 0 else abs(centre) * step
