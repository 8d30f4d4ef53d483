"""Statements about an arm, tested against rest visits: link masses, torque constants, changes of gain, labels.

A statement enters a fit as a prior. A contradicted statement makes the fit narrow and wrong. So the spread of
each group of priors is estimated from the data (empirical Bayes): the marginal likelihood at a wider
prior over that at the stated one. A group that needs more than three times its stated spread is dropped. Background:
Box 1980 (predictive checks), Evans and Moshonov 2006 (conflict of prior and data).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from gateway.data.labels import BARE_LABEL
from gateway.identify.alternatives import (
    LINK_SCALE,
    LINK_SPREADS,
    PRIOR_ODDS,
    LinearisedFit,
    wider_statements,
    wider_std,
)
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import load_directions
from gateway.identify.model_conflict import model_conflict
from gateway.identify.nuisance import CHANGE_AXIS, gain_stds
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem, open_link_prior
from gateway.identify.rest.rest_loads import well_determined
from gateway.identify.rest.rest_thresholds import CONFLICT
from gateway.model.placeholders import mass_placeholder
from gateway.model.robot import Robot, reach_m
from gateway.model.visits import Visits
from gateway.result.numerals import PLUS_MINUS, TWO_SIDED_95
from gateway.result.result import Finding

Floats = NDArray[np.float64]

#: Separator of label and run; labels of a table do not contain it.
_APART: Final = "\x1f"
#: Groups that can be in conflict, one after the other.
_ROUNDS: Final = 3
#: Prior of a wrong statement: standard deviation of the mass over the stated one, of the centre over the arm's reach.
_WRONG_MASS: Final = 0.5
_WRONG_CENTRE: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class SettledKnowledge:
    """Knowledge after the tests, the fit with it, and the contradicted statements.

    `stated` is the problem and the fit with the stated knowledge. `log_odds` are the posterior log odds of the first
    widened group against the model without effects. `conflict` is one with the robot model so large that no load may be
    given.
    """

    stated: tuple[RestProblem, Fit]
    knowledge: Knowledge
    problem: RestProblem
    fit: Fit
    findings: tuple[Finding, ...]
    log_odds: float = 0.0
    conflict: Finding | None = None


def settle(
    robot: Robot, rows: Visits, knowledge: Knowledge, stated: tuple[RestProblem, Fit] | None = None
) -> SettledKnowledge:
    """Fit the visits without effects, and widen or drop the statements that they contradict.

    `stated` is the problem and the fit of these visits with the knowledge as it is stated, where they are known.

    Raises
    ------
    InputError, DataUnusable
        As `build_problem`.
    """
    trusted, placeholder = without_placeholder(robot, knowledge)
    if stated is None:
        problem = build_problem(robot, rows, trusted)
        stated = problem, fit_without_effects(problem)
    settled, (problem, fit), log_odds = trusted, stated, 0.0
    for _ in range(_ROUNDS):
        wider, odds = _wider_knowledge(problem, fit, robot, settled)
        if wider is None:
            break
        other = build_problem(robot, rows, wider)
        refitted = fit_without_effects(other)
        # The widened parameters differ significantly from the statements; guards against rounding in noise-free rows
        if not all(away > CONFLICT.shown for away, _ in _contradicted(robot, other, refitted, settled, wider)):
            break
        if settled is trusted:
            log_odds = odds + float(np.log(PRIOR_ODDS))
        settled, problem, fit = wider, other, refitted
    conflicts = (finding for _, finding in _contradicted(robot, problem, fit, trusted, settled))
    contradicted = settled.trust != trusted.trust or settled.gain_std != trusted.gain_std
    large = model_conflict(robot, *stated, trusted) if contradicted else None
    return SettledKnowledge(stated, settled, problem, fit, (*placeholder, *conflicts), log_odds, large)


def _wider_knowledge(
    problem: RestProblem, fit: Fit, robot: Robot, knowledge: Knowledge
) -> tuple[Knowledge | None, float]:
    """Return the knowledge with the most contradicted group widened, and its log odds; None where none is."""
    line = LinearisedFit.of(problem, fit)
    stated = line.evidence(problem.common_std)
    best, found = CONFLICT.log_odds, None
    for alternative in wider_statements(robot, knowledge):
        odds = line.evidence(wider_std(problem, robot, alternative)) - stated
        if odds > best:
            best, found = odds, alternative
    link_odds = line.evidence(problem.common_std, LINK_SCALE) - stated
    freed, odds = least_supported(robot, problem, fit, knowledge)
    if freed is not None and odds > max(best, link_odds):
        return freed, odds
    if link_odds > best:
        wider = np.inf if _unloaded(problem, knowledge) else LINK_SCALE
        return replace(knowledge, link_std=wider), link_odds
    if found is None:
        return None, 0.0
    if (
        found.gain_std != knowledge.gain_std
        and np.isfinite(knowledge.trust)
        and not knowledge.stated_loads
        and _unloaded(problem, knowledge)
    ):
        # constants and links contradict each other, and the rows cannot decide which are wrong: the arm is measured, so
        # the statement on the links is not needed
        return replace(knowledge, link_std=np.inf), best
    return dropped(knowledge, found), best


def _unloaded(problem: RestProblem, knowledge: Knowledge) -> bool:
    """Return whether the arm was measured unloaded or under a known load."""
    return knowledge.bare is not None or bool((problem.member.sum(axis=1) == 0).any())


def without_placeholder(robot: Robot, knowledge: Knowledge) -> tuple[Knowledge, tuple[Finding, ...]]:
    """Return the knowledge without placeholder link masses of an exporter, and the findings on them."""
    why, advice = mass_placeholder(robot), "state the masses of the data sheet in the URDF"
    if np.isinf(knowledge.trust):
        return knowledge, ()
    if why:
        finding = Finding("warn", "link masses", f"{why}: a placeholder, not used", advice, "link_masses_placeholder")
        return replace(knowledge, link_std=np.inf), (finding,)
    weightless = ", ".join(f"J{axis + 1}" for axis in np.flatnonzero(robot.mass_kg <= 0))
    what = "the URDF states no mass above 0 kg for the link of this axis: its mass is taken as unknown"
    return knowledge, (Finding("info", weightless, what, advice, "link_mass_missing"),) if weightless else ()


def dropped(stated: Knowledge, wider: Knowledge) -> Knowledge:
    """Return the wider knowledge, with links ignored if they need more than three times their stated standard
    deviation.
    """
    if wider.trust > CONFLICT.dropped * max(stated.trust, LINK_SPREADS[0]):
        return replace(wider, link_std=np.inf)
    return wider


def _contradicted(
    robot: Robot, problem: RestProblem, fit: Fit, stated: Knowledge, settled: Knowledge
) -> Iterator[tuple[float, Finding]]:
    """Report the contradicted statements by the settled fit, each with its difference in standard deviations and both
    values.
    """
    for label in stated.stated_loads:
        if label not in settled.stated_loads:
            yield load_contradicted(robot, problem, fit, stated, label)
    if settled.trust != stated.trust:
        yield _links_contradicted(robot, problem, fit, stated, settled)
    if settled.gain_std != stated.gain_std:
        yield _gains_contradicted(problem, fit, gain_stds(stated.gain_std, robot.axes))
    if settled.change != stated.change:
        yield _gains_changed(problem, fit, CHANGE_AXIS * stated.change)


def _links_contradicted(
    robot: Robot, problem: RestProblem, fit: Fit, stated: Knowledge, settled: Knowledge
) -> tuple[float, Finding]:
    """Report the axis on which the torque of the unloaded arm differs most from the torque of the URDF's masses."""
    mean, _ = open_link_prior(robot, stated.trust)
    rows, own = problem.model.nominal, problem.link_part
    expected = rows @ mean
    visit = np.abs(np.where(problem.use_sum, expected, 0.0)).argmax(axis=0)
    axes = np.arange(problem.axes)
    at = rows[visit, axes]
    covariance = fit.covariance[own, own]
    measured, std = at @ fit.links, np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", at, covariance, at), 1e-12))
    away = np.where(problem.use_sum.any(axis=0), np.abs(measured - at @ mean) / std, 0.0)
    axis = int(np.argmax(away))
    where = f"at pose {int(problem.rows.pose[visit[axis]])}"
    return float(away[axis]), links_finding(
        axis, (float(at[axis] @ mean), float(measured[axis]), float(std[axis])), where, settled.trust
    )


