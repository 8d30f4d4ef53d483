"""Candidate formula for structure that no effect of the library explains: a sparse sum of dictionary terms.

The formula is chosen by evidence, where every term of the dictionary is equally likely a priori, so the size of the
dictionary is paid for. It is tested on poses that were left out of its choice: for each pose, the formula that the
other poses choose. It counts only if it makes those poses much more likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.rest.holdout import chosen_with_density, left_out_poses, reduced_by_pose
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.rest_outcome import LARGEST_ODDS, Judge, summary
from gateway.diagnose.rest.search import Search
from gateway.diagnose.rest.verdict import Decision, in_std, without_names
from gateway.identify.rest.hypothesis_fit import with_place_effects
from gateway.identify.rest.linear import Fit
from gateway.identify.rest.rest_loads import loads_of
from gateway.model.effect import RestSetup
from gateway.model.formula import MECHANISMS, ON_ARM, Buffer, Knee, formula_terms, pieces
from gateway.model.robot import Robot
from gateway.model.term import Term
from gateway.result.result import Formula, FormulaPiece

Floats = NDArray[np.float64]

#: Terms of a formula at most [-].
MOST_TERMS: Final = 3
#: Leading formulas that are extended by a further term [-].
LEADERS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class CandidateFormula:
    """Formula of a result, with its fit and those of other formulas that further measurements could tell apart."""

    result: Formula
    fits: tuple[Fit, ...]


def searched_formulas(search: Search, decision: Decision, setup: RestSetup) -> tuple[Formulas | None, Decision]:
    """Return the formulas for the structure that a decision leaves unexplained, and the decision beside them.

    The named effects remain in the fit. If the law of another mechanism is more likely in place of all of them, they
    are no longer named. Other formulas may describe the same cause in other words: they leave the names.
    """
    if decision.verdict not in ("unexplained", "improved", "explained"):
        return None, decision
    terms, formulas = formula_terms(search.problem.rows, setup), None
    if decision.verdict == "explained":
        joints = {term.joints for term in decision.proven}
        terms = [term for term in terms if isinstance(term, (Knee, Buffer)) and term.joints in joints]
    else:
        formulas = Formulas(search, decision.after, terms)
    if decision.verdict == "unexplained":
        return formulas, decision
    named, alone = formulas or Formulas(search, decision.after, ()), Formulas(search, decision.before, terms)
    if alone.score(alone.best) - named.score(named.best) > _least_gain(alone.own(alone.best)):
        return alone, without_names(decision)
    return formulas, decision


def _least_gain(terms: Sequence[Term]) -> float:
    """Log odds from which a formula takes the place of names; infinite if it is not the law of one mechanism.

    A stop that is touched on one side also looks like a cable, which is more usual: no further measurement of the same
    size must be able to reverse it.
    """
    if terms and all(isinstance(term, MECHANISMS) for term in terms):
        return 0.0
    sides = {term.side if isinstance(term, Buffer) else None for term in terms}
    return float(np.log(REST.ask_odds)) if len(sides) == 1 and None not in sides else np.inf


def candidate_formula(formulas: Formulas, judge: Judge, robot: Robot) -> CandidateFormula | None:
    """Return the best formula if poses and rows outside its choice confirm it.

    Parameters
    ----------
    formulas : Formulas
    judge : Judge
        Of the decision; held-out rows test the formula too.
    robot : Robot
    """
    best, problem = formulas.best, formulas.problem
    if best is formulas.fits[0]:
        return None
    fits = [fit for fit in formulas.fits if formulas.score(fit) >= formulas.score(formulas.fits[0])]
    by_others, density = chosen_with_density(problem, fits, [formulas.score(fit) for fit in fits])
    without, density_without = left_out_poses(problem, formulas.fits[0])
    # by chance, such a gain of log(1 / p) has a probability of at most p (Markov's inequality)
    gained = float((density - density_without).sum())
    if gained < REST.needed or in_std(reduced_by_pose(problem, by_others, without, best.noise.std)) < REST.unseen:
        return None
    joints = tuple(sorted({joint for term in formulas.own(best) for joint in term.joints}))
    if formulas.on_arm(best):
        joints = ()
    axes = [joint - 1 for joint in joints] or range(problem.axes)
    ratio = Held.of_rows(by_others, problem.axis, problem.axes).over(
        Held.of_rows(without, problem.axis, problem.axes), axes, best.noise.std[problem.group][:, None]
    )
    if judge.held is not None:
        ratio = judge.ratio(best, formulas.fits[0], joints)
        if ratio >= 1.0:
            return None
    near = [fit for fit in formulas.different() if fit is not best and formulas.odds(best, fit) < REST.ask_odds]
    shown = np.isin(problem.group, axes)  # half-sums
    result = Formula(
        joints=joints,
        pieces=formulas.pieces(best),
        holdout_rms_ratio=ratio,
        p_value=max(float(np.exp(-gained)), float(np.finfo(float).tiny)),
        runner_up=formulas.text(near[0]) if near else None,
        odds=formulas.odds(best, near[0]) if near else LARGEST_ODDS,
        after=summary(problem, best, judge, loads_of(problem, with_place_effects(best), robot)),
        predicted_nm=tuple((without - by_others)[shown].tolist()),
        residual_nm=tuple(without[shown].tolist()),
    )
    return CandidateFormula(result, (best, *near))


class Formulas:
    """Formulas on top of a fit; the first of `fits` is that fit without a formula."""

    def __init__(self, search: Search, base: Fit, terms: Sequence[Term]) -> None:
        self._search = Search(search.problem, search.named, tuple(terms), search.noise)
        self._base = base.terms
        self.problem = search.problem
        self.fits = [self._search.fitted(base.terms, base)]
        self._extend()
        self.best = max(self.fits, key=self.score)

    def score(self, fit: Fit) -> float:
        """Log odds of a formula with the named effects beside it; each of both has to gain as much."""
        return self._search.score(fit) - REST.needed * len(fit.terms)

    def own(self, fit: Fit) -> tuple[Term, ...]:
        """Return the terms of the formula of a fit."""
        return tuple(term for term in fit.terms if term not in self._base)

    def on_arm(self, fit: Fit) -> bool:
        """Return True if the formula acts on the whole arm or its load."""
        return any(isinstance(term, ON_ARM) for term in self.own(fit))

    def pieces(self, fit: Fit) -> tuple[FormulaPiece, ...]:
        """Return the products of the formula of a fit with their coefficients."""
        own = self.own(fit)
        return tuple(
            FormulaPiece(each.expression, float(each.sign * value), float(abs(each.sign) * error), each.unit)
            for term, theta, std in self._search.sized(fit)
            if term in own
            for each, value, error in zip(pieces(term.shaped(theta[term.count :])), theta, std, strict=False)
        )

    def different(self) -> list[Fit]:
        """Return the formulas from the best on, those that differ by start values alone once."""
        kinds: dict[frozenset[Term], Fit] = {}
        for fit in sorted(self.fits, key=self.score, reverse=True):
            kind = frozenset(term.shaped(np.zeros(len(term.linear) - term.count)) for term in self.own(fit))
            kinds.setdefault(kind, fit)
        return list(kinds.values())

    def text(self, fit: Fit) -> str:
        """Return the products of the formula of a fit without coefficients."""
        return ", ".join(piece.expression for piece in self.pieces(fit)) or "no formula"

    def odds(self, best: Fit, other: Fit) -> float:
        """Return the odds of one formula against another."""
        return float(np.exp(min(self.score(best) - self.score(other), np.log(LARGEST_ODDS))))

    def _extend(self) -> None:
        """Add terms one by one to the leading formulas; all terms of a formula act on one axis."""
        leaders = self.fits[:1]
        for _ in range(MOST_TERMS):
            added = [fit for leader in leaders for fit in self._extended(leader)]
            self.fits += [fit for fit in dict.fromkeys(added) if fit not in self.fits]
            best = max(self.fits, key=self.score)
            if best not in added:
                return
            leaders = sorted(set(added), key=self.score, reverse=True)[:LEADERS]

    def _extended(self, leader: Fit) -> list[Fit]:
        own = self.own(leader)
        places = {term.joints for term in own}
        beside = self.on_arm(leader)
        open_terms = [
            term
            for term in self._search.unnamed
            if term not in own and (not own or (term.joints in places and not beside and not isinstance(term, ON_ARM)))
        ]
        view = self._search.view(leader, open_terms, leader.noise.std)
        best = np.argsort(-view.log_bayes)[: REST.singles]
        return [self._search.fitted((*leader.terms, view.terms[k]), leader) for k in best]
