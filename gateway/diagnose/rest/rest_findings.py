"""Findings besides the verdict: corrected links, limits of what the visits can show, implausible parameters."""

from __future__ import annotations

import numpy as np

from gateway.diagnose.rest.verdict import Decision
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.rest.linear import RestProblem
from gateway.identify.rest.problem import sides_unknown
from gateway.model.effects import LIBRARY
from gateway.result.result import Finding


def corrected_links(decision: Decision) -> list[Finding]:
    """Report corrections of the CAD's links that the fit needs, but that are too small to be named as effects."""
    weak = [term for term in decision.after.terms if term not in decision.proven]
    text = "the CAD's inertials deviate by more than their stated uncertainty; the fit corrects them"
    return (
        [Finding("info", "links", text, "state a larger uncertainty (--inertials prior:S), or weigh the links")]
        if weak
        else []
    )


def limits(problem: RestProblem) -> list[Finding]:
    """Report what these visits cannot show for any result of the search."""
    out = []
    rows = problem.rows
    if len(np.unique(rows.pose)) < 4:
        text = f"{len(np.unique(rows.pose))} poses are too few to hold one out: no effect is reported"
        out.append(Finding("warn", "data", text, "measure at least four poses under each load"))
    if not (rows.load == BARE_LABEL).any() and not len(problem.prior_target):
        out.append(
            Finding(
                "warn",
                "data",
                "no run of the unloaded arm: only the CAD values separate the load from the last link",
                "record one",
            )
        )
    if sides_unknown(rows).any():
        axes = ", ".join(f"J{axis + 1}" for axis in np.flatnonzero(sides_unknown(rows)).tolist())
        text = (
            f"no approach direction of {axes} is known: friction cannot be separated from gravity; the intervals are"
            " widened for it, and no constant torque is reported as an effect"
        )
        advice = "approach each pose from both sides, and record dir1, dir2, ..."
        out.append(Finding("warn", "approach", text, advice, "sides_unknown"))
    elif not rows.two_sided.any():
        text = "every pose was approached from one side only: friction counts as noise"
        out.append(Finding("info", "data", text, "approach each pose from both sides"))
    return out


def at_the_edge(decision: Decision, problem: RestProblem) -> list[Finding]:
    """Report effects with a parameter that is implausible for their mechanism."""
    fit = decision.after
    return [
        Finding(
            "warn",
            " ".join(f"J{joint}" for joint in term.joints) or "arm",
            f"{LIBRARY[term.name].words} has a fitted parameter at the limit of what its mechanism can have",
            "its value is not reliable: inspect the part, or measure more poses",
        )
        for term, theta in zip(fit.terms, fit.theta, strict=True)
        if term in decision.proven and not term.plausible(theta, problem.rows)
    ]
