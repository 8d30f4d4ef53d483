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
from gateway.diagnose.rest.holdout import left_out, left_out_poses, pose_of_rows
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.rest_outcome import LARGEST_ODDS, Judge, summary
from gateway.diagnose.rest.search import Search
from gateway.diagnose.rest.verdict import Decision
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
    by_others, gained = formulas.tested()
    std, without = best.noise.std[problem.group], left_out(problem, formulas.fits[0])
    _, pose = np.unique(pose_of_rows(problem), return_inverse=True)
    less = np.bincount(pose, weights=(without**2 - by_others**2) / std**2)
    if gained < REST.needed or less.sum() < REST.unseen * np.sqrt(len(less)) * less.std(ddof=1):
        return None
    joints = tuple(sorted({joint for term in formulas.own(best) for joint in term.joints}))
    if any(isinstance(term, Pull) for term in formulas.own(best)):
        joints = ()
    axes = [joint - 1 for joint in joints] or range(problem.axes)
    ratio = Held.of_rows(by_others, problem.axis, problem.axes).over(
        Held.of_rows(without, problem.axis, problem.axes), axes, std[:, None]
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
        pieces=_pieces(best, formulas.own(best)),
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

    def odds(self, best: Fit, other: Fit) -> float:
        """Return the odds of one formula against another."""
        return float(np.exp(min(self.score(best) - self.score(other), np.log(LARGEST_ODDS))))

    def tested(self) -> tuple[Floats, float]:
        """Left-out residual (rows,) [Nm] under the formula that the other poses choose, and its gain [log odds].

        The gain is the sum over the poses of the log density of a left-out pose, over that without a formula. Such a
        gain of log(1 / p) arises by chance with a probability of at most p (Markov's inequality).
        """
        problem = self._search.problem
        residual, density = (
            np.array(each) for each in zip(*(left_out_poses(problem, fit) for fit in self.fits), strict=True)
        )
        choice = np.argmax(np.array([self.score(fit) for fit in self.fits])[:, None] - density, axis=0)
        _, pose = np.unique(pose_of_rows(problem), return_inverse=True)
        gained = density[choice, np.arange(len(choice))] - density[0]
        return residual[choice[pose], np.arange(len(pose))], float(gained.sum())

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


def _pieces(fit: Fit, own: Sequence[Term]) -> tuple[FormulaPiece, ...]:
    """Return the products of a formula with their coefficients."""
    std = np.sqrt(np.maximum(np.diag(fit.covariance)[fit.problem.n_common :], 0.0))
    ends = np.cumsum([len(values) for values in fit.theta])[:-1]
    out: list[FormulaPiece] = []
    for term, theta, unsure in zip(fit.terms, fit.theta, np.split(std, ends), strict=True):
        if term in own:
            out += [
                FormulaPiece(each.expression, float(each.sign * value), float(abs(each.sign) * error), each.unit)
                for each, value, error in zip(pieces(term), theta, unsure, strict=True)
            ]
    return tuple(out)


def _text(own: Sequence[Term]) -> str:
    """Return the products of a formula without coefficients."""
    return ", ".join(each.expression for each in chain.from_iterable(pieces(term) for term in own)) or "no formula"
