"""A decision as the result file: effects with their evidence, before and after, every candidate with its figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gateway.diagnose.decide import Decision, noise_floor, strong
from gateway.diagnose.holdout import (
    Held,
    axis_of_rows,
    by_axis,
    left_out,
    left_out_with,
    predicted,
    weighted_rms,
)
from gateway.diagnose.linear import Fit, RestProblem
from gateway.diagnose.loads import loads_of
from gateway.diagnose.mistakes import Mistake
from gateway.diagnose.search import Search, label
from gateway.model.robot import Robot
from gateway.model.terms.term import Term
from gateway.result.result import EffectResult, Evidence, Finding, FitSummary, Rejected

Floats = NDArray[np.float64]
LARGEST_ODDS = 1e12


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """Residuals on unseen rows for any fit: of given rows where there are any, else pose by pose.

    Attributes
    ----------
    problem : RestProblem
    held : Held or None
    axis : axis of every unseen row
    group : noise group of every unseen row
    """

    problem: RestProblem
    held: Held | None

    @property
    def group(self) -> NDArray[np.int_]:
        """Noise group of every unseen row."""
        return self.problem.group if self.held is None else self.held.problem.group[self.held.mask]

    def residual(self, fit: Fit) -> Floats:
        """Residual of a fit on the unseen rows [Nm]."""
        return left_out(self.problem, fit) if self.held is None else predicted(self.held, fit)

    def per_axis(self, fit: Fit) -> Floats:
        """RMS (6,) of the residual on the unseen rows [Nm]."""
        return by_axis(self.group % 6, self.residual(fit))

    def ratio(self, after: Fit, before: Fit, joints: tuple[int, ...]) -> float:
        """RMS after over before on the unseen rows, pooled over axes in units of their noise."""
        axes = [joint - 1 for joint in joints] or range(6)
        rows = np.isin(self.group % 6, list(axes))
        std = after.noise.std[self.group[rows]]
        lower = weighted_rms(self.residual(before)[rows], std)
        return weighted_rms(self.residual(after)[rows], std) / lower if lower > 0 else 1.0


def six(values: Floats) -> tuple[float, ...]:
    """Six numbers as a tuple."""
    return tuple(float(v) for v in values)


def summary(problem: RestProblem, fit: Fit, judge: Judge, robot: Robot) -> FitSummary:
    """Residuals and loads of one fit."""
    return FitSummary(
        rms_nm=six(by_axis(axis_of_rows(problem), fit.residual)),
        holdout_rms_nm=six(judge.per_axis(fit)),
        loads=loads_of(problem, fit, robot),
    )


def proven(search: Search, decision: Decision, judge: Judge) -> list[EffectResult]:
    """The effects of the decision with parameters and evidence."""
    after = decision.after
    out = []
    for position, term in enumerate(after.terms):
        if term not in decision.proven:
            continue
        without = search.fitted([other for other in after.terms if other is not term], after)
        evidence = Evidence(
            holdout_rms_ratio=judge.ratio(after, without, term.joints),
            p_value=_p_value(after, without, term, len(search.prior)),
            runner_up=decision.runner_up.get(label(term)),
            odds=min(decision.odds.get(label(term), LARGEST_ODDS), LARGEST_ODDS),
        )
        out.append(_effect(search.problem, after, position, evidence))
    return out


def possible(search: Search, decision: Decision, judge: Judge) -> list[EffectResult]:
    """The effects of the rivals that the decision does not hold, with their odds."""
    known = {label(term) for term in decision.proven}
    out: list[EffectResult] = []
    for rival in decision.rivals:
        for position, term in enumerate(rival.fit.terms):
            if term.name == "unnamed" or label(term) in known or not strong(search, rival.fit, term):
                continue
            known.add(label(term))
            ratio = judge.ratio(rival.fit, decision.before, term.joints)
            evidence = Evidence(holdout_rms_ratio=ratio, odds=1.0 / max(rival.odds, 1e-12))
            out.append(_effect(search.problem, rival.fit, position, evidence))
    return out


def _p_value(after: Fit, without: Fit, term: Term, candidates: int) -> float:
    """Likelihood ratio with as many degrees of freedom as the effect has parameters, times the number tried."""
    gain = 2.0 * max(after.mode - without.mode, 0.0)
    return float(min(1.0, max(chi2.sf(gain, len(term.linear)) * candidates, 1e-300)))


def _effect(problem: RestProblem, fit: Fit, position: int, evidence: Evidence) -> EffectResult:
    term = fit.terms[position]
    at = problem.n_common + sum(len(other.linear) for other in fit.terms[:position])
    part = slice(at, at + len(term.linear))
    values, errors = term.report(fit.theta[position], fit.covariance[part, part])
    return EffectResult(term.name, term.joints, values, errors, evidence)


def mistake_effect(mistake: Mistake, gained: float) -> list[EffectResult]:
    """A commissioning mistake as effects: one per axis, or one per pair of axes."""
    places = [mistake.joints] if mistake.name == "axes_swapped" else [(joint,) for joint in mistake.joints]
    parameters = {"factor": mistake.factor} if mistake.name == "current_rms_peak" else {}
    evidence = Evidence(p_value=float(np.exp(-min(gained, 690.0))), odds=float(np.exp(min(gained, 27.0))))
    return [EffectResult(mistake.name, joints, parameters, {}, evidence) for joints in places]


ADVICE = {
    "sign_reversed": ("torque sign is reversed", "turn torque_sign of this axis in the cell file, or check its wiring"),
    "axes_swapped": ("drives are in each other's place", "swap the node ids of these axes in the cell file"),
    "current_rms_peak": (
        "current is off by a factor of sqrt 2: an rms value was taken for a peak value or the reverse",
        "check current_reference and torque_constant_per of the drive profile",
    ),
}


def mistake_findings(mistakes: Sequence[Mistake]) -> list[Finding]:
    """A failing finding for each commissioning mistake."""
    out = []
    for mistake in mistakes:
        what, advice = ADVICE[mistake.name]
        where = " and ".join(f"J{joint}" for joint in mistake.joints)
        out.append(Finding("fail", where, what, advice))
    return out


def rejected(search: Search, decision: Decision) -> list[Rejected]:
    """Every candidate that is not in the answer: held-out error with it over that without it, pose by pose."""
    problem, after = search.problem, decision.after
    taken = {label(term) for term in decision.proven}
    fitted = {label(term) for term in after.terms}
    view = search.view(after, [term for term in search.named if label(term) not in fitted], after.noise.std)
    base = left_out(problem, after)
    std = after.noise.std[problem.group]
    axis = axis_of_rows(problem)
    best: dict[tuple[str, tuple[int, ...]], int] = {}
    for index in np.argsort(-view.log_bayes):
        best.setdefault(label(view.terms[index]), int(index))
    out = []
    for (name, joints), index in best.items():
        rows = np.isin(axis, [j - 1 for j in joints]) if joints else np.ones(len(axis), dtype=bool)
        with_it = left_out_with(problem, after, view, index)
        lower = weighted_rms(base[rows], std[rows])
        out.append(Rejected(name, joints, weighted_rms(with_it[rows], std[rows]) / lower if lower > 0 else 1.0))
    tried = {(entry.name, entry.joints) for entry in out} | taken
    out += [Rejected(*key, 1.0) for key in sorted({label(term) for term in search.named} - tried)]
    return sorted(out, key=lambda entry: (entry.holdout_rms_ratio, entry.name, entry.joints))


def floor_and_band(problem: RestProblem, decision: Decision) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Noise floor and friction band (six each), NaN where an axis was not measured."""
    measured = problem.use_difference.any(axis=0)
    return six(noise_floor(problem, decision)), six(np.where(measured, decision.after.band, np.nan))
