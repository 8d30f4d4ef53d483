"""Poses that are left out choose nothing: densities, choices and gains by pose against fits done in full."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from benchmarks.blind.nature import run_effect
from gateway.diagnose import diagnose
from gateway.diagnose.rest import verdict
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.holdout import (
    Unseen,
    chosen_by_others,
    gained_by_pose,
    left_out,
    left_out_poses,
    prediction_covariance,
)
from gateway.diagnose.rest.rest_outcome import contradicted
from gateway.diagnose.rest.search import Search
from gateway.diagnose.rest.verdict import helped
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.linear import Noise
from gateway.model.effects.torque_offset import TorqueOffset
from tests.data.resting_arm import Bench, basis_of, effect, found

POSES, ROWS = 7, 5
NOISE = np.array([0.5, 2.0, 1.0])


class Linear:
    """A linear hypothesis with a normal prior on its coefficients, and its results in closed form."""

    def __init__(self, design, spread, target) -> None:
        self.design, self.spread, self.target = design, spread, target
        self.std = NOISE[np.arange(len(target)) % 3]
        weighted = design / self.std[:, None]
        root = np.linalg.cholesky(np.linalg.inv(weighted.T @ weighted + np.diag(spread**-2)))
        value = root @ root.T @ weighted.T @ (target / self.std)
        self.fit = SimpleNamespace(
            residual=target - design @ value, basis=basis_of(weighted @ root), noise=Noise(NOISE, NOISE, NOISE)
        )

    def evidence(self, keep) -> float:
        rows = self.design[keep] * self.spread
        return float(
            stats.multivariate_normal.logpdf(self.target[keep], cov=np.diag(self.std[keep] ** 2) + rows @ rows.T)
        )

    def predicted(self, keep) -> np.ndarray:
        """Residual of the rows that are not kept, by a fit of those that are."""
        rows = np.vstack([self.design[keep] / self.std[keep, None], np.diag(1.0 / self.spread)])
        right = np.concatenate([self.target[keep] / self.std[keep], np.zeros(len(self.spread))])
        value = np.linalg.lstsq(rows, right)[0]
        return (self.target - self.design @ value)[~keep]


POSE = np.repeat(np.arange(POSES), ROWS)
PROBLEM = SimpleNamespace(place=POSE, visit=np.arange(len(POSE)), group=np.arange(len(POSE)) % 3, axes=3)


def hypotheses(seed: int) -> list[Linear]:
    """Four sets of effects; the torque holds the second, weakly, so that the poses do not agree."""
    rng = np.random.default_rng(seed)
    common = rng.normal(size=(len(POSE), 3))
    more = [rng.normal(size=(len(POSE), width)) for width in (0, 1, 1, 2)]
    target = rng.normal(size=len(POSE)) * NOISE[PROBLEM.group] + common @ [2.0, -1.0, 1.0] + 0.4 * more[1][:, 0]
    return [Linear(np.hstack([common, each]), np.array([3.0] * 3 + [1.0] * each.shape[1]), target) for each in more]


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_predicted_with_its_density(seed):
    for linear in hypotheses(seed):
        residual, density = left_out_poses(PROBLEM, linear.fit)
        assert left_out(PROBLEM, linear.fit) == pytest.approx(residual)
        for pose in range(POSES):
            keep = pose != POSE
            assert residual[~keep] == pytest.approx(linear.predicted(keep))
            # the density of all rows is that of the others, times that of the pose given the others
            closed_form = linear.evidence(keep | True) - linear.evidence(keep) + ROWS / 2.0 * np.log(2.0 * np.pi)
            assert density[pose] == pytest.approx(closed_form)


def test_the_others_choose_as_if_the_pose_had_never_been_measured():
    different = 0
    for seed in range(12):
        linear = hypotheses(seed)
        everything = np.ones(len(POSE), dtype=bool)
        score = [each.evidence(everything) for each in linear]
        expected = np.empty(len(POSE))
        for pose in range(POSES):
            keep = pose != POSE
            choice = int(np.argmax([each.evidence(keep) for each in linear]))
            expected[~keep] = linear[choice].predicted(keep)
            different += choice != int(np.argmax(score))
        assert chosen_by_others(PROBLEM, [each.fit for each in linear], score) == pytest.approx(expected)
    assert different > 0  # else the choice of all would have passed as well


def test_what_one_pose_alone_asks_for_is_not_what_it_is_judged_by():
    rng = np.random.default_rng(3)
    common = rng.normal(size=(len(POSE), 2))
    strange = np.where(POSE == 4, 1.0, 0.05 * rng.normal(size=len(POSE)))[:, None]
    target = rng.normal(size=len(POSE)) * NOISE[PROBLEM.group] + common @ [2.0, -1.0] + 9.0 * (POSE == 4)
    plain = Linear(common, np.full(2, 3.0), target)
    named = Linear(np.hstack([common, strange]), np.array([3.0, 3.0, 10.0]), target)
    everything = np.ones(len(POSE), dtype=bool)
    score = [each.evidence(everything) - price for each, price in ((plain, 0.0), (named, 3.0))]
    assert score[1] > score[0] + 10.0
    residual = chosen_by_others(PROBLEM, [plain.fit, named.fit], score)
    assert residual[POSE == 4] == pytest.approx(plain.predicted(POSE != 4))
    assert np.abs(residual[POSE == 4]).mean() > 6.0


def test_what_an_effect_gains_is_counted_by_pose():
    plain, named = hypotheses(1)[:2]
    std = NOISE[PROBLEM.group]
    expected = []
    for pose in range(POSES):
        keep = pose != POSE
        squares = [np.sum((each.predicted(keep) / std[~keep]) ** 2) for each in (plain, named)]
        expected.append(squares[0] - squares[1])
    gained = gained_by_pose(PROBLEM, named.fit, plain.fit)
    assert gained == pytest.approx(expected)
    term = SimpleNamespace(name="made_up")
    named.fit.terms = (term,)
    search = SimpleNamespace(problem=PROBLEM, fitted=lambda terms, start: plain.fit)
    ratio = np.mean(expected) / (np.std(expected, ddof=1) / np.sqrt(POSES))
    assert helped(search, named.fit, term) == pytest.approx(ratio)


SPRING = effect("balancer_spring", [2], stiffness_n_m=2e4, lever_m=0.2, anchor_m=0.5, free_length_m=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "named"), [(1.0, True), (-1.0, False)])
def test_an_effect_that_left_out_poses_contradict_is_not_named(monkeypatch, gain, named):
    """The same data and the same fits; only what left-out poses say of the effect is turned round."""
    bench = Bench(4, [SPRING])
    options = bench.options
    seen = []

    def gained(problem, after, before):
        seen.append(len(after.terms))
        return gain * np.abs(gained_by_pose(problem, after, before))

    monkeypatch.setattr(verdict, "gained_by_pose", gained)
    result = diagnose(bench.both(), bench.robot, options, only=frozenset({"balancer_spring"}))
    assert seen
    assert (found(result) == [("balancer_spring", (2,))]) is named
    if not named:
        assert found(result) == []
        assert result.verdict == "unexplained"


@pytest.mark.slow
def test_what_is_reported_unseen_is_what_the_others_choose(monkeypatch):
    """The effect is worth less on poses that had no say in it than on those that had."""
    bench = Bench(4, [SPRING])
    table, options = bench.both(), bench.options
    honest = diagnose(table, bench.robot, options, only=frozenset({"balancer_spring", "base_tilt"}))
    assert honest.holdout_kind == "blocks"
    monkeypatch.setattr(
        "gateway.diagnose.rest.rest_outcome.unseen_by_choice", lambda search: left_out(search.problem, search.best())
    )
    chosen = diagnose(table, bench.robot, options, only=frozenset({"balancer_spring", "base_tilt"}))
    axis = 1
    assert honest.after.holdout_rms_nm[axis] >= 0.99 * chosen.after.holdout_rms_nm[axis]
    assert honest.before.holdout_rms_nm == chosen.before.holdout_rms_nm
    assert honest.after.holdout_rms_nm[axis] < 0.5 * honest.before.holdout_rms_nm[axis]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "axis"),
    [
        (effect("load_dependent_friction", [3], coefficient=0.5), 3),
        (effect("torque_constant_scale", [2], scale=0.85), 2),
    ],
    ids=lambda value: value["name"] if isinstance(value, dict) else "",
)
def test_an_effect_is_compared_with_the_nuisance_parameters(hidden, axis):
    """Compared with a nuisance parameter of as wide a prior, an effect would gain nothing."""
    bench = Bench(4, [hidden])
    result = diagnose(bench.both(), bench.robot, bench.options)
    assert found(result) == [(hidden["name"], (axis,))]
    assert result.effects[0].evidence.holdout_rms_ratio < 0.8


@pytest.mark.slow
def test_a_name_stays_while_its_odds_with_fresh_poses_are_large_enough():
    """Fresh poses deviate by more than the noise, with the effect or without it; its odds remain."""
    said = run_effect(94044)
    assert (said["verdict"], said["found"]) == ("improved", [("thermal_drift", [6])])


@pytest.mark.parametrize(("miss_nm", "likely"), [(0.0, True), (30.0, False)])
def test_fresh_poses_that_deny_an_effect_take_its_name_away(miss_nm, likely):
    """The odds of the search times the ratio of the densities of the fresh rows, by scipy."""
    bench = Bench(4, [effect("torque_offset", [2], offset_nm=40.0)])
    read = RestDiagnosis(bench.robot, bench.options).read(bench.both())
    problem, term = read.problem, TorqueOffset(1)
    after = fit(problem, (term,), read.plain.noise)
    fresh = problem.group == 1  # half-sums of J2, as if they were others
    held = Unseen(replace(problem, target=problem.target - np.where(fresh, miss_nm, 0.0)), fresh)
    search = Search(problem, (term,), (), read.plain.noise)
    log_density = []
    for each in (after, search.fitted(())):
        residual = each.residual[fresh] - miss_nm
        log_density.append(stats.multivariate_normal.logpdf(residual, cov=prediction_covariance(held, each)))
    odds = 20.0 * np.exp(log_density[1] - log_density[0])
    for factor in (1.1, 0.9):
        decision = SimpleNamespace(verdict="improved", after=after)
        for ratio in (0.9, 1.0):
            evidence = SimpleNamespace(odds=odds * factor, holdout_rms_ratio=ratio)
            named = SimpleNamespace(name="torque_offset", joints=(2,), evidence=evidence)
            taken = contradicted(search, decision, SimpleNamespace(held=held), [named])
            assert taken == (factor < 1.0 and ratio == 1.0)
    assert (odds < 1.0) == likely
