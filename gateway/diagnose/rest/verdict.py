"""Verdict from fitted hypotheses: proven effects, rival effects, and structure that remains in the residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.holdout import chosen_by_others, gained_by_pose
from gateway.diagnose.rest.residual_structure import misfit
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.screen import projection
from gateway.diagnose.rest.search import Search, pruned
from gateway.identify.nuisance import NUISANCE_STD
from gateway.identify.rest.linear import Fit, RestProblem, modelled, with_terms
from gateway.model.effects import BY_ODDS
from gateway.model.term import Label, Term
from gateway.model.unnamed import UNNAMED
from gateway.result.numerals import TWO_SIDED_95
from gateway.result.result import Verdict

Floats = NDArray[np.float64]

#: What the evidence alone decides, not the left-out poses.
BY_EVIDENCE: Final = (UNNAMED, *BY_ODDS)


class Key(NamedTuple):
    """Names of the strong effects of a hypothesis, and whether it includes an unnamed torque curve."""

    names: frozenset[Label]
    unnamed: bool


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Set of effects that explains the data about as well as the chosen one.

    `key` is the set, `odds` those of the chosen set against it, `fit` its best fit. `holds` is true if it contains the
    chosen set and more.
    """

    key: Key
    fit: Fit
    odds: float
    holds: bool


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Verdict on the visits, with the fits that it is based on.

    Attributes
    ----------
    verdict : as in the result file
    before, after : fits without effects and with the proven effects
    full : fit that also has the required unnamed torque curves
    proven : effects of `after` that the data prove; the others correct the CAD's links and are not named
    rivals : other sets of effects within `naming_odds`, best first
    near : other sets within `ask_odds`; further measurements are recommended
    structure_p : p-value of the remaining residual under noise alone
    odds : per effect, against the best hypothesis without it
    runner_up : per effect, name of the effect that this hypothesis has instead
    """

    verdict: Verdict
    before: Fit
    after: Fit
    full: Fit
    proven: tuple[Term, ...]
    rivals: tuple[Rival, ...]
    near: tuple[Rival, ...]
    structure_p: float
    odds: Mapping[Label, float]
    runner_up: Mapping[Label, str | None]


def decide(search: Search, chosen: Fit) -> Decision:
    """Derive the verdict from the hypotheses of a finished search.

    Parameters
    ----------
    search : Search
    chosen : Fit
        Its best hypothesis without unnecessary effects.
    """
    problem = search.problem
    before = search.fitted(())
    full = _seen_to_help(search, _without_usual(search, _without_weak(search, chosen)))
    own = _key(search, full)
    near = _rivals(search, full, own)
    while smaller := [rival for rival in near if rival.odds < REST.naming_odds and _holds_less(rival.key, own)]:
        fewer = _seen_to_help(search, _without_usual(search, smaller[0].fit))
        if not _holds_less(_key(search, fewer), own):
            break  # an effect that was weak beside a dropped one is strong without it
        full, own = fewer, _key(search, fewer)
        near = _rivals(search, full, own)
    after = search.fitted([term for term in full.terms if term.name != UNNAMED], full)
    proven = tuple(term for term in after.terms if term.label in own.names)
    rivals = tuple(
        rival
        for rival in near
        if rival.odds < REST.naming_odds and not rival.holds and _instead(search, full, rival.fit)
    )
    structure_p = misfit(problem, full)
    odds, runner_up = _odds(search, after, full)
    if any(not rival.key.names for rival in rivals):
        # what a shape without a name says as well has no name
        after, proven = before, ()
    verdict = _verdict(search, full, proven, rivals, structure_p)
    if len(np.unique(problem.rows.pose)) < REST.least_poses:
        verdict, after, proven, rivals = "undecided", before, (), ()
    return Decision(verdict, before, after, full, proven, rivals, near, structure_p, odds, runner_up)


def without_names(decision: Decision) -> Decision:
    """Return the decision without its effects: the residual of the model without effects is unexplained."""
    return replace(decision, verdict="unexplained", after=decision.before, proven=(), rivals=())


def _verdict(
    search: Search, full: Fit, proven: tuple[Term, ...], rivals: tuple[Rival, ...], structure_p: float
) -> Verdict:
    shapes = [term for term in full.terms if term.name == UNNAMED]
    unnamed = any(strength(search, full, term) >= REST.least_strength for term in shapes)
    left = unnamed or structure_p < REST.structure_p
    if not proven:
        return "unexplained" if left else "none_needed"
    if any(rival.key.names for rival in rivals):
        return "undecided"
    return "improved" if left else "explained"


def strength(search: Search, full: Fit, term: Term) -> float:
    """Strength of one effect of a fit, after projecting out links, loads and bands, in units of the noise.

    RMS over the visits, on the axis where it is largest.
    """
    problem = search.problem
    place = full.terms.index(term)
    rest = [k for k in range(len(full.terms)) if k != place]
    without = with_terms(problem, [full.terms[k] for k in rest], [full.theta[k] for k in rest], full.nuisance)
    share = modelled(problem, full.setting, full.links, full.loads, full.band)
    share = share - modelled(problem, without, full.links, full.loads, full.band)
    weight = 1.0 / full.noise.std[problem.group]
    basis, _ = projection(full, full.columns.first(problem.n_common), problem.common_std, weight)
    left = basis.left(share * weight)
    return float(np.sqrt((problem.by_group(left**2) / np.maximum(problem.by_group(), 1)).max()))


def _without_weak(search: Search, chosen: Fit) -> Fit:
    """Return an equally good hypothesis with strong effects only, if there is one; else the chosen one."""
    if all(strong(search, chosen, term) for term in chosen.terms):
        return chosen
    level = search.score(chosen) - REST.needed
    as_good = [fit for fit in search.pool.values() if search.score(fit) >= level and fit.terms]
    better = [fit for fit in as_good if all(strong(search, fit, term) for term in fit.terms)]
    return pruned(search, search.best(better)) if better else chosen


def unseen_by_choice(search: Search) -> Floats:
    """Residual (rows,) [Nm] of each row under the hypothesis chosen and fitted without the row's pose.

    Candidates are all hypotheses of named effects that exceed the nuisance priors. Each effect must gain `needed`.
    """
    level = search.score(search.best()) - REST.out_of_reach
    fits = [
        hypothesis
        for hypothesis in search.pool.values()
        if search.score(hypothesis) > level
        and all(
            term.name != UNNAMED and exceeds_nuisance_prior(search.problem, hypothesis, term)
            for term in hypothesis.terms
        )
    ]
    nothing = search.fitted(())
    fits += [] if any(hypothesis is nothing for hypothesis in fits) else [nothing]
    score = [search.score(hypothesis) - REST.needed * len(hypothesis.terms) for hypothesis in fits]
    return chosen_by_others(search.problem, fits, score)


def _without_usual(search: Search, chosen: Fit) -> Fit:
    """Return the hypothesis without effects whose size is within the nuisance priors."""
    kept = [term for term in chosen.terms if exceeds_nuisance_prior(search.problem, chosen, term)]
    return chosen if len(kept) == len(chosen.terms) else _without_usual(search, search.fitted(kept, chosen))


def exceeds_nuisance_prior(problem: RestProblem, hypothesis: Fit, term: Term) -> bool:
    """Return True if the interval of an effect is outside the prior of the nuisance parameter it replaces."""
    position = hypothesis.terms.index(term)
    at = problem.n_common + sum(len(theta) for theta in hypothesis.theta[:position])
    if term.takes_over == "cogging":
        size = float(np.linalg.norm(hypothesis.theta[position][: term.count])) / np.sqrt(2.0)
        unsure = float(np.sqrt(np.diag(hypothesis.covariance)[at : at + term.count].mean() / 2.0))
        return size - TWO_SIDED_95 * unsure > REST.cogging * float(hypothesis.noise.std[term.joints[0] - 1])
    places = _replaced_places(problem, term)
    if term.looks_like:
        usual, spread = 0.0, term.spread[0]
    elif len(places):
        usual, spread = float(problem.common_mean[places[0]]), float(np.linalg.norm(problem.common_std[places]))
    else:
        return True
    away = abs(float(hypothesis.theta[position][0]) - usual)
    unsure = TWO_SIDED_95 * float(np.sqrt(max(hypothesis.covariance[at, at], 0.0)))
    return away - unsure > NUISANCE_STD * spread


def _replaced_places(problem: RestProblem, term: Term) -> NDArray[np.int_]:
    """Indices of the common parameters that an effect replaces.

    A torque constant has its own error and the error common to all axes.
    """
    places = problem.taken_over([term])
    if term.takes_over == "gain":
        own = places[0] if term.joints else problem.nuisance_part.start + int(np.argmax(problem.nuisance.constants))
        return np.array([own, problem.nuisance_part.start + problem.nuisance.common])
    return places


def _seen_to_help(search: Search, chosen: Fit) -> Fit:
    """Drop effects that left-out poses do not confirm, the least confirmed first.

    An effect that replaces a nuisance parameter competes with that parameter; it only must not be clearly worse.
    """
    while True:
        terms = [term for term in chosen.terms if term.name not in BY_EVIDENCE]
        short = [
            (helped(search, chosen, term) - REST.unseen * (-1.0 if len(search.problem.taken_over([term])) else 1.0), k)
            for k, term in enumerate(terms)
        ]
        if not short or min(short)[0] >= 0.0:
            return chosen
        least = terms[min(short)[1]]
        chosen = search.fitted([term for term in chosen.terms if term is not least], chosen)


def helped(search: Search, hypothesis: Fit, term: Term) -> float:
    """Improvement of the fit to left-out poses by an effect, in standard deviations over the poses."""
    without = search.fitted([other for other in hypothesis.terms if other is not term], hypothesis)
    return in_std(gained_by_pose(search.problem, hypothesis, without))


def in_std(gained: Floats) -> float:
    """Sum of a gain of each pose (poses,), in standard deviations over the poses."""
    if len(gained) < 2:
        return -np.inf
    return float(gained.sum() / max(np.sqrt(len(gained)) * float(gained.std(ddof=1)), 1e-12))


def strong(search: Search, hypothesis: Fit, term: Term) -> bool:
    """Return True if the data, not only the prior of the links, prove an effect that exceeds the nuisance priors."""
    if term.name in BY_EVIDENCE:
        return True
    if len(_replaced_places(search.problem, term)):
        return exceeds_nuisance_prior(search.problem, hypothesis, term)
    return strength(search, hypothesis, term) >= REST.least_strength


def _key(search: Search, hypothesis: Fit) -> Key:
    named = [term for term in hypothesis.terms if term.name != UNNAMED]
    shown = frozenset(term.label for term in named if strong(search, hypothesis, term))
    # a drifting constant has an initial error too: it does not count as a second effect
    drifting = {("torque_constant_scale", term.joints) for term in named if term.name == "thermal_drift"}
    return Key(shown - drifting, len(named) < len(hypothesis.terms))


def _instead(search: Search, full: Fit, rival: Fit) -> bool:
    """Return True if two hypotheses explain the same: their union has no more evidence than the better one."""
    own = {term.label for term in full.terms}
    more = [term for term in rival.terms if term.label not in own]
    if not full.terms or not more or any(term.name == UNNAMED for term in (*full.terms, *more)):
        return True
    together = search.fitted((*full.terms, *more), full)
    return search.score(together) <= max(search.score(full), search.score(rival))


def _holds_less(key: Key, own: Key) -> bool:
    """Return True if a set names a proper subset of the effects of another."""
    return key.names < own.names and key.unnamed <= own.unnamed


def _rivals(search: Search, full: Fit, own: Key) -> tuple[Rival, ...]:
    """Rank sets of effects by the summed evidence of their shapes; larger sets only if they gain evidence."""
    level = search.score(full) - math.log(REST.ask_odds) - REST.needed
    groups: dict[Key, list[Fit]] = {}
    for hypothesis in search.pool.values():
        if search.score(hypothesis) >= level:
            groups.setdefault(_key(search, hypothesis), []).append(hypothesis)
    total = {
        key: float(np.logaddexp.reduce([search.score(member) for member in members])) for key, members in groups.items()
    }
    reference = max(total[own], search.score(full))
    out = []
    for key, members in groups.items():
        contains = key.names >= own.names and key.unnamed >= own.unnamed
        odds = math.exp(min(reference - total[key], 50.0))
        if key != own and odds <= (REST.hint_odds if contains else REST.ask_odds):
            out.append(Rival(key, search.best(members), odds, contains))
    return tuple(sorted(out, key=lambda rival: rival.odds))


def _odds(search: Search, after: Fit, full: Fit) -> tuple[dict[Label, float], dict[Label, str | None]]:
    odds: dict[Label, float] = {}
    runner_up: dict[Label, str | None] = {}
    own = {term.label for term in after.terms}
    for term in after.terms:
        others = [fit for fit in search.pool.values() if term.label not in {t.label for t in fit.terms}]
        if not others:
            continue
        best = search.best(others)
        odds[term.label] = math.exp(min(max(search.score(full) - search.score(best), -50.0), 50.0))
        instead = [t.name for t in best.terms if t.label not in own and t.name != UNNAMED]
        runner_up[term.label] = instead[0] if instead else None
    return odds, runner_up


def noise_floor(problem: RestProblem, decision: Decision) -> Floats:
    """Noise floor (N,): of the fit if only noise remains, else from the approach directions of the visits."""
    clean = decision.verdict in ("none_needed", "explained", "undecided")
    std = decision.full.noise.std if clean else decision.full.noise.start
    count = problem.by_group().reshape(3, problem.axes)
    total = np.sum(count * std.reshape(count.shape) ** 2, axis=0)
    return np.sqrt(np.where(count.sum(axis=0) > 0, total / np.maximum(count.sum(axis=0), 1), np.nan))
