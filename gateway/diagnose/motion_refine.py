"""Families of effects with a shape that is not linear: the member that the rows prefer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gateway.diagnose.motion_fit import MovingProblem, fit
from gateway.diagnose.motion_state import MovingState, refitted
from gateway.diagnose.motion_trial import put_on_trial
from gateway.model import motion_terms as library
from gateway.model.motion_readings import gain
from gateway.model.motion_terms import MovingTerm

COUPLING_STEPS = np.array([0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0])
COUPLING_SLACK = 4.0
GAS_TURNS_RAD = tuple(np.deg2rad(np.arange(-20.0, 21.0, 5.0)))
GAS_STROKES = (0.2, 0.4, 0.6, 0.8)
GAS_LEAD = 5.0


def refine(problem: MovingProblem, state: MovingState, term: MovingTerm) -> MovingTerm:
    """The member of the effect's family that fits best, as far as the rows tell the members apart."""
    if (term.name, term.shape) == ("axis_coupling", "motor"):
        return _best_coupling(problem, state, term)
    if term.name == "balancer_spring":
        return _best_balancer(problem, state, term)
    if term.name == "torque_constant_scale":
        return _best_scale(problem, state)
    return term


def _best_scale(problem: MovingProblem, state: MovingState) -> MovingTerm:
    """The axis whose scale explains most once it is fitted to the end: two neighbours look alike to first order."""
    members = [gain(int(axis)) for axis in np.flatnonzero(problem.motion.measured)]
    members = [term for term in members if term not in state.terms]
    return max(members, key=lambda term: refitted(problem, state, term).gain)


def _best_balancer(problem: MovingProblem, state: MovingState, found: MovingTerm) -> MovingTerm:
    """A coil of vanishing free length, or the gas law where the held-out rows clearly want its bend."""
    plain = put_on_trial(problem, state.fits, state.full, library.coil_balancer())
    if found.shape == "gas":
        best, gain, phase = found, -np.inf, dict(found.fixed)["phase_rad"]
    elif plain is not None:
        best, gain, phase = found, plain.gain + GAS_LEAD, float(np.arctan2(-plain.value[0], plain.value[1]))
    else:
        return found
    for turn in GAS_TURNS_RAD:
        for stroke in GAS_STROKES:
            member = library.gas_balancer(phase + turn, stroke)
            trial = put_on_trial(problem, state.fits, state.full, member)
            if trial is not None and trial.gain > gain and trial.value[0] > 0:
                best, gain = member, trial.gain
    if best.shape == "gas" and plain is not None and plain.gain + GAS_LEAD > gain:
        return library.coil_balancer()
    return best


def _best_coupling(problem: MovingProblem, state: MovingState, term: MovingTerm) -> MovingTerm:
    """The coupling whose coefficient the fitted rows prefer; a one-to-one train if they do not contradict it."""
    pair = (term.joints[0], term.joints[1])
    centre = dict(term.fixed)["coefficient"]
    others = [other for other in state.terms if other.key != term.key]
    grid = np.unique(np.concatenate([centre * COUPLING_STEPS, [np.sign(centre)]]))
    costs = np.array([coupling_cost(problem, others, pair, float(value)) for value in grid])
    whole = int(np.argmin(np.abs(grid - np.sign(centre))))
    chosen = whole if costs[whole] - costs.min() < COUPLING_SLACK else int(np.argmin(costs))
    return library.axis_coupling(pair, float(grid[chosen]))


def coupling_cost(
    problem: MovingProblem, others: Sequence[MovingTerm], pair: tuple[int, int], coefficient: float
) -> float:
    """Cost of the fitted rows if all friction and rotor inertia of axis j sit on its motor: only then does the
    coefficient show, because what sits on the joint turns at the joint's own speed."""
    precision = problem.base.precision.copy()
    columns = problem.base.columns[:, pair[1], problem.base.friction[pair[1], :3]]
    precision[problem.base.friction[pair[1], :3]] = 1e8 * (columns**2).sum(axis=0) * problem.noise.weight[pair[1]] ** 2
    clamped = replace(problem, base=replace(problem.base, precision=precision))
    member = library.axis_coupling(pair, coefficient)
    return fit(clamped, (*others, member), ~problem.motion.given, problem.motion.given).cost
