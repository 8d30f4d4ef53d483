"""Convert a verdict into the result file: effects with their evidence, residuals, and all rejected candidates.

Findings besides the verdict: corrected links, limits of what the visits can show, implausible parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.rest.holdout import Unseen, WithoutPose, left_out, left_out_with, predicted, prediction_covariance
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.rest_mistakes import Mistake
from gateway.diagnose.rest.search import Search
from gateway.diagnose.rest.verdict import BY_EVIDENCE, Decision, strong, unseen_by_choice
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.rest.hypothesis_fit import NOTHING, fit
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import sides_unknown
from gateway.model.effects import LIBRARY, MISTAKES
from gateway.model.term import Term
from gateway.model.unnamed import UNNAMED
from gateway.result.result import EffectResult, Evidence, Finding, FitSummary, LoadResult, Rejected
from gateway.result.values import numbers

Floats = NDArray[np.float64]

#: Odds [-] beyond which a number means no more than certain.
LARGEST_ODDS = 1e12


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """Held-out residuals of any fit: on rows given by the user, else by leaving out one pose at a time.

    Attributes
    ----------
    problem : RestProblem
    held : Unseen or None
    answer : Fit or None
        The chosen fit. Without user-given rows, the poses that test it also took part in choosing it.
    by_others : (rows,)
        Residual under the hypothesis that the other poses choose; replaces that of the answer.
    axis : axis of every held-out row
    group : noise group of every held-out row
    """

    problem: RestProblem
    held: Unseen | None
    answer: Fit | None = None
    by_others: Floats = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, search: Search, decision: Decision, held: Unseen | None) -> Self:
        """Build from the answer of a search."""
        if held is not None or decision.after is decision.before:
            return cls(search.problem, held)
        return cls(search.problem, None, decision.after, unseen_by_choice(search))

    @property
    def group(self) -> NDArray[np.int_]:
        """Noise group of every held-out row."""
        return self.problem.group if self.held is None else self.held.problem.group[self.held.mask]

    @property
    def axis(self) -> NDArray[np.int_]:
        """Axis of every held-out row, from 0."""
        return self.group % self.problem.axes

    def residual(self, fit: Fit) -> Floats:
        """Residual [Nm] of a fit on the held-out rows."""
        if self.held is not None:
            return predicted(self.held, fit)
        return self.by_others if fit is self.answer else left_out(self.problem, fit)

    def leaves(self, fit: Fit) -> Held:
        """Held-out residuals of a fit."""
        return Held.of_rows(self.residual(fit), self.axis, self.problem.axes)

    def ratio(self, after: Fit, before: Fit, joints: tuple[int, ...]) -> float:
        """RMS ratio of two fits on the held-out rows, pooled over axes in units of their noise."""
        axes = [joint - 1 for joint in joints] or range(self.problem.axes)
        return self.leaves(after).over(self.leaves(before), axes, after.noise.std[self.group][:, None])


def summary(problem: RestProblem, fit: Fit, judge: Judge, loads: tuple[LoadResult, ...]) -> FitSummary:
    """Residuals of one fit, with the loads that are reported of it."""
    return FitSummary(
        rms_nm=numbers(Held.of_rows(fit.residual, problem.axis, problem.axes).rms_nm),
        holdout_rms_nm=numbers(judge.leaves(fit).rms_nm),
        loads=loads,
    )


def proven(search: Search, decision: Decision, judge: Judge) -> list[EffectResult]:
    """Return the effects of the decision with parameters and evidence."""
    after = decision.after
    out = []
    for position, term in enumerate(after.terms):
        if term not in decision.proven:
            continue
        without = search.fitted([other for other in after.terms if other is not term], after)
        evidence = Evidence(
            holdout_rms_ratio=judge.ratio(after, _as_every_arm(search.problem, without, term), term.joints),
            p_value=_p_value(after, without, term, len(search.prior)),
            runner_up=decision.runner_up.get(term.label),
            odds=min(decision.odds.get(term.label, LARGEST_ODDS), LARGEST_ODDS),
        )
        out.append(_with_shapes(_effect(search.problem, after, position, evidence), search, after))
    return out


def contradicted(search: Search, decision: Decision, judge: Judge, effects: Sequence[EffectResult]) -> bool:
    """Return True if structure remains and held-out rows leave no effect likely."""
    if decision.verdict != "improved" or not effects:
        return False
    return not any(_stays_likely(search, decision.after, judge, effect) for effect in effects)


def _stays_likely(search: Search, after: Fit, judge: Judge, effect: EffectResult) -> bool:
    """Return True if an effect improves the fit to held-out rows, or keeps the odds of a name with them.

    Rows that the search has seen do not change its odds.
    """
    if effect.evidence.holdout_rms_ratio < 1.0:
        return True
    if judge.held is None:
        return effect.name in BY_EVIDENCE
    others = [term for term in after.terms if term.label != (effect.name, effect.joints)]
    gain = _log_density(judge.held, after) - _log_density(judge.held, search.fitted(others, after))
    return bool(np.log(effect.evidence.odds) + gain >= np.log(REST.naming_odds))


def _log_density(held: Unseen, fitted: Fit) -> float:
    """Log density of the held-out rows as a fit predicts them, without its constant."""
    residual, covariance = predicted(held, fitted), prediction_covariance(held, fitted)
    return -0.5 * float(residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(covariance)[1])


def _with_shapes(effect: EffectResult, search: Search, after: Fit) -> EffectResult:
    """Widen the standard deviations of an effect by the uncertainty of its shape."""
    variance = {key: std**2 for key, std in effect.std.items()}
    for weight, other in search.other_shapes(after):
        for term, theta in zip(other.terms, other.theta, strict=True):
            if term.label != (effect.name, effect.joints):
                continue
            values = term.reported(theta)
            for key in variance.keys() & values.keys() & effect.parameters.keys():
                variance[key] += weight * (values[key] - effect.parameters[key]) ** 2
    return replace(effect, std={key: float(np.sqrt(value)) for key, value in variance.items()})


def _as_every_arm(problem: RestProblem, without: Fit, term: Term) -> Fit:
    """Return the hypothesis without an effect, with the nuisance parameter it replaced held at its prior.

    A free parameter would take the size of the effect, and the comparison would be void.
    """
    place = problem.taken_over([term]) - problem.nuisance_part.start
    if not len(place):
        return without
    std = problem.nuisance.std.copy()
    std[place] = NOTHING
    held = replace(problem, nuisance=replace(problem.nuisance, std=std))
    return fit(held, without.terms, without.noise, without)


def possible(search: Search, decision: Decision, judge: Judge) -> list[EffectResult]:
    """Return the effects of rival hypotheses that the decision does not contain, with their odds."""
    known = {term.label for term in decision.proven}
    out: list[EffectResult] = []
    for rival in decision.rivals:
        for position, term in enumerate(rival.fit.terms):
            if term.name == UNNAMED or term.label in known or not strong(search, rival.fit, term):
                continue
            known.add(term.label)
            ratio = judge.ratio(rival.fit, decision.before, term.joints)
            evidence = Evidence(holdout_rms_ratio=ratio, odds=1.0 / max(rival.odds, 1e-12))
            out.append(_effect(search.problem, rival.fit, position, evidence))
    return out


def _p_value(after: Fit, without: Fit, term: Term, candidates: int) -> float:
    """P-value by the likelihood ratio, with the effect's parameters as degrees of freedom, times the number tried."""
    gain = 2.0 * max(after.mode - without.mode, 0.0)
    return float(min(1.0, max(chdtrc(len(term.linear), gain) * candidates, 1e-300)))


