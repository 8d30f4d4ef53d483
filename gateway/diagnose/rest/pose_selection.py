"""Recommended rest poses: those at which rival hypotheses differ most in their predictions, over the noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.verdict import Decision
from gateway.identify.knowledge import Knowledge
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.rest.linear import Fit, RestProblem, modelled, with_terms
from gateway.identify.rest.problem import build_problem
from gateway.model.formula import FORMULA
from gateway.model.robot import Robot
from gateway.model.unnamed import UNNAMED
from gateway.model.visits import Visits, joined, visits_at
from gateway.result.result import NextMeasurement

Floats = NDArray[np.float64]

#: Poses (k, N) [rad] that may be recommended, or a function that returns them on demand; None = not stated.
PoseChoice = Floats | Callable[[], Floats | None] | None
#: Poses to choose from [-]: some ten a pose that is asked for, along each of six axes.
CHOICE = 400
#: Time from one visit to the next [s]: a slow move and two sides, as a recording has it.
STEP_S = 30.0
#: Rivals that are compared with the answer at once [-].
RIVALS = 4
#: What many angles decide between: a ripple of unknown order, and what has no name.
RIPPLE = ("torque_ripple", "unknown effect")


def questions(
    problem: RestProblem,
    decision: Decision,
    robot: Robot,
    knowledge: Knowledge,
    pose_choice: PoseChoice = None,
    formulas: Sequence[Fit] = (),
) -> tuple[NextMeasurement, ...]:
    """Recommend what to measure next; empty if no hypothesis rivals the answer and no ripple may be hidden.

    A ripple of unknown order needs more angles than anything else: the best of thousands of orders fits few of them.

    The expected log odds between two hypotheses after new visits is half the squared difference of their predictions
    over the noise (Box and Hill 1967). `formulas` are a candidate formula and its rivals, best first; they are compared
    where no named effect is in question.
    """
    fits = [decision.full, *(rival.fit for rival in decision.near[:RIVALS])]
    if len(fits) < 2 and len(formulas) > 1:
        fits = list(formulas[: RIVALS + 1])
    few = len(np.unique(problem.rows.pose)) < REST.least_poses
    unordered = decision.structure_p < REST.structure_p and not np.isfinite(knowledge.gear_ratios(problem.axes)).all()
    if len(fits) < 2 and not few and not unordered:
        return ()
    choice = _choice(problem.rows, pose_choice)
    if not len(choice):
        what = "widen the limits of the cell: no pose inside them can be measured"
        return (NextMeasurement(what=what, tells_apart=_names(fits)),)
    if few or len(fits) < 2:
        return (_measure(choice, _far_apart(problem.rows, choice), () if few else RIPPLE),)
    names = _names(fits)
    information = _disagreement(problem, robot, knowledge, fits, choice)
    # Select the most informative poses with a minimum distance from each other
    chosen: list[int] = []
    for k in np.argsort(-information):
        if all(np.abs(choice[k] - choice[other]).max() > REST.apart_rad for other in chosen):
            chosen.append(int(k))
        if len(chosen) == REST.asked:
            break
    poses = np.array(chosen, dtype=int)
    expected = 0.5 * float(information[poses].sum())
    if expected < REST.telling and unordered:
        return (_measure(choice, _far_apart(problem.rows, choice), RIPPLE),)
    if expected < REST.telling:
        what = (
            "weigh the links"
            if knowledge.stated_loads
            else "mount a load of known mass and measure it, or add an unloaded run"
        )
        return (NextMeasurement(what=what, tells_apart=names),)
    return (_measure(choice, poses, names),)


def _measure(choice: Floats, index: NDArray[np.int_], names: tuple[str, ...]) -> NextMeasurement:
    poses = tuple(tuple(float(v) for v in choice[k]) for k in index)
    return NextMeasurement(what="measure", poses_rad=poses, tells_apart=names)


def _far_apart(rows: Visits, choice: Floats) -> NDArray[np.int_]:
    """Select poses that are far from visited poses and from each other."""
    span = np.maximum(np.ptp(choice, axis=0), 1e-6)
    near = np.min([np.linalg.norm((choice - q) / span, axis=1) for q in rows.q_rad], axis=0)
    chosen: list[int] = []
    for _ in range(min(REST.asked, len(choice))):
        best = int(np.argmax(near))
        chosen.append(best)
        near = np.minimum(near, np.linalg.norm((choice - choice[best]) / span, axis=1))
    return np.array(chosen, dtype=int)


def _names(fits: Sequence[Fit]) -> tuple[str, ...]:
    named = [[term.name for term in fit.terms if term.name not in (UNNAMED, FORMULA)] for fit in fits]
    found = [name for names in named for name in names]
    if any(term.name == FORMULA for term in fits[0].terms):
        return (*dict.fromkeys(found), "formula", "runner-up formula")
    if any(not fit.terms for fit in fits):
        found.append("none")
    if any(term.name == UNNAMED for fit in fits for term in fit.terms):
        found.append("unknown effect")
    return tuple(dict.fromkeys(found))


def _choice(rows: Visits, stated: PoseChoice) -> Floats:
    """Poses (k, N) that may be recommended: those stated, or random ones in the visited joint ranges."""
    stated = stated() if callable(stated) else stated
    if stated is not None:
        return np.asarray(stated, dtype=float)
    rng = np.random.default_rng(4)
    return rng.uniform(rows.q_rad.min(axis=0), rows.q_rad.max(axis=0), (CHOICE, rows.axes))


def imagined(rows: Visits, poses_rad: Floats) -> Visits:
    """Build visits of new poses under the last load, in sequence, without measured torque."""
    n = len(poses_rad)
    loaded = [label for label in rows.load.tolist() if label != BARE_LABEL]
    label = loaded[-1] if loaded else BARE_LABEL
    last = int(np.argmax(rows.time_s))
    return replace(
        visits_at(poses_rad, rows.gears),
        load=np.full(n, label),
        pose=np.arange(n) + int(rows.pose.max()) + 1,
        time_s=rows.time_s[last] + STEP_S * (1.0 + np.zeros(n)),
        temperature_c=np.repeat(rows.temperature_c[last : last + 1], n, axis=0),
    )


def _disagreement(
    problem: RestProblem, robot: Robot, knowledge: Knowledge, fits: Sequence[Fit], choice: Floats
) -> Floats:
    """Squared difference over noise (k,) between the best hypothesis and its least separable rival."""
    both = build_problem(
        robot, joined([problem.rows, imagined(problem.rows, choice)]), knowledge, problem.nuisance.changes
    )
    visit = both.visit - len(problem.rows)
    std = fits[0].noise.std[both.group]
    readings = []
    for fit in fits:
        setting = with_terms(both, fit.terms, fit.theta, fit.nuisance)
        readings.append(modelled(both, setting, fit.links, fit.loads, fit.band))
    information = []
    for other in readings[1:]:
        # half: what the parameters of the loser can still take up once the new visits are in its fit
        squares = 0.5 * ((other - readings[0]) / std) ** 2
        information.append(np.bincount(visit[visit >= 0], weights=squares[visit >= 0], minlength=len(choice)))
    return np.min(np.array(information), axis=0) + REST.total_information_share * np.mean(np.array(information), axis=0)