def links_finding(axis: int, torque_nm: tuple[float, float, float], where: str, trust: float) -> Finding:
    """Report link masses that are contradicted, by the torque of an axis: expected, measured, standard deviation."""
    expected, measured, std = torque_nm
    use = "they are not used" if np.isinf(trust) else f"they are trusted to {100 * trust:.0f} %"
    return Finding(
        "warn",
        f"J{axis + 1}",
        f"the link masses of the robot model are contradicted by the measurement: the unloaded arm would need"
        f" {expected:.4g} Nm {where}, and the measurement gives"
        f" {measured:.4g} \N{PLUS-MINUS SIGN} {1.96 * std:.2g} Nm (95 %); {use}",
        "check the masses of the robot model against the data sheet, or state --inertials ignore; if they are right,"
        " the model lacks an effect",
        "link_masses",
    )


def _gains_contradicted(problem: RestProblem, fit: Fit, stated: Floats) -> tuple[float, Finding]:
    """Report the axes whose torque constants differ most from the statements."""
    gain, std = _functions(fit, problem.gain_directions)
    away = np.where(problem.use_sum.any(axis=0), np.abs(gain) / np.hypot(stated, std), 0.0)
    axes = np.flatnonzero(away > CONFLICT.shown) if (away > CONFLICT.shown).any() else np.array([np.argmax(away)])
    measured = problem.use_sum.any(axis=0)
    relative = problem.gain_directions - problem.gain_directions[measured].mean(axis=0)
    apart, apart_std = _functions(fit, relative)
    most = max(float(away.max()), float((np.abs(apart) / np.hypot(stated, apart_std))[measured].max()))
    said = ", ".join(f"J{k + 1} {100 * gain[k]:+.1f} \N{PLUS-MINUS SIGN} {196 * std[k]:.1f} %" for k in axes)
    return most, Finding(
        "warn",
        ", ".join(f"J{k + 1}" for k in axes),
        f"the torque constants are contradicted by the measurement: their errors would be {said} (95 %), and"
        f" {100 * float(np.median(stated)):.2g} % (1 standard deviation) is stated; the intervals are widened for it",
        "check the constants (rms or peak value, voltage, gear ratio), or measure them with a weighed load:"
        " `servo-gateway calibrate`",
        "torque_constants",
    )


