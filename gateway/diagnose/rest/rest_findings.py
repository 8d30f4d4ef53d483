"""Remarks that stand beside the verdict: loads refused, links corrected, what the visits cannot show."""

from __future__ import annotations

import numpy as np

from gateway.diagnose.rest.verdict import Decision
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.rest.linear import RestProblem
from gateway.model.effects import LIBRARY
from gateway.result.result import Finding


def corrected_links(decision: Decision) -> list[Finding]:
    """Corrections of the CAD's links that the fit needs, too weak in the torque to be named as effects."""
    weak = [term for term in decision.after.terms if term not in decision.proven]
    text = "the CAD's inertials are off by more than they are trusted to be; the fit corrects them"
    return [Finding("info", "links", text, "give the CAD less trust, or weigh the links")] if weak else []


def limits(problem: RestProblem) -> list[Finding]:
    """What these visits cannot show, whatever the search says."""
    out = []
    rows = problem.rows
    if len(np.unique(rows.pose)) < 4:
        text = f"{len(np.unique(rows.pose))} poses leave none to hold out: no effect is named"
        out.append(Finding("warn", "data", text, "measure at least four poses under each load"))
    if not (rows.load == BARE_LABEL).any() and not len(problem.prior_target):
        out.append(
            Finding("warn", "data", "no bare run: load and link 6 are told apart by the CAD alone", "record one")
        )
    if not rows.two_sided.any():
        text = "every pose was approached from one side only: friction is noise here"
        out.append(Finding("info", "data", text, "approach each pose from both sides"))
    return out


def at_the_edge(decision: Decision, problem: RestProblem) -> list[Finding]:
    """Effects with a parameter that no arm of their kind has."""
    fit = decision.after
    return [
        Finding(
            "warn",
            " ".join(f"J{joint}" for joint in term.joints) or "arm",
            f"{LIBRARY[term.name].words} is fitted with a parameter at the edge of what its mechanism can do",
            "its value says where the data push, not what the part is: look at the part, or measure more poses",
        )
        for term, theta in zip(fit.terms, fit.theta, strict=True)
        if term in decision.proven and not term.plausible(theta, problem.rows)
    ]
