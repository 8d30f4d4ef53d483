"""Which effects no rest pose can distinguish, by the rank of their joint columns over the whole joint space.

python -m benchmarks.blind.pairs

Columns of every effect at random poses all over the joint space, bare and loaded, with those of unknown links, loads
and friction bands projected out. The rest of an effect shows whether it is
detectable. A pair whose joint rank is below the sum of both cannot be distinguished; the largest canonical correlation
shows how near to that the others come.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.drawn_arm import VISIT_S, draw_arm
from gateway.diagnose.rest.screen import columns_of
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.linear import RestProblem, common_columns
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import terms_at_rest
from gateway.model.robot import robot_from_urdf
from gateway.model.term import Label, Term
from gateway.model.visits import pair_visits
from sim.draw import DrawnArm
from sim.offline import PlannedVisit, measure
from tests.support.rigs.tables import simulated_table

Floats = NDArray[np.float64]

POSES = 120
#: Standard deviation of nuisance parameters: with such a prior they take up no effect.
NOT_THERE = 1e-9
#: Least torque, Nm, that rows are measured by: an axis that carries nothing has but the noise of the readings (1e-9).
CARRIES_NM = 0.01
UNSEEN, NOTHING, RANK, NEAR = 1e-4, 1e-7, 1e-4, 0.995


@dataclass(frozen=True)
class Confusable:
    """Effects that links and loads take up wholly, pairs that no pose distinguishes, pairs that almost none does."""

    unseen: list[Label]
    same: list[tuple[Label, Label]]
    near: list[tuple[Label, Label, float]]


def confusable_pairs(seed: int, poses: int = POSES) -> Confusable:
    """Examine the arm of one seed, links and load unknown."""
    arm = draw_arm(np.random.default_rng([seed, 1]))
    problem = _problem(arm, seed, poses)
    nothing = fit(problem, (), first_noise(problem))
    size = [
        np.sqrt(np.mean(problem.target[problem.group == g] ** 2)) if (problem.group == g).any() else 1.0
        for g in range(18)
    ]
    weight = 1.0 / np.maximum(np.array(size), CARRIES_NM)[problem.group, None]
    common = common_columns(problem, nothing.setting, nothing.links, nothing.loads, nothing.band).dense * weight
    basis = _basis(common[:, : problem.nuisance_part.start], 1e-8)
    left: dict[Label, Floats] = {}
    unseen = []
    for term in _one_shape_each(arm, problem):
        columns = columns_of(problem, nothing, term)[:, np.array(term.linear)] * weight
        norm = np.linalg.norm(columns, axis=0) * np.array([_unit(term)] * columns.shape[1])
        columns = columns[:, norm > NOTHING]
        rest = columns - basis @ (basis.T @ columns)
        if not columns.size or np.linalg.norm(rest) < UNSEEN * np.linalg.norm(columns):
            unseen.append(term.label)
        else:
            left[term.label] = rest / np.linalg.norm(rest, axis=0)
    same, near = [], []
    for (first, a), (second, b) in itertools.combinations(left.items(), 2):
        one, other = _basis(a, RANK), _basis(b, RANK)
        if _basis(np.hstack([one, other]), RANK).shape[1] < one.shape[1] + other.shape[1]:
            same.append((first, second))
            continue
        correlation = float(np.linalg.svd(one.T @ other, compute_uv=False)[0])
        if correlation > NEAR:
            near.append((first, second, correlation))
    return Confusable(unseen, same, near)


def _unit(term: Term) -> float:
    """A plausible size of a parameter, so that rounding is not taken for an effect."""
    return float(np.nan_to_num(np.array(term.spread), nan=1.0)[0])


def _problem(arm: DrawnArm, seed: int, poses: int) -> RestProblem:
    rng = np.random.default_rng([seed, 13])
    q = rng.uniform(arm.chain.lower_rad, arm.chain.upper_rad, (poses, 6))
    visits = [
        PlannedVisit(number, name, VISIT_S * (number + poses * place), angles)
        for place, name in enumerate(("none", "tool"))
        for number, angles in enumerate(q)
    ]
    quiet = replace(arm.protocol, settle=np.zeros(6), resolution_nm=np.zeros(6))
    still = replace(arm.plant, reading_noise_nm=np.full(6, 1e-9))
    table = simulated_table(measure(arm.chain, still, visits, arm.loads, quiet, rng), "pairs")
    robot = robot_from_urdf(arm.urdf, f"seed {seed}")
    problem = build_problem(robot, pair_visits(table, arm.efficiency), Knowledge(link_std=np.inf))
    none = np.zeros_like(problem.nuisance.mean)
    return replace(problem, nuisance=replace(problem.nuisance, mean=none, std=none + NOT_THERE))


def _one_shape_each(arm: DrawnArm, problem: RestProblem) -> Iterator[Term]:
    """Every effect at every place, in its first shape."""
    torque = np.abs(np.nan_to_num(problem.rows.sum_nm))
    seen: set[Label] = set()
    for term in terms_at_rest(problem.rows, RestSetup(tuple(arm.gear_ratio), False, torque)):
        if term.label not in seen:
            seen.add(term.label)
            yield term


def _basis(columns: Floats, least: float) -> Floats:
    norm = np.linalg.norm(columns, axis=0)
    columns = columns[:, norm > 1e-12 * norm.max()]
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return u[:, s > least * s[0]]


def _text(of: Label) -> str:
    return f"{of[0]} {'-'.join(f'J{joint}' for joint in of[1])}".strip()


if __name__ == "__main__":
    for number in range(4):
        found = confusable_pairs(number)
        print(f"arm {number}")
        print("  links and load take up:", ", ".join(_text(of) for of in found.unseen))
        print("  no pose distinguishes:", "; ".join(f"{_text(a)} and {_text(b)}" for a, b in found.same) or "none")
        print(
            "  almost none does:", "; ".join(f"{_text(a)} and {_text(b)} ({c:.4f})" for a, b, c in found.near) or "none"
        )