def _gains_changed(problem: RestProblem, fit: Fit, stated: float) -> tuple[float, Finding]:
    """Report the axis with the largest change of its torque reading, and the visits between which it changed."""
    rows = problem.rows
    order = np.argsort(rows.time_s, kind="stable") if np.isfinite(rows.time_s).all() else np.arange(len(rows))
    gains = problem.gains_at(rows.take(order))
    directions = (gains - gains[0]).reshape(-1, gains.shape[2])
    change, std = (each.reshape(len(order), -1) for each in _functions(fit, directions))
    certain = np.where(problem.use_sum.any(axis=0) & (std > 0), np.abs(change) / np.maximum(std, 1e-12), 0.0)
    visit, axis = np.unravel_index(int(np.argmax(certain)), certain.shape)
    before, after = rows.take(order[[0]]), rows.take(order[[visit]])
    return float(certain[visit, axis]), Finding(
        "warn",
        f"J{axis + 1}",
        f"its torque reading changed by {100 * change[visit, axis]:+.1f} \N{PLUS-MINUS SIGN}"
        f" {196 * std[visit, axis]:.1f} % (95 %) from pose {int(before.pose[0])} with load {before.load[0]} to pose"
        f" {int(after.pose[0])} with load {after.load[0]}, more than {100 * stated:.1g} % (1 standard deviation)"
        " of an arm that warms up; the intervals are widened for it",
        "warm the arm up before measuring, and measure in the order load, unloaded, unloaded, load",
        "gain_change",
    )


def _functions(fit: Fit, directions: Floats) -> tuple[Floats, Floats]:
    """Values and standard deviations (k,) of linear functions (k, n_common) of the common parameters."""
    own = fit.covariance[: directions.shape[1], : directions.shape[1]]
    variance = np.einsum("ki,ij,kj->k", directions, own, directions)
    return directions @ fit.common, np.sqrt(np.maximum(variance, 0.0))


def two_bodies(robot: Robot, rows: Visits, knowledge: Knowledge) -> Mapping[str, str]:
    """Return labels under which two runs carry different bodies, each with the reason; test with 4 degrees of freedom
    of [m, h].
    """
    out: dict[str, str] = {}
    names = {load: tuple(dict.fromkeys(rows.run[rows.load == load].tolist())) for load in np.unique(rows.load).tolist()}
    for label, runs in names.items():
        if label == BARE_LABEL or label in knowledge.known or len(runs) < 2:
            continue
        apart = np.where(
            rows.load == label, np.char.add(f"{label}{_APART}", rows.run.astype(str)), rows.load.astype(str)
        )
        problem = build_problem(robot, replace(rows, load=apart), knowledge.without_load(label))
        fit = fit_without_effects(problem)
        first, *others = (problem.load_part(problem.labels.index(f"{label}{_APART}{run}")) for run in runs)
        for run, other in zip(runs[1:], others, strict=True):
            turn = np.zeros((4, len(fit.scale)))
            turn[:, other], turn[:, first] = np.eye(4), -np.eye(4)
            if not well_determined(problem, fit, turn).all():
                continue
            away = turn[:, : problem.n_common] @ fit.common
            spread = turn @ fit.covariance @ turn.T
            if chdtrc(4, float(away @ np.linalg.solve(spread, away))) < CONFLICT.bodies_p:
                mass = [fit.common[part.start] for part in (first, other)]
                std = [np.sqrt(fit.covariance[part.start, part.start]) for part in (first, other)]
                out[label] = (
                    f"two bodies under one label: {mass[0]:.4g} \N{PLUS-MINUS SIGN} {1.96 * std[0]:.2g} kg in run"
                    f" {runs[0]} and {mass[1]:.4g} \N{PLUS-MINUS SIGN} {1.96 * std[1]:.2g} kg in run {run} (95 %)"
                )
    return out