def _effect(problem: RestProblem, fit: Fit, position: int, evidence: Evidence) -> EffectResult:
    term = fit.terms[position]
    at = problem.n_common + sum(len(other.linear) for other in fit.terms[:position])
    part = slice(at, at + len(term.linear))
    values, errors = term.report(fit.theta[position], fit.covariance[part, part])
    return EffectResult(term.name, term.joints, values, errors, evidence)


def mistake_effect(mistake: Mistake, gained: float) -> list[EffectResult]:
    """Represent a commissioning mistake as effects: one per axis, or one per pair of axes."""
    pair = mistake.name in ("axes_swapped", "angles_coupled")
    places = [mistake.joints] if pair else [(joint,) for joint in mistake.joints]
    factor, sign = {"factor": mistake.factor}, {"sign": mistake.sign}
    offset = {"offset_rad": mistake.offset_rad}
    known = {"current_rms_peak": factor, "angles_coupled": sign, "zero_convention": offset}
    parameters = known.get(mistake.name, {})
    evidence = Evidence(
        holdout_rms_ratio=mistake.ratio,
        p_value=float(np.exp(-min(gained, 690.0))),
        odds=float(np.exp(min(gained, 27.0))),
    )
    return [EffectResult(mistake.name, joints, parameters, {}, evidence) for joints in places]


