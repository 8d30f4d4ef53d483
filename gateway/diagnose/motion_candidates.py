"""Which effects are tried on a moving run, and what makes one of them physically possible."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.motion_fit import MovingFit, MovingProblem
from gateway.model import motion_readings as readings
from gateway.model import motion_terms as terms
from gateway.model.motion import MovingRows
from gateway.model.motion_terms import MovingTerm

Floats = NDArray[np.float64]

STRIBECK_FRACTIONS = (0.03, 0.06, 0.12, 0.25, 0.5)
POWERS = (0.5, 2.0)
COUPLINGS = (-1.0, -0.5, 0.5, 1.0)
# The motor of the outer axis turns with the inner joint; the reverse needs a drive train that reaches back.
PAIRS = ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (3, 5))
WRIST = (3, 4, 5)
GAS_PHASES_RAD = tuple(np.deg2rad(np.arange(-180.0, 180.0, 30.0)))
GAS_STROKES = (0.4, 0.8)
LONG_S = 60.0
WARMED_K = 2.0
RIPPLES_PER_AXIS = 2
LARGEST_ANGLE_RAD = 0.2
SMALLEST_BALANCER = 0.15
LARGEST_SCALE = 2.5
# Effects that a wrong drawing can imitate.
DRAWN = frozenset(
    {"balancer_spring", "link_mass", "joint_zero_offset", "base_tilt", "torque_constant_scale", "torque_offset"}
    | {"payload_shift", "joint_elasticity"}
)


def candidates(problem: MovingProblem, allowed: frozenset[str]) -> list[MovingTerm]:
    """Every effect that these rows could show, of the names in `allowed`."""
    motion = problem.motion
    axes = [int(axis) for axis in np.flatnonzero(motion.measured)]
    found: list[MovingTerm] = []
    for axis in axes:
        found.extend(_friction(axis, float(motion.speed_rad_s[axis])))
        found.append(readings.gain(axis))
        found.append(readings.offset(axis))
        found.extend(_drift(motion, axis))
    for pair in PAIRS:
        if set(pair) <= set(axes):
            found.extend(terms.axis_coupling(pair, coefficient) for coefficient in COUPLINGS)
            found.append(terms.torque_mixing(pair))
    if 1 in axes:
        found.append(terms.coil_balancer())
        found.extend(terms.gas_balancer(phase, stroke) for phase in GAS_PHASES_RAD for stroke in GAS_STROKES)
    for axis in set(WRIST) & set(axes):
        found.extend(terms.cable(axis, shape) for shape in ("linear", "harmonic"))
    found.extend(_geometry(problem))
    return [term for term in found if term.name in allowed]


def _friction(axis: int, top_rad_s: float) -> Iterator[MovingTerm]:
    yield terms.load_friction(axis)
    yield from (terms.stribeck(axis, fraction, top_rad_s) for fraction in STRIBECK_FRACTIONS)
    yield from (terms.power_friction(axis, exponent) for exponent in POWERS)


def _drift(motion: MovingRows, axis: int) -> Iterator[MovingTerm]:
    heat = motion.temperature_c[:, axis]
    if np.isfinite(heat).all() and np.ptp(heat) >= WARMED_K:
        yield readings.drift(axis, per_kelvin=True)
    elif motion.duration_s >= LONG_S:
        yield readings.drift(axis, per_kelvin=False)


def _geometry(problem: MovingProblem) -> Iterator[MovingTerm]:
    motion = problem.motion
    yield readings.base_tilt(motion)
    yield from (readings.zero_offset(axis, motion) for axis in range(6))
    # a secondary encoder shows the elasticity of its joint by itself
    yield from (readings.elasticity(axis, motion) for axis in range(3) if not np.isfinite(motion.wind_up_rad[0, axis]))
    if problem.base.trust is not None:
        yield from (readings.link_mass(link) for link in (1, 2, 3))
    yield from (readings.payload_shift(label) for label in problem.base.loads)


def ripples(problem: MovingProblem, full: MovingFit) -> list[MovingTerm]:
    """The strongest swings of each axis's residual over its own angle, as far as the sampling resolves them."""
    motion = problem.motion
    found = []
    for axis in np.flatnonzero(motion.measured):
        rows = motion.judged[:, axis] & ~motion.given
        q, rest = motion.q_rad[rows, axis], full.residual_nm[rows, axis]
        steps = np.abs(np.diff(motion.q_rad[:, axis]))[rows[:-1] & (np.diff(motion.run) == 0)]
        reach = float(np.ptp(q))
        if reach < 0.2 or not len(steps):
            continue
        fastest = 0.5 * np.pi / max(float(np.quantile(steps, 0.9)), 1e-9)
        waves = np.arange(6.0 * np.pi / reach, min(fastest, 600.0), 0.5 * np.pi / reach)
        if not len(waves):
            continue
        power = np.abs(np.exp(1j * np.outer(waves, q)) @ rest)
        for peak in np.argsort(power)[::-1][:RIPPLES_PER_AXIS]:
            found.append(terms.ripple(int(axis), float(waves[peak])))
    return found


