"""Candidate formula for structure that no effect of the library explains: a sparse sum of dictionary terms.

The formula is chosen by evidence, where every term of the dictionary is equally likely a priori, so the size of the
dictionary is paid for. It is tested on poses that were left out of its choice: for each pose, the formula that the
other poses choose. It counts only if it makes those poses much more likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.rest.holdout import chosen_with_density, left_out_poses, reduced_by_pose
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.rest_outcome import LARGEST_ODDS, Judge, summary
from gateway.diagnose.rest.search import Search
from gateway.diagnose.rest.verdict import Decision, in_std
from gateway.identify.rest.linear import Fit
from gateway.model.effect import RestSetup
from gateway.model.formula import formula_terms, pieces
from gateway.model.robot import Robot
from gateway.model.term import Term
from gateway.model.unnamed import Pull
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


def candidate_formula(
    search: Search, decision: Decision, setup: RestSetup, judge: Judge, robot: Robot
) -> CandidateFormula | None:
    """Return the formula for the structure that a decision leaves unexplained; None if there is none.

    Parameters
    ----------
    search : Search
    decision : Decision
        Its named effects stay in the fit.
    setup : RestSetup
    judge : Judge
        Of the decision; held-out rows test the formula too.
    robot : Robot
    """
    if decision.verdict not in ("unexplained", "improved"):
        return None
    base = decision.after
    formulas = _Formulas(search, base, formula_terms(search.problem.rows, setup))
    formulas.extend()
    best = max(formulas.fits, key=formulas.score)
    if best is formulas.fits[0]:
        return None
    problem = search.problem
    scores = [formulas.score(fit) for fit in formulas.fits]
    by_others, density = chosen_with_density(problem, formulas.fits, scores)
    without, density_without = left_out_poses(problem, formulas.fits[0])
    # by chance, such a gain of log(1 / p) has a probability of at most p (Markov's inequality)
    gained = float((density - density_without).sum())
    if gained < REST.needed or in_std(reduced_by_pose(problem, by_others, without, best.noise.std)) < REST.unseen:
        return None
    joints = tuple(sorted({joint for term in formulas.own(best) for joint in term.joints}))
    if any(isinstance(term, Pull) for term in formulas.own(best)):
        joints = ()
    axes = [joint - 1 for joint in joints] or range(problem.axes)
    ratio = Held.of_rows(by_others, problem.axis, problem.axes).over(
        Held.of_rows(without, problem.axis, problem.axes), axes, best.noise.std[problem.group][:, None]
    )
    if judge.held is not None:
        ratio = judge.ratio(best, formulas.fits[0], joints)
        if ratio >= 1.0:
            return None
    near = [fit for fit in formulas.fits if fit is not best and formulas.odds(best, fit) < REST.ask_odds]
    near = sorted(near, key=formulas.score, reverse=True)
    shown = np.isin(problem.group, axes)  # half-sums
    result = Formula(
        joints=joints,
        pieces=formulas.pieces(best),
        holdout_rms_ratio=ratio,
        p_value=max(float(np.exp(-gained)), float(np.finfo(float).tiny)),
        runner_up=_text(formulas.own(near[0])) if near else None,
        odds=formulas.odds(best, near[0]) if near else LARGEST_ODDS,
        after=summary(problem, best, judge, robot),
        predicted_nm=tuple((without - by_others)[shown].tolist()),
        residual_nm=tuple(without[shown].tolist()),
    )
    return CandidateFormula(result, (best, *near))


class _Formulas:
    """Formulas on top of a fit; the first of `fits` is that fit without a formula."""

    def __init__(self, search: Search, base: Fit, terms: Sequence[Term]) -> None:
        self._search = Search(search.problem, search.named, tuple(terms), search.noise)
        self._base = base.terms
        self.fits = [self._search.fitted(base.terms, base)]

    def score(self, fit: Fit) -> float:
        """Log odds of a formula."""
        return self._search.score(fit) - REST.needed * len(self.own(fit))

    def own(self, fit: Fit) -> tuple[Term, ...]:
        """Return the terms of the formula of a fit."""
        return tuple(term for term in fit.terms if term not in self._base)

    def pieces(self, fit: Fit) -> tuple[FormulaPiece, ...]:
        """Return the products of the formula of a fit with their coefficients."""
        own = self.own(fit)
        return tuple(
            FormulaPiece(each.expression, float(each.sign * value), float(abs(each.sign) * error), each.unit)
            for term, theta, std in self._search.sized(fit)
            if term in own
            for each, value, error in zip(pieces(term), theta, std, strict=True)
        )

    def odds(self, best: Fit, other: Fit) -> float:
        """Return the odds of one formula against another."""
        return float(np.exp(min(self.score(best) - self.score(other), np.log(LARGEST_ODDS))))

    def extend(self) -> None:
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
        beside = any(isinstance(term, Pull) for term in own)
        open_terms = [
            term
            for term in self._search.unnamed
            if term not in own and (not own or (term.joints in places and not beside and not isinstance(term, Pull)))
        ]
        view = self._search.view(leader, open_terms, leader.noise.std)
        best = np.argsort(-view.log_bayes)[: REST.singles]
        return [self._search.fitted((*leader.terms, view.terms[k]), leader) for k in best]


def _text(own: Sequence[Term]) -> str:
    """Return the products of a formula without coefficients."""
    return ", ".join(each.expression for each in chain.from_iterable(pieces(term) for term in own)) or "no formula"