def mistake_findings(mistakes: Sequence[Mistake]) -> list[Finding]:
    """Report each commissioning mistake as a failing finding."""
    out = []
    for mistake in mistakes:
        what, advice = MISTAKES[mistake.name]
        where = " and ".join(f"J{joint}" for joint in mistake.joints)
        out.append(Finding("fail", where, what, advice, mistake.name))
    return out


def factor_rival(mistakes: Sequence[Mistake], read: Fit, log_odds: float) -> EffectResult | None:
    """Return the rival of a factor of sqrt 2 on one axis, or of a wrong torque constant near that factor, if any.

    Parameters
    ----------
    mistakes : those of the corrected data
    read : best fit of the uncorrected data
    log_odds : of the mistakes against that fit
    """
    constants = {term.joints for term in read.terms if term.scales_reading}
    factors = [mistake for mistake in mistakes if mistake.factor != 1.0 and mistake.joints in constants]
    if not factors or abs(log_odds) >= np.log(REST.naming_odds):
        return None
    joints, factor, evidence = factors[0].joints, factors[0].factor, Evidence(odds=float(np.exp(-abs(log_odds))))
    if log_odds > 0.0:
        return EffectResult("torque_constant_scale", joints, {"scale": 1.0 / factor}, {}, evidence)
    return EffectResult("current_rms_peak", joints, {"factor": factor}, {}, evidence)


def rejected(search: Search, decision: Decision) -> list[Rejected]:
    """Return every candidate that is not in the answer, with its ratio of held-out errors."""
    problem, after = search.problem, decision.after
    taken = {term.label for term in decision.proven}
    fitted = {term.label for term in after.terms}
    view = search.view(after, [term for term in search.named if term.label not in fitted], after.noise.std)
    base = Held.of_rows(left_out(problem, after), problem.axis, problem.axes)
    std = after.noise.std[problem.group][:, None]
    best: dict[tuple[str, tuple[int, ...]], int] = {}
    for index in np.argsort(-view.log_bayes):
        best.setdefault(view.terms[index].label, int(index))
    out, without = [], WithoutPose.of(problem, after)
    for (name, joints), index in best.items():
        axes = [joint - 1 for joint in joints] or range(problem.axes)
        with_it = Held.of_rows(left_out_with(problem, after, view, index, without), problem.axis, problem.axes)
        out.append(Rejected(name, joints, with_it.over(base, axes, std)))
    tried = {(entry.name, entry.joints) for entry in out} | taken
    out += [Rejected(*key, 1.0) for key in sorted({term.label for term in search.named} - tried)]
    return sorted(out, key=lambda entry: (entry.holdout_rms_ratio, entry.name, entry.joints))


def corrected_links(decision: Decision) -> list[Finding]:
    """Report corrections of the CAD's links that the fit needs, but that are too small to be named as effects."""
    weak = [term for term in decision.after.terms if term not in decision.proven]
    text = "the CAD's inertials deviate by more than their stated uncertainty; the fit corrects them"
    return (
        [Finding("info", "links", text, "state a larger uncertainty (--inertials S), or weigh the links")]
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
