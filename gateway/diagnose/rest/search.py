"""Search for missing effects: singles, pairs and further effects by evidence, then removal of unnecessary ones.

Candidates are ranked linearised (all singles, all pairs of places) and the best are fitted in full. A place is an
effect on a specific axis or link. Hypotheses are compared by evidence plus log prior probability: every place of every
effect is equally likely a priori, and its shapes share that probability. An effect that replaces a nuisance parameter
is already penalised by that parameter's prior. Unnamed torque curves compete by the same rules.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.screen import Derivatives, Screen, pair_log_bayes, screen
from gateway.identify.rest.hypothesis_fit import averaged_evidence, fit, iterates
from gateway.identify.rest.linear import Fit, Noise, RestProblem
from gateway.model.term import Label, Term
from gateway.model.unnamed import UNNAMED

Floats = NDArray[np.float64]

#: Log odds against a hypothesis with an effect that cannot be: more than any data say.
IMPOSSIBLE: Final = 1e9
#: A fit is not finished if its log evidence is below the best by more than this plus this many times the gain of its
#: last step: of 500 fits none gained more after its second step.
FAR: Final = 100.0
FAR_GAINS: Final = 20.0


def term_shapes(terms: Sequence[Term]) -> list[int]:
    """Number of shapes of each effect at its place; shapes that differ only by fitted parameters count once."""
    count = Counter(term.label for term in terms)
    kinds = Counter(label for label, _ in {(term.label, type(term)) for term in terms})
    return [count[term.label] if all(term.linear) else kinds[term.label] for term in terms]


@dataclass(slots=True, eq=False)
class Search:
    """Hypotheses fitted so far, by their set of effects.

    Attributes
    ----------
    problem : RestProblem
    named, unnamed : candidates
    prior : log prior probability of each candidate
    pool : fits by set of effects
    dropped : sets of effects whose fit was not finished
    links_as_stated : the stated standard deviations of the links are right
    averaged : evidence of fits, averaged over wrong stated standard deviations
    derivatives : of the modelled rows by the parameters of each candidate, about the model without effects
    """

    problem: RestProblem
    named: tuple[Term, ...]
    unnamed: tuple[Term, ...]
    noise: Noise
    prior: dict[Term, float] = field(default_factory=dict)
    pool: dict[frozenset[Term], Fit] = field(default_factory=dict)
    dropped: set[frozenset[Term]] = field(default_factory=set)
    averaged: dict[Fit, float] = field(default_factory=dict)
    links_as_stated: bool = False
    derivatives: Derivatives | None = None

    def __post_init__(self) -> None:
        places = len({term.label for term in self.named})
        for term, shapes in zip(self.named, term_shapes(self.named), strict=True):
            held_down = bool(len(self.problem.taken_over([term])))
            self.prior[term] = -np.log(1 if held_down else places) - np.log(shapes)
        for term in self.unnamed:
            self.prior[term] = 0.0 if term.looks_like else -np.log(len(self.unnamed)) - REST.rare

    def score(self, hypothesis: Fit) -> float:
        """Evidence plus log prior of a hypothesis.

        An effect with a value that its mechanism cannot have costs `implausible` more; one with an unphysical value is
        never chosen.
        """
        if hypothesis not in self.averaged:
            self.averaged[hypothesis] = averaged_evidence(hypothesis, self.links_as_stated)
        return self.averaged[hypothesis] + self._log_prior(hypothesis)

    def log_odds(self, hypothesis: Fit, plain: Fit) -> float:
        """Posterior log odds of a hypothesis against a fit without effects, with all statements as they are."""
        return hypothesis.evidence + self._log_prior(hypothesis) - plain.evidence

    def _log_prior(self, hypothesis: Fit) -> float:
        effects = tuple(self.sized(hypothesis))
        if not all(term.exists(values, std) for term, values, std in effects):
            return -IMPOSSIBLE
        return sum(self.prior[term] + self._log_prior_of_sign(term, values, std) for term, values, std in effects)

    def _log_prior_of_sign(self, term: Term, values: Floats, std: Floats) -> float:
        """Log of a prior that is all on the side that is plausible, over the normal prior with both sides.

        The size of an effect is its first parameter.
        """
        if not term.plausible(values, self.problem.rows):
            return -REST.implausible
        if term.plausible(np.append(-values[: term.count], values[term.count :]), self.problem.rows):
            return 0.0
        return float(np.log(2.0 * ndtr(abs(values[0]) / std[0])))

    def sized(self, hypothesis: Fit) -> Iterator[tuple[Term, Floats, Floats]]:
        """Effects of a hypothesis with their parameters and standard deviations."""
        std = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[self.problem.n_common :], 0.0))
        ends = np.cumsum([len(values) for values in hypothesis.theta])[:-1]
        return zip(hypothesis.terms, hypothesis.theta, np.split(std, ends), strict=False)

    def fitted(self, terms: Iterable[Term], start: Fit | None = None) -> Fit:
        """Return the fit of a set of effects, computed once."""
        ordered = tuple(terms)
        key = frozenset(ordered)
        if key not in self.pool:
            self.pool[key] = fit(self.problem, ordered, self.noise if start is None else start.noise, start)
        return self.pool[key]

    def tried(self, terms: Iterable[Term], start: Fit) -> None:
        """Add the fit of a set of effects to the pool, unless its evidence stays far below the best."""
        ordered = tuple(terms)
        key = frozenset(ordered)
        if key in self.pool or key in self.dropped:
            return
        reach = max(fit.evidence for fit in self.pool.values()) - FAR
        found, before = start, -np.inf
        for found in iterates(self.problem, ordered, start.noise, start):
            if found.evidence + FAR_GAINS * max(found.evidence - before, 0.0) < reach:
                self.dropped.add(key)
                return
            before = found.evidence
        self.pool[key] = found

    def view(self, about: Fit, terms: Sequence[Term], std: Floats, own: Derivatives | None = None) -> Screen:
        """Screen the candidates about a fit; their derivatives are `own` or those about the model without effects."""
        return screen(self.problem, about, terms, std, own or self.derivatives_about())

    def derivatives_about(self, about: Fit | None = None) -> Derivatives:
        """Derivatives about a fit, or about the model without effects, which are computed once for all fits."""
        if self.derivatives is None:
            self.derivatives = Derivatives(self.problem, self.fitted(()))
        return self.derivatives if about is None else Derivatives(self.problem, about, self.derivatives)

    def other_shapes(self, hypothesis: Fit) -> list[tuple[float, Fit]]:
        """Other shapes of the same effects, each with its probability among these shapes."""
        own = sorted(term.label for term in hypothesis.terms)
        fits = [fit for fit in self.pool.values() if sorted(term.label for term in fit.terms) == own]
        score = np.array([self.score(fit) for fit in fits])
        weight = np.exp(score - score.max())
        return [(float(w / weight.sum()), fit) for w, fit in zip(weight, fits, strict=True) if fit is not hypothesis]

    def best(self, fits: Iterable[Fit] | None = None) -> Fit:
        """The fit with the highest score."""
        return max(self.pool.values() if fits is None else fits, key=self.score)


def run(search: Search) -> Fit:
    """Fit hypotheses and return the best one, in which every effect is needed.

    Returns
    -------
    the fit with the highest score, after removal of effects that gain less than `needed`
    """
    nothing = search.fitted(())
    views = [search.view(nothing, search.named, std) for std in (search.noise.start, nothing.noise.std)]
    for terms in _promising_singles(search, views):
        search.tried(terms, nothing)
    for terms in _promising_pairs(search, views[0]):
        search.tried(terms, nothing)
    for step in range(REST.most_effects):
        best = search.best()
        leaders = sorted(search.pool.values(), key=search.score, reverse=True)[:3]
        for leader in leaders:
            _extend(search, leader, search.named, REST.forward)
        if step > 0 and search.best() is best:
            break
    _exchange(search)
    _rivals(search)
    return pruned(search, search.best())


def _by_promise(view: Screen, problem: RestProblem, impossible: int) -> Iterator[int]:
    """Iterate over the candidates, best first, with at most `impossible` start values of a place that are not possible.

    A linearised spring that pushes instead of pulling often fits better than the true one, whose form is not adjusted
    yet; the adjustment of others leads to the true one.
    """
    seen = Counter[Label]()
    for index in np.argsort(-view.log_bayes).tolist():
        term = view.terms[index]
        if not all(term.linear) and not term.plausible(term.completed(view.estimate(index)), problem.rows):
            seen[term.label] += 1
            if seen[term.label] > impossible:
                continue
        yield index


def _promising_singles(search: Search, views: Sequence[Screen]) -> list[tuple[Term, ...]]:
    out: list[tuple[Term, ...]] = []
    for view in views:
        seen: dict[Label, int] = {}
        for index in _by_promise(view, search.problem, REST.shapes_fitted // 2):
            term = view.terms[index]
            seen[term.label] = seen.get(term.label, 0) + 1
            limit = REST.shapes if all(term.linear) else REST.shapes_fitted
            if seen[term.label] > limit or len(seen) > REST.singles:
                continue
            out.append((term,))
    return list(dict.fromkeys(out))


def _promising_pairs(search: Search, view: Screen) -> list[tuple[Term, ...]]:
    """Pairs of places (effect and axis or link) with the highest joint log Bayes factor, each in its best shape."""
    best: dict[Label, int] = {}
    for index in _by_promise(view, search.problem, 0):
        best.setdefault(view.terms[index].label, index)
    chosen = list(best.values())
    pairs = np.array(list(itertools.combinations(chosen, 2)))
    if not len(pairs):
        return []
    values = pair_log_bayes(view, pairs[:, 0], pairs[:, 1])
    top = np.argsort(-values)[: REST.pairs]
    return [(view.terms[a], view.terms[b]) for a, b in pairs[top]]


def _extend(
    search: Search, leader: Fit, candidates: Sequence[Term], count: int, own: Derivatives | None = None
) -> None:
    """Fit the hypotheses that add one of the most promising candidates to a leading hypothesis."""
    if len(leader.terms) >= REST.most_effects or any(term not in search.named for term in leader.terms):
        return
    taken = {term.label for term in leader.terms}
    open_terms = [term for term in candidates if term.label not in taken]
    for std in (leader.noise.std, search.noise.start):
        view = search.view(leader, open_terms, std, own)
        seen: dict[Label | Term, int] = {}
        for index in _by_promise(view, search.problem, REST.shapes_added // 2):
            term = view.terms[index]
            key = term.label if term.name != UNNAMED else term
            shapes = 1 if all(term.linear) else REST.shapes_added
            if seen.get(key, 0) >= shapes:
                continue
            if (key not in seen and len(seen) >= count) or view.log_bayes[index] + search.prior[term] < -2.0:
                break
            seen[key] = seen.get(key, 0) + 1
            search.tried((*leader.terms, term), leader)


def _exchange(search: Search) -> None:
    """Replace each effect of the best hypothesis by others and by its other shapes, until none is better.

    The best time of a shift depends on the effects that were added after it. The deflection of a joint depends on the
    torque that a balancer takes off it.
    """
    best = None
    while best is not search.best():
        best = search.best()
        for term in best.terms:
            without = search.fitted([other for other in best.terms if other is not term], best)
            _extend(search, without, search.named, REST.forward, search.derivatives_about(without))


def _rivals(search: Search) -> None:
    """Fit unnamed torque curves in addition to the best hypothesis, and in place of each of its necessary effects.

    A nuisance is fitted in place of the effect only that it looks like. An unnecessary effect beside it would hide it.
    """
    best = pruned(search, search.best())
    _extend(search, best, [curve for curve in search.unnamed if not curve.looks_like], REST.unnamed)
    for term in best.terms:
        without = search.fitted(tuple(other for other in best.terms if other is not term))
        curves = [curve for curve in search.unnamed if curve.looks_like in ("", term.name)]
        _extend(search, without, curves, REST.unnamed)


def pruned(search: Search, chosen: Fit) -> Fit:
    """Return the hypothesis without unnecessary effects."""
    while chosen.terms:
        smaller = [search.fitted([t for t in chosen.terms if t is not term], chosen) for term in chosen.terms]
        best = max(smaller, key=search.score)
        if search.score(chosen) - search.score(best) >= REST.needed:
            return chosen
        chosen = best
    return chosen