def possible(problem: MovingProblem, full: MovingFit, term: MovingTerm, value: Floats, covariance: Floats) -> bool:
    """Whether the coefficients (k,) mean something physical: the right sign and a size an arm can have."""
    spread = np.sqrt(np.diag(covariance))
    rule = _RULES.get(term.name)
    return True if rule is None else rule(problem, full, term, value, spread)


def _loss(_problem: MovingProblem, _full: MovingFit, _term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    return bool(0.0 < value[0] < 0.6)


def _coupling(problem: MovingProblem, full: MovingFit, term: MovingTerm, value: Floats, spread: Floats) -> bool:
    if term.shape == "mixing":
        return bool(0.02 < abs(value[0]) < LARGEST_SCALE)
    return bool((value[:2] > -2.0 * spread[:2]).all() and (value[:2] > 0).any())


def _dissipates(problem: MovingProblem, full: MovingFit, term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    """Friction takes power at most speeds, with the refitted Coulomb and viscous part."""
    axis = term.axes[0]
    rows = problem.motion.judged[:, axis]
    first = problem.base.friction[axis]
    columns = term.columns(problem.motion, full.modelled)[:, 0]
    weight = full.weight[:, axis] ** 2
    change = full.inverse @ (full.columns[:, axis].T @ (columns * weight[:, None])) @ value
    parameters = (full.value[: len(change)] - change)[first[:2]]
    law = problem.base.columns[:, axis, first[:2]] @ parameters + columns @ value
    power = law * problem.motion.qd_rad_s[:, axis]
    return bool((power[rows] > 0).mean() > 0.9)


def _opposes_gravity(problem: MovingProblem, full: MovingFit, term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    """A balancer takes a good part off the torque that gravity puts on axis 2: nobody builds one for less."""
    push = term.columns(problem.motion, full.modelled)[:, 0] @ value
    drawn = problem.motion.rigid[:, 1] @ (problem.base.body[:, : len(problem.base.mean)] @ problem.base.mean)
    still = drawn if drawn.any() else full.modelled.rigid_nm[:, 1]
    large = np.sqrt(np.mean(push**2)) > SMALLEST_BALANCER * np.sqrt(np.mean(still**2))
    return bool(large and (push @ still < 0.0 or abs(np.corrcoef(push, still)[0, 1]) < 0.5))


def _small_angle(_problem: MovingProblem, _full: MovingFit, _term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    return bool((np.abs(value) < LARGEST_ANGLE_RAD).all())


def _yields(problem: MovingProblem, full: MovingFit, term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    torque = np.abs(full.modelled.rigid_nm[:, term.joints[0]]).max()
    return bool(0.0 < value[0] * torque < 0.05)


def _scale(_problem: MovingProblem, _full: MovingFit, _term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    return bool(1.0 / LARGEST_SCALE < 1.0 + value[0] < LARGEST_SCALE)


def _body(problem: MovingProblem, _full: MovingFit, _term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    arm = float(np.nansum(problem.motion.robot.mass_kg))
    return bool(0.0 < value[0] < arm and np.linalg.norm(value[1:]) < 2.0 * value[0])


def _restoring(_problem: MovingProblem, _full: MovingFit, term: MovingTerm, value: Floats, _spread: Floats) -> bool:
    return bool(value[0] > 0) if term.shape == "linear" else True


_RULES = {
    "load_dependent_friction": _loss,
    "axis_coupling": _coupling,
    "velocity_friction": _dissipates,
    "balancer_spring": _opposes_gravity,
    "base_tilt": _small_angle,
    "joint_zero_offset": _small_angle,
    "joint_elasticity": _yields,
    "torque_constant_scale": _scale,
    "link_mass": _body,
    "cable_torque": _restoring,
}
