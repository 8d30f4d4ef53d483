"""Rest poses at which named effects are seen beyond everything else, and told apart from each other.

A reading (half-sum and half-difference of every axis, without and with the reference load) is linear in all unknowns
about the nominal arm. With its columns J, scaled by their priors, weighted by the noise and summed over the poses, the
information is `I + J' J`. The strength of an effect is the square root of its information per parameter. Before, links,
load, nuisance parameters and all other named effects are projected out (Schur complement). Poses are chosen D-optimal
for effects and load (`gateway.acquire.poses`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.plan import Plan, check_plan, plan_poses
from gateway.acquire.planning import with_expectation, workspace_postures
from gateway.acquire.poses import DISTANCE_RAD, d_optimal
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.linear import Noise, Place, common_columns, spread_of, term_columns, with_terms
from gateway.identify.rest.problem import build_problem
from gateway.model.effect import Over, RestSetup
from gateway.model.effects import LIBRARY, terms_at_rest
from gateway.model.term import Label
from gateway.model.visits import Gears, joined, visits_at
from gateway.motion.assumed import assumed_noise_nm, reference_load
from gateway.motion.workspace import BAND_SHARE, Workspace, workspace_of
from gateway.pipeline.inputs import AnalysisInputs
from gateway.result.values import plain_values

Floats = NDArray[np.float64]

#: Random postures to choose from [-].
CANDIDATES: Final = 400
#: Prior standard deviation of an unknown without one, over the noise by the length of its columns [-].
OPEN: Final = 1e3
#: Duration of a plan of the same time, over that of the standard plan [-].
LONGER: Final = 1.01


def effect_columns(
    workspace: Workspace, knowledge: Knowledge, names: Collection[str], q_rad: Floats
) -> tuple[Floats, list[Label | None]]:
    """Return the scaled, weighted columns (n, rows, p) of every posture, and the effect of each column.

    Parameters
    ----------
    workspace : Workspace
    knowledge : Knowledge
    names : collection of str
        Effects of the library; of several forms of an effect on an axis the first one stands for all.
    q_rad : array of shape (n, N)

    Returns
    -------
    Columns, and by column the label of its effect; None for links and nuisance parameters, ("load", ()) for the load
    """
    robot, axes, std_nm = workspace.robot, workspace.robot.axes, np.tile(assumed_noise_nm(workspace), 3)
    mass_kg, com_m = reference_load(workspace, q_rad)
    bare = visits_at(q_rad, Gears.of(knowledge.efficiency, axes, knowledge.coupling))
    rows = joined([bare, replace(bare, load=np.full(len(q_rad), "load"), time_s=bare.time_s + len(q_rad))])
    problem = build_problem(robot, rows, knowledge)
    load, band_nm = mass_kg * np.append(1.0, com_m)[None], BAND_SHARE * workspace.torque_nm
    at = Place((), problem.links, load, band_nm, problem.nuisance.mean, ())
    noise = Noise(std_nm, std_nm, std_nm)
    setting = with_terms(problem, (), (), at.nuisance)
    bodies = problem.model.bodies(setting, at.links, problem.member @ load)
    torque_nm, _ = problem.model.joint_torque(setting, bodies)
    setup = RestSetup(knowledge.gear_ratios(axes), knowledge.link_std == 0.0, torque_nm, at.links, robot)
    terms = {term.label: term for term in reversed(terms_at_rest(rows, setup, names)) if term.switched() is None}
    columns = common_columns(problem, setting, at.links, at.loads, at.band).dense / noise.of_rows(problem)[:, None]
    std, size = problem.common_std, np.linalg.norm(columns, axis=0)
    columns *= np.where(np.isfinite(std), std, OPEN / np.maximum(size, 1e-9 * size.max()))
    labels: list[Label | None] = [None] * columns.shape[1]
    labels[problem.load_part(0)] = [("load", ())] * 4
    for label, term in reversed(terms.items()):
        effect = term_columns(problem, at, noise, term, np.array(term.start))[:, : term.count]
        effect = effect * spread_of(problem, noise, term, effect)[: term.count] / noise.of_rows(problem)[:, None]
        columns, labels = np.hstack([columns, effect]), [*labels, *[label] * term.count]
    posture = problem.visit % len(q_rad)
    return columns[np.argsort(posture, kind="stable")].reshape(len(q_rad), -1, columns.shape[1]), labels


def strengths(columns: Floats, labels: list[Label | None], names: Collection[str]) -> dict[str, float]:
    """Return the expected strength of each named effect and axis, as `name J2`, over the noise at these postures."""
    information = np.eye(columns.shape[2]) + np.einsum("nri,nrj->ij", columns, columns)
    out: dict[str, float] = {}
    for wanted in dict.fromkeys(label for label in labels if label is not None and label[0] in names):
        part = np.array([label == wanted for label in labels])
        rest = np.array([label is None or label[0] != wanted[0] for label in labels])
        shared = information[np.ix_(rest, part)]
        beyond = information[np.ix_(part, part)] - shared.T @ np.linalg.solve(information[np.ix_(rest, rest)], shared)
        strength = max(float(np.trace(beyond)) / int(part.sum()) - 1.0, 0.0) ** 0.5
        out[" ".join([wanted[0], *(f"J{joint}" for joint in wanted[1])])] = strength
    return out


def plan_distinguishing(
    standard: Plan, loaded: LoadedCell, config: ArmConfig, about: AnalysisInputs, names: Collection[str]
) -> Plan:
    """Return a plan with as many poses as the standard one, about as long, at which the named effects are strongest.

    If the new plan takes longer or has an unreachable pose, postures nearer to those of the standard plan are tried. If
    none is left, the plan is the standard one. `distinguish` of the plan has the names, the strengths in both plans,
    and the expectation of the standard plan. Wiring mistakes, drift and what needs motion are shown by no rest pose.

    Raises
    ------
    PlanRefused
        As `make_plan`.
    """
    hidden = [name for name in sorted(names) if LIBRARY[name].mistake or LIBRARY[name].over in (Over.TIME, Over.SPEED)]
    shown, settings, workspace = set(names) - set(hidden), standard.settings, workspace_of(config, about.model)
    fitted = [pose for pose in standard.poses if pose.purpose == "fit"]
    kept = [pose for pose in standard.poses if pose.purpose != "fit"]
    first = np.array([pose.q_rad for pose in fitted])
    drawn = workspace_postures(loaded, workspace)[:CANDIDATES]
    for pose in kept:
        drawn = drawn[np.abs(drawn - np.array(pose.q_rad)).max(axis=1) >= DISTANCE_RAD]
    nearest = np.argsort(workspace.travel_time(drawn[:, None], first[None]).min(axis=1))
    q_rad = np.vstack([first, drawn[nearest]])
    columns, labels = effect_columns(workspace, about.knowledge, shown, q_rad)
    # `d_optimal` has a prior information of 1e-4
    scaled, nuisance = 1e-2 * columns, np.array([label is None for label in labels])
    plan, chosen, most = standard, list(range(len(first))), len(q_rad) if shown else 0
    while most > len(first):
        rows = scaled[:most]
        tried = d_optimal(((rows, 1.0), (rows[:, :, nuisance], -1.0)), q_rad[:most], len(first))
        poses = [replace(pose, q_rad=tuple(q_rad[row].tolist())) for pose, row in zip(fitted, tried, strict=True)]
        other, unreachable = plan_poses(standard.arm, workspace, (*poses, *kept), settings, standard.corners_rad)
        if not unreachable and other.duration_s <= LONGER * standard.duration_s:
            check_plan(other, workspace)
            plan, chosen, most = with_expectation(other, loaded, config, workspace), tried, 0
        most //= 2
    stated = {
        "effects": sorted(names),
        "not_shown_by_rest_poses": hidden,
        "strength": strengths(columns[chosen], labels, shown),
        "standard_strength": strengths(columns[: len(first)], labels, shown),
        "standard_duration_s": standard.duration_s,
        "standard_expected": plain_values(standard.expectation),
    }
    return replace(plan, distinguish=stated)