def least_supported(
    robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge
) -> tuple[Knowledge | None, float]:
    """Return the knowledge without the least supported known load, and the log odds against its statement.

    None where no load is known.
    """
    tried = [
        (_free_odds(robot, problem, fit, knowledge, label), knowledge.without_load(label))
        for label in knowledge.stated_loads
    ]
    odds, freed = max(tried, key=lambda each: each[0], default=(-np.inf, None))
    return freed, float(odds)


def _free_odds(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge, label: str) -> float:
    """Log marginal likelihood of a free load over that of the stated one."""
    load = knowledge.stated_loads[label]
    if not load.mass_kg > 0.0:
        return -np.inf
    stated = load.mass_kg * np.array([1.0, *(load.com_m or (0.0,) * 3)])
    std = load.mass_kg * np.array([_WRONG_MASS, *[_WRONG_CENTRE * reach_m(robot)] * 3])
    held = 1 if load.com_m is None else 4
    freed = build_problem(robot, problem.rows, knowledge.without_load(label), problem.nuisance.changes)
    prior = np.zeros((held, freed.n_common))
    prior[:, freed.load_part(freed.labels.index(label))] = np.diag(1.0 / std)[:held]
    freed = replace(
        freed,
        prior_rows=np.vstack([freed.prior_rows, prior]),
        prior_target=np.append(freed.prior_target, (stated / std)[:held]),
    )
    before = fit.evidence
    if label in knowledge.weighed:  # the norm of its prior; a load that is known exactly has none
        rows, _ = load.rows()
        before += float(np.sum(np.log(np.diag(rows[:, :held]))))
    return fit_without_effects(freed).evidence - float(np.sum(np.log(std[:held]))) - before


def load_contradicted(
    robot: Robot, problem: RestProblem, fit: Fit, stated: Knowledge, label: str
) -> tuple[float, Finding]:
    """Report a stated load that the measurement contradicts, with the standard deviations by which it differs."""
    load = stated.stated_loads[label]
    mass_kg, centre = load.mass_kg, load.com_m or ()
    moment, part = fit.loads[problem.labels.index(label)], problem.load_part(problem.labels.index(label))
    turn = np.zeros((4, len(fit.scale)))
    turn[:, part] = load_directions(moment)
    std = np.sqrt(np.maximum(np.diag(turn @ fit.covariance @ turn.T), 1e-18))
    std = np.where(well_determined(problem, fit, np.eye(len(fit.scale))[part]), std, np.inf)
    found = np.array([moment[0], *(moment[1:] / moment[0])])
    away = np.abs(found - np.array([mass_kg, *centre, *found[1 + len(centre) :]]))
    away /= np.hypot(std, [load.mass_std_kg, *[load.com_std_m] * 3])
    longest_m = reach_m(robot)
    by_mass = bool(away[0] >= away[1:].max()) or not (std[1:] < longest_m).all()
    if by_mass:
        half = TWO_SIDED_95 * std[0]
        what = f"mass of {mass_kg:.4g} kg is contradicted by the measurement, which gives {found[0]:.4g}"
        what += f" {PLUS_MINUS} {half:.2g} kg (95 %) with the stated torque constants"
        advice = "weigh the load, check its unit (kg) and which load was mounted; if the mass is right, the torque"
        advice += f" constants of all axes are wrong by a factor of {mass_kg / found[0]:.3g} (rms or peak value)"
    else:
        each = [", ".join(f"{1e3 * x:.0f}" for x in values) for values in (centre, found[1:], TWO_SIDED_95 * std[1:])]
        what = f"centre of gravity ({each[0]}) mm is contradicted by the measurement, which gives ({each[1]})"
        what += f" {PLUS_MINUS} ({each[2]}) mm (95 %)"
        advice = "check the frame of the centre (last link or flange), its unit, and which load was mounted"
    what = f"the stated {what}; the statement is not used"
    return float(away.max()), Finding("warn", f"load {label}", what, advice, "known_load")
