"""Diagnosis of rest visits: search for missing effects, and report with or without held-out rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.quantities import inertials_text
from gateway.data.table import Table
from gateway.diagnose.rest.formula import Formulas, candidate_formula, searched_formulas
from gateway.diagnose.rest.holdout import (
    Unseen,
    fresh_misfit,
    fresh_seen_nm,
    predicted,
    prediction_covariance,
    spare_rows,
)
from gateway.diagnose.rest.pose_selection import PoseChoice, questions
from gateway.diagnose.rest.residual_structure import structure_seen_nm
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.rest_mistakes import (
    Mistake,
    band_signs,
    beyond_any_effect,
    elastic_joints,
    find_mistakes,
    friction_by_direction,
    links_far_from_cad,
    suspicious,
    unseen_ratio,
)
from gateway.diagnose.rest.rest_outcome import (
    Judge,
    at_the_edge,
    contradicted,
    corrected_links,
    factor_rival,
    limits,
    mistake_effect,
    mistake_findings,
    possible,
    proven,
    rejected,
    summary,
)
from gateway.diagnose.rest.rest_plots import pictures
from gateway.diagnose.rest.ripple import ripple_remarks, with_ripple
from gateway.diagnose.rest.search import Search, run
from gateway.diagnose.rest.verdict import Decision, decide, noise_floor, without_names
from gateway.errors import DataUnusable
from gateway.estimate import to_result
from gateway.estimate.estimate import bare_of
from gateway.estimate.handover import MISFIT, reversed_signs
from gateway.estimate.joint import estimate_joint
from gateway.identify.conflict import SettledKnowledge, settle, two_bodies, without_placeholder
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import REFUSED, refused_findings
from gateway.identify.mass_change import mass_changes, reversed_gravity
from gateway.identify.outliers import Outliers, find_outliers
from gateway.identify.prior_loads import BARE_LABEL, require_postures
from gateway.identify.rest.hypothesis_fit import fit, fit_without_effects, with_place_effects
from gateway.identify.rest.linear import Fit, RestProblem, visit_loads
from gateway.identify.rest.problem import build_problem, sides_unknown
from gateway.identify.rest.rest_loads import loads_of, nuisance_results, spread_by_shape
from gateway.identify.rest.start_noise import settled_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import LIBRARY, terms_at_rest
from gateway.model.robot import Robot
from gateway.model.unnamed import unnamed_terms
from gateway.model.visits import Visits, joined, pair_visits
from gateway.result.data_roles import CHOSEN_ON, FIT, HELD_ROLE, VALIDATION
from gateway.result.result import EffectResult, Finding, FitSummary, HoldoutKind, LoadResult, Result, Verdict
from gateway.result.values import numbers

Floats = NDArray[np.float64]

#: A verdict once something was found beside the search, and once rows that no fit has seen contradict it.
MORE: Final[Mapping[Verdict, Verdict]] = {
    "none_needed": "explained",
    "explained": "explained",
    "improved": "improved",
    "unexplained": "improved",
    "undecided": "undecided",
}
LESS: Final[Mapping[Verdict, Verdict]] = {
    "none_needed": "unexplained",
    "explained": "improved",
    "improved": "improved",
    "unexplained": "unexplained",
    "undecided": "undecided",
}


@dataclass(frozen=True, slots=True)
class ReadVisits:
    """Visits of a table without rejected outliers, and the fit without effects.

    `rejected` (rows, N) marks the torques of the table's rows that are rejected: a correction of the rows can change
    which of them make a visit.
    """

    table: Table
    outliers: Outliers
    rejected: NDArray[np.bool_]
    problem: RestProblem
    plain: Fit


@dataclass(frozen=True, slots=True)
class Found:
    """Finished search: the visits as `read`, and `now` with the commissioning mistakes corrected.

    `settled` is the knowledge as tested against these visits, if it was tested. `rival` is the wrong constant or the
    factor of sqrt 2 that explains an axis about as well. `conflict` is the knowledge whose robot model the visits
    contradict so far that no load may be given.
    """

    read: ReadVisits
    now: ReadVisits
    search: Search
    chosen: Fit
    mistakes: tuple[Mistake, ...]
    gained: float
    setup: RestSetup
    settled: SettledKnowledge | None = None
    rival: EffectResult | None = None
    conflict: SettledKnowledge | None = None

    @property
    def score(self) -> float:
        """Score of the best hypothesis on the uncorrected data."""
        scale = 0.0
        for mistake in self.mistakes:
            axes = self.search.problem.axis + 1
            scale -= float(np.sum(np.isin(axes, mistake.joints))) * float(np.log(mistake.factor))
        signs = band_signs(self.search.problem, self.chosen)
        against = sum(REST.surer + mistake.handicap for mistake in self.mistakes)
        return self.search.score(self.chosen) + signs + scale - against

    @property
    def taken_back(self) -> bool:
        """Return True if a scale effect of the same axis cancels a corrected factor."""
        factors = {joint for mistake in self.mistakes if mistake.factor != 1.0 for joint in mistake.joints}
        scaled = {j for term in self.chosen.terms if term.scales_reading for j in term.joints}
        return bool(factors & scaled)


class RestDiagnosis:
    """Diagnosis of rest visits in two steps: search, then report with or without held-out rows.

    The parameters are those of `diagnose`. `stated` is the knowledge as it is stated, `knowledge` that in use.
    """

    def __init__(
        self,
        robot: Robot,
        knowledge: Knowledge,
        *,
        only: frozenset[str] = frozenset(),
        without: frozenset[str] = frozenset(),
        pose_choice: PoseChoice = None,
    ) -> None:
        self.robot, self.stated, self.pose_choice = robot, knowledge.of_robot(robot), pose_choice
        self.allowed = (only or frozenset(LIBRARY)) - without
        self.knowledge, self.placeholder = without_placeholder(robot, self.stated)

    def _rows(self, table: Table) -> Visits:
        return pair_visits(table, self.stated.efficiency, self.stated.coupling)

    def outliers(self, rows: Visits) -> Outliers:
        """Outliers of the uncorrected visits."""
        return find_outliers(rows, self.robot, self.knowledge.gravity_m_s2)

    def read(self, table: Table) -> ReadVisits:
        """Read the visits of a table, reject outliers, and fit the rest without effects."""
        rows = self._rows(table)
        outliers = self.outliers(rows)
        problem = build_problem(self.robot, rows.unmeasured(outliers.mask), self.knowledge)
        rejected = rows.of_rows(outliers.mask, len(table))
        return ReadVisits(table, outliers, rejected, problem, fit_without_effects(problem))

    def problem(self, table: Table, rejected: NDArray[np.bool_], mistakes: Sequence[Mistake] = ()) -> RestProblem:
        """Build the problem from a table without its rejected torques (rows, N), with the mistakes corrected."""
        for mistake in mistakes:
            rejected = rejected[:, mistake.reading_of(rejected.shape[1])]
        visits = self._rows(_undone(table, mistakes))
        one, other = visits.rows.T
        return build_problem(self.robot, visits.unmeasured(rejected[one] | rejected[other]), self.knowledge)

    def search(self, read: ReadVisits) -> Found:
        """Fit the hypotheses, with commissioning mistakes corrected if the data require it."""
        build, problem = partial(self.problem, read.table, read.rejected), read.problem
        for label in problem.labels:
            require_postures(problem.rows.q_rad[problem.rows.load == label], label)
        mistakes: tuple[Mistake, ...] = ()
        gained = 0.0
        looked = beyond_any_effect(problem, read.plain)
        if looked:
            mistakes, gained = find_mistakes(build, self.allowed)
            if gained > REST.obvious and all(each.factor == 1.0 or each.handicap for each in mistakes):
                undone = self._undone(read, mistakes)
                if not suspicious(undone.problem, undone.plain):
                    at_once = self.searched(read, undone, mistakes, gained)
                    if not at_once.taken_back:
                        return at_once
        found = self.searched(read, read, (), 0.0)
        if not looked and (suspicious(problem, found.chosen) or links_far_from_cad(problem, read.plain)):
            mistakes, gained = find_mistakes(build, self.allowed)
        if mistakes:
            other = self.searched(read, self._undone(read, mistakes), mistakes, gained)
            if not other.taken_back:
                rival = factor_rival(mistakes, found.chosen, other.score - found.score)
                found = replace(max(found, other, key=lambda each: each.score), rival=rival)
        return self._with_statements_tested(found)

    def _undone(self, read: ReadVisits, mistakes: tuple[Mistake, ...]) -> ReadVisits:
        """Return the visits with the mistakes corrected in the problem."""
        problem = self.problem(read.table, read.rejected, mistakes)
        return replace(read, problem=problem, plain=fit_without_effects(problem))

    def _with_statements_tested(self, found: Found) -> Found:
        """Repeat the search with wider priors for contradicted statements, if these are the more likely cause.

        Wrong masses of the robot model look like wrong constants and links on most axes; so one wider prior competes
        with all effects by evidence. Where that is the prior of the links, the effects have the links as stated, since
        wrong ones would count twice against them. A known load is dropped if fewer effects explain the rows without
        it. If no effect was found, the result is that of `estimate`.
        """
        settled = settle(self.robot, found.now.problem.rows, self.knowledge, (found.now.problem, found.now.plain))
        if settled.knowledge is self.knowledge:
            return replace(found, settled=settled)
        if settled.knowledge.trust != self.knowledge.trust:
            search = replace(found.search, links_as_stated=True, averaged={})
            found = replace(found, search=search, chosen=self._chosen(search, found.setup))
        effects, search = found.chosen.terms, found.search
        likelier = not effects or settled.log_odds > search.log_odds(found.chosen, found.now.plain)
        if settled.conflict is not None and (likelier or settled.conflict.check != "link_masses"):
            return replace(found, conflict=settled)
        if not (likelier or settled.knowledge.stated_loads != self.knowledge.stated_loads):
            return found
        now = replace(found.now, problem=settled.problem, plain=settled.fit)
        other = self._knowing(settled.knowledge).searched(found.read, now, found.mistakes, found.gained)
        if not likelier and len(other.chosen.terms) >= len(effects):
            return found
        return replace(other, settled=settled, rival=found.rival)

    def _knowing(self, knowledge: Knowledge) -> RestDiagnosis:
        """Return a copy with other prior knowledge."""
        other = copy(self)
        other.knowledge = knowledge
        return other

    def searched(self, read: ReadVisits, now: ReadVisits, mistakes: tuple[Mistake, ...], gained: float) -> Found:
        """Fit the hypotheses to the visits `now`, which are those `read` with the mistakes corrected."""
        problem, plain = now.problem, now.plain
        noise = settled_noise(problem, plain)
        bodies = problem.model.bodies(plain.setting, plain.links, visit_loads(problem, plain.loads))
        torque, _ = problem.model.joint_torque(plain.setting, bodies)
        weighed = bool(self.knowledge.stated_loads) or self.knowledge.trust == 0.0
        drawn = np.where(np.isfinite(problem.link_std), problem.links, np.nan)
        setup = RestSetup(self.stated.gear_ratios(problem.axes), weighed, torque, drawn, self.robot)
        unknown = sides_unknown(problem.rows)
        named = [
            term
            for term in terms_at_rest(problem.rows, setup, self.allowed)
            if not (term.name == "torque_offset" and unknown[term.joints[0] - 1])
        ]
        search = Search(problem, tuple(named), tuple(unnamed_terms(problem.rows, setup)), noise)
        return Found(read, now, search, self._chosen(search, setup), mistakes, gained, setup)

    def _chosen(self, search: Search, setup: RestSetup) -> Fit:
        """Return the best hypothesis of a search."""
        chosen = run(search)
        if "torque_ripple" in self.allowed:
            chosen = with_ripple(search, chosen, setup.gear_ratio)
        return chosen

    def _held(self, found: Found, holdout: Table | None) -> Unseen | None:
        if holdout is None or holdout.moving.all():
            return None
        holdout = _undone(holdout.take(~holdout.moving), found.mistakes)
        seen = found.search.problem.rows
        unseen = self._rows(holdout)
        unseen = unseen.take(np.isin(unseen.load, [*seen.load, BARE_LABEL]))
        if not len(unseen):
            raise DataUnusable("the hold-out rows carry no load that is in the data: nothing to validate on")
        rows = joined([seen, unseen])
        outliers = self.outliers(rows)
        changes = found.search.problem.nuisance.changes
        both = build_problem(self.robot, rows.unmeasured(outliers.mask), self.knowledge, changes)
        return Unseen(both, both.visit >= len(seen), outliers.among(len(seen)))

    def _upheld(self, found: Found, holdout: Table | None) -> Found:
        """Return the search without mistakes whose correction worsens the fit to held-out rows."""
        if not found.mistakes or holdout is None or holdout.moving.all():
            return found
        read = self.searched(found.read, found.read, (), 0.0)
        held, undone = self._held(read, holdout), self._held(found, holdout)
        if held is None or undone is None:
            return found
        ratio = unseen_ratio(held, read.search.fitted(()), undone, found.search.fitted(()))
        return found if ratio < 1.0 else read

    def _before(
        self, decision: Decision, judge: Judge, found: Found, sided: bool, loads: tuple[LoadResult, ...] | None
    ) -> FitSummary:
        """Residuals and loads of the model without effects on the uncorrected data; `loads` of the fit, if known."""
        problem, before = judge.problem, decision.before
        second = np.isfinite(found.search.problem.rows.wind_up_rad).any()
        if found.mistakes or second or sided:
            table = found.read.table
            table = replace(table, q2nd_rad=np.full_like(table.q2nd_rad, np.nan))
            if sided:
                table = replace(table, direction=np.zeros_like(table.direction))
            problem = self.problem(table, found.read.rejected)
            judge, before, loads = Judge(problem, None), fit_without_effects(problem), None
        return summary(problem, before, judge, loads or loads_of(problem, with_place_effects(before), self.robot))

    def _as_estimated(self, visits: Visits, settled: SettledKnowledge | None) -> Result:
        """Return the result of `estimate`, for the case that no effect is named."""
        found = to_result(estimate_joint(visits, self.robot, self.stated, settled), self.robot, self.stated)
        return replace(found, findings=tuple(each for each in found.findings if each.check != MISFIT))

    def refusal(self, read: ReadVisits) -> Result | None:
        """Return the result of `estimate` if the mass under a label changes or gravity is reversed; else None.

        No effect is searched then: an effect that changes the load or the arm would absorb part of that error.
        """
        rows, changed = read.problem.rows, mass_changes(read.problem, read.plain)
        if (
            not changed
            and not two_bodies(self.robot, rows, self.knowledge)
            and not reversed_gravity(self.robot, read.problem, read.plain, self.knowledge)
        ):
            return None
        settled = settle(self.robot, rows, self.knowledge, (read.problem, read.plain))
        result = self._as_estimated(rows, settled)
        return replace(result, verdict="unexplained", findings=(*read.outliers.findings, *result.findings))

    def report(self, found: Found, holdout: Table | None = None, kind: HoldoutKind = "given") -> Result:
        """Build the result of a search; `holdout` are held-out rows, `kind` is their origin."""
        if found.conflict is not None:
            result = self._as_estimated(found.now.problem.rows, found.conflict)
            reported = (*found.read.outliers.findings, *mistake_findings(found.mistakes), *result.findings)
            return replace(result, verdict="unexplained", findings=reported)
        settled = found.settled
        if settled is not None and settled.knowledge is not self.knowledge:
            return self._knowing(settled.knowledge).report(found, holdout, kind)
        searched, found = found, self._upheld(found, holdout)
        search, problem = found.search, found.search.problem
        decision = decide(search, found.chosen)
        held = self._held(found, holdout)
        decision, findings = self._confirmed(decision, held, problem)
        confirmed, (decision, judge, shown, formulas) = decision, _named(found, decision, held)
        # a mistake or a name that the held-out rows took away is a choice made on them
        held_role = VALIDATION if found is searched and decision is confirmed else CHOSEN_ON
        effects = [entry for mistake in found.mistakes for entry in mistake_effect(mistake, found.gained)]
        effects += shown
        seen_by_encoder = elastic_joints(problem, decision.after) if "joint_elasticity" in self.allowed else []
        by_direction = friction_by_direction(problem, decision.after) if "static_friction" in self.allowed else []
        effects += seen_by_encoder + by_direction
        effects += possible(search, decision, judge) if decision.verdict == "undecided" else []
        verdict: Verdict = decision.verdict
        if found.mistakes or seen_by_encoder or by_direction:
            verdict = MORE[verdict]
        if found.rival is not None and any(effect.joints == found.rival.joints for effect in effects):
            effects, verdict = [*effects, found.rival], "undecided"
        alone = decision.after is decision.before and not found.mistakes
        # what the proof has confirmed is estimated from all visits, those of the proof included
        last = held if held is not None and kind == "fresh" and not findings else None
        last_problem = problem if last is None else last.problem
        if alone and not effects:
            judged, tested = (problem, settled) if held is None or kind != "fresh" else (held.problem, None)
            estimated = self._as_estimated(judged.rows, tested)
            loads, bare, band = estimated.loads, estimated.bare, estimated.friction_band_nm
            findings += [each for each in estimated.findings if each.severity == "fail" and each.check != REFUSED]
        else:
            fitted = decision.after
            band = numbers(fitted.friction_band_nm)
            by_shape = spread_by_shape(fitted, search.other_shapes(fitted))
            if last is not None:
                fitted = fit(last_problem, fitted.terms, fitted.noise, fitted)
            fitted = with_place_effects(fitted)
            loads = loads_of(last_problem, fitted, self.robot, by_shape)
            bare = None if found.mistakes else bare_of(last_problem, fitted, self.robot, self.stated)
        after = summary(problem, decision.after, judge, loads)
        before = self._before(decision, judge, found, bool(by_direction), loads if alone else None)
        if alone and (last is not None or not effects):
            before = replace(before, loads=loads)
        held_role = held_role if last is None else FIT
        floor = noise_floor(problem, decision)
        formula = candidate_formula(formulas, judge, self.robot) if formulas else None
        findings += corrected_links(decision) + at_the_edge(decision, problem)
        findings += (*self.placeholder, *(settled.findings if settled else ()), *found.read.outliers.findings)
        if "torque_ripple" in self.allowed:
            findings += ripple_remarks(search, decision.after, self.stated.gear_ratios(problem.axes))
        findings += (
            reversed_signs(problem.rows.difference_nm)
            + mistake_findings(found.mistakes)
            + refused_findings(after.loads)
            + limits(problem)
        )
        rows, drawn = pictures(problem, held, "fresh" if kind == "fresh" else "held out", decision)
        return Result(
            robot=self.robot.name,
            loads=after.loads,
            verdict=verdict,
            effects=tuple(effects),
            before=before,
            after=after,
            holdout_kind="blocks" if held is None else kind,
            noise_floor_nm=numbers(floor),
            friction_band_nm=band,
            rejected=tuple(rejected(search, decision)),
            formula=None if formula is None else formula.result,
            next=questions(
                problem, decision, self.robot, self.knowledge, self.pose_choice, () if formula is None else formula.fits
            ),
            findings=tuple(dict.fromkeys(findings)),
            nuisance=nuisance_results(problem, decision.after),
            set_aside=found.read.outliers.entries + (() if held is None else held.rejected),
            quality=structure_seen_nm(problem, decision.full, floor) | fresh_seen_nm(problem, held, decision.after),
            provenance={
                "visits": len(problem.rows),
                "poses": len(np.unique(problem.rows.pose)),
                "hypotheses": len(search.pool),
                "structure_p": decision.structure_p,
                HELD_ROLE: held_role,
                "inertials": inertials_text(self.knowledge.trust),
            },
            bare=bare,
            rows=rows,
            data=drawn,
        )

    def _confirmed(
        self, decision: Decision, held: Unseen | None, problem: RestProblem
    ) -> tuple[Decision, list[Finding]]:
        """Revise the decision by the held-out rows."""
        if held is None:
            return decision, []
        group = held.problem.group[held.mask]
        residual = predicted(held, decision.after)
        spare = spare_rows(problem, decision.after)
        chance = fresh_misfit(residual, prediction_covariance(held, decision.after), group, problem.axes, spare)
        if chance >= REST.fresh_p:
            return decision, []
        verdict = LESS[decision.verdict]
        finding = Finding(
            "warn",
            "hold-out",
            f"poses that were not used in the fit deviate by more than the noise (p-value {chance:.1g})",
            "add their measurements to the data and diagnose again",
        )
        return replace(decision, verdict=verdict), [finding]


def _named(
    found: Found, decision: Decision, held: Unseen | None
) -> tuple[Decision, Judge, list[EffectResult], Formulas | None]:
    """Return the decision with the names that neither held-out rows nor a formula take away, and the formulas."""
    judge = Judge.of(found.search, decision, held)
    shown = proven(found.search, decision, judge)
    kept = without_names(decision) if contradicted(found.search, decision, judge, shown) else decision
    formulas, kept = searched_formulas(found.search, kept, found.setup)
    if kept is not decision:
        judge, shown = Judge.of(found.search, kept, held), []
    return kept, judge, shown, formulas


def _undone(table: Table, mistakes: Sequence[Mistake]) -> Table:
    for mistake in mistakes:
        table = mistake.undo(table)
    return table
