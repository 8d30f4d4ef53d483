"""Nuisance parameters of every hypothesis: their columns, their places, and their priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.identify.knowledge import Knowledge
from gateway.identify.nuisance import UNEVEN_LOSS, bias_std_nm
from gateway.identify.rest.linear import common_columns, modelled, with_terms
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_nuisance import KINDS, GainChanges, RestNuisance, left_of_cold, nuisance_setting
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.model.effects.axis_coupling import TorqueMixing
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.torque_constant_scale import TorqueConstantScale
from gateway.model.effects.torque_offset import FrictionByDirection, TorqueOffset
from gateway.model.visits import pair_visits
from tests.data.resting_arm import Bench, problem_of, undirected

N = 6


def one_sided(table):
    """Of every visit one side, by turns."""
    return table.take(np.arange(0, len(table.pose), 2) + np.arange(len(table.pose) // 2) % 2)


def place_of(problem, rng):
    """Links, loads, bands and nuisance parameters as an arm might have them, all of them away from nothing."""
    links = problem.links * rng.uniform(0.8, 1.2, len(problem.links))
    loads = np.array([[8.0, 0.4, -0.3, 0.9]] * len(problem.labels))
    band = np.abs(np.nan_to_num(problem.rows.sum_nm)).mean(axis=0) * 0.2 + 1.0
    nuisance = np.concatenate(
        [
            rng.uniform(-0.05, 0.05, N),
            rng.uniform(-1.0, 1.0, N),
            rng.uniform(0.02, 0.1, N),
            rng.uniform(0.1, 0.9, N),
            rng.uniform(0.1, 0.4, 2 * N),
            rng.uniform(-0.02, 0.02, problem.nuisance.changes.count),
        ]
    )
    return links, loads, band, nuisance


def predicted(problem, links, loads, band, nuisance, terms=(), theta=()):
    return modelled(problem, with_terms(problem, terms, theta, nuisance), links, loads, band)


@pytest.mark.parametrize("seen", [lambda table: table, one_sided, undirected], ids=["both", "one side", "no side"])
@pytest.mark.parametrize("declared", [1.0, 0.85], ids=["lossless", "efficiency declared"])
@pytest.mark.parametrize("coupled", [False, True], ids=["apart", "coupled"])
def test_columns_are_finite_differences_of_the_modelled_rows(seen, declared, coupled):
    bench = Bench(3, [], poses=6)
    bench.options = replace(bench.options, efficiency=np.full(N, declared))
    problem = problem_of(bench, seen(bench.both()))
    links, loads, band, nuisance = place_of(problem, np.random.default_rng(2))
    terms = [TorqueMixing(4, 5)] if coupled else []
    theta = [np.array([0.3])] if coupled else []
    setting = with_terms(problem, terms, theta, nuisance)
    columns = common_columns(problem, setting, links, loads, band).dense
    half_sums = problem.group % (2 * N) < N
    parameters = np.concatenate([links, loads.ravel(), band, nuisance])
    cuts = [4 * N, 4 * N + loads.size, 5 * N + loads.size]
    for place in range(problem.n_common):
        step = 1e-5 * max(1.0, abs(parameters[place]))
        sides = []
        for sign in (1.0, -1.0):
            parts = np.split(parameters + sign * step * (np.arange(len(parameters)) == place), cuts)
            sides.append(predicted(problem, parts[0], parts[1].reshape(-1, 4), *parts[2:], terms, theta))
        slope = (sides[0] - sides[1]) / (2.0 * step)
        gain = cuts[2] <= place < cuts[2] + N or place >= cuts[2] + len(KINDS) * N
        if place < cuts[1] or gain:  # half sums alone determine weights and gains
            assert not columns[~half_sums, place].any()
            slope = np.where(half_sums, slope, 0.0)
        if cuts[1] <= place < cuts[2] and not problem.sided[place - cuts[1]]:
            assert not columns[half_sums, place].any()
            continue
        if gain:  # in shares of the gain that the axis has, which is 1 to some hundredths
            np.testing.assert_allclose(columns[:, place], slope, rtol=0.15, atol=2e-3 * max(np.abs(slope).max(), 1e-3))
            continue
        np.testing.assert_allclose(columns[:, place], slope, rtol=2e-3, atol=2e-3 * max(np.abs(slope).max(), 1e-3))


def test_each_kind_does_what_it_is_called():
    """Against the readings of both sides written out by hand, of one axis that carries a known torque."""
    bench = Bench(3, [], poses=6)
    problem = problem_of(bench, bench.both())
    links, loads, band, nuisance = place_of(problem, np.random.default_rng(4))
    gain, bias, nu, one, fast, slow = nuisance[: len(KINDS) * N].reshape(len(KINDS), N)
    shared = nuisance[len(KINDS) * N :]
    assert len(problem.nuisance.changes.occasions) == 2
    assert len(shared) == 1 + 3 * (N + 1)
    bodies = problem.model.bodies(
        with_terms(problem, [], [], nuisance), links, problem.fixed_load + problem.member @ loads
    )
    torque = np.einsum("nak,nk->na", problem.model.nominal, bodies)
    since = problem.rows.time_s - problem.rows.time_s.min()
    second = problem.rows.load != problem.rows.load[int(np.argmin(since))]
    warm, changes = 1.0 - np.exp(-since / 1800.0), shared[1:].reshape(3, N + 1)
    gain = (
        gain
        + shared[0]
        + ~second[:, None] * (changes[0, :N] + changes[0, N])
        + second[:, None] * (changes[1, :N] + changes[1, N])
        + warm[:, None] * (changes[2, :N] + changes[2, N])
    )
    cold = (
        1.0
        + np.outer(np.exp(-since / REST_MODEL.warm_fast_s), fast)
        + np.outer(np.exp(-since / REST_MODEL.warm_slow_s), slow)
    )
    bands = band * cold
    # of one efficiency: its mean with its inverse, and within the band a motor that lifts on both sides
    mean = np.sqrt(1.0 + nu**2) - 1.0
    left = one * (mean * torque + nu * np.clip(torque, -bands, bands))
    half_sum = (1.0 + gain) * (torque + bias + left)
    lost = (1.0 - one) * np.abs(torque) + one * np.maximum(np.abs(torque), bands)
    difference = (1.0 + gain) * ((1.0 + one * mean) * bands + nu * lost)
    expected = np.concatenate([half_sum[problem.use_sum], difference[problem.use_difference]])
    assert predicted(problem, links, loads, band, nuisance) == pytest.approx(expected)


def test_friction_by_direction_follows_the_friction_of_each_visit():
    bench = Bench(3, [], poses=6)
    problem = problem_of(bench, bench.both())
    links, loads, band, nuisance = place_of(problem, np.random.default_rng(4))
    term, axis = FrictionByDirection(1, 10.0), 1
    setting = with_terms(problem, [], [], nuisance)
    bodies = problem.model.bodies(setting, links, problem.fixed_load + problem.member @ loads)
    torque = problem.model.joint_torque(setting, bodies)[0][:, axis]
    symmetric = (1.0 - setting.one_efficiency[axis]) * setting.load_friction[axis]
    friction = band[axis] * setting.band_gain[:, axis] + symmetric * np.abs(torque)
    more = predicted(problem, links, loads, band, nuisance, [term], [np.array([2.0])])
    more -= predicted(problem, links, loads, band, nuisance)
    assert more[problem.group == axis] == pytest.approx(setting.gain[:, axis] * 0.2 * friction)
    assert more[problem.group != axis] == pytest.approx(0.0, abs=1e-9)
    assert term.plausible(np.array([14.0]), problem.rows)
    assert not term.plausible(np.array([16.0]), problem.rows)  # friction would drive the joint in one direction


def test_a_gear_of_one_efficiency_leaves_what_the_nuisance_column_says():
    """Motor over joint torque by efficiency, driving and driven back, with no formula of the model."""
    eta, torque, band = 0.9, np.linspace(-80.0, 80.0, 9), 5.0
    sides = [torque + band, torque - band]
    up = np.where(sides[0] > 0, sides[0] / eta, sides[0] * eta)
    down = np.where(sides[1] < 0, sides[1] / eta, sides[1] * eta)
    nu = (1.0 / eta - eta) / 2.0
    middle = torque + nu * (0.5 * nu * torque + np.clip(torque, -band, band))
    away = np.abs(torque) > band
    # nu squared over two stands for what the mean of eta and its inverse exceeds one by
    assert (up + down)[away] / 2.0 == pytest.approx(middle[away], abs=nu**3 * 80.0)
    assert (up - down)[away] / 2.0 == pytest.approx((band + nu * np.abs(torque))[away], rel=0.01)


def test_an_effect_takes_the_place_of_its_own_axis_alone():
    changes = GainChanges.none(np.full(N, 0.03))
    nuisances = RestNuisance(
        np.zeros(len(KINDS) * N + 1), np.ones(len(KINDS) * N + 1), np.ones(N), changes, np.full(N, 0.05)
    )
    terms = [TorqueOffset(1), TorqueConstantScale(4), TorqueConstantScale(None), LoadDependentFriction(2)]
    assert nuisances.taken_over(terms).tolist() == [N + 1, 4, len(KINDS) * N, 2 * N + 2]
    assert nuisances.taken_over([]).tolist() == []


def test_friction_fades_from_the_first_visit_on():
    bench = Bench(3, [], poses=6)
    rows = problem_of(bench, bench.both()).rows
    fast, slow = (left_of_cold(rows, time_s) for time_s in (REST_MODEL.warm_fast_s, REST_MODEL.warm_slow_s))
    first = int(np.argmin(rows.time_s))
    assert fast[first] == slow[first] == 1.0
    later = rows.time_s - rows.time_s.min()
    assert np.log(fast) == pytest.approx(-later / REST_MODEL.warm_fast_s)
    assert np.log(slow) == pytest.approx(-later / REST_MODEL.warm_slow_s)
    none = nuisance_setting(rows, np.zeros(len(KINDS) * N + 1), GainChanges.none(np.full(N, 0.03)).patterns(rows))
    assert (none.band_gain == 1.0).all()
    assert (none.gain == 1.0).all()


def test_priors_are_those_of_constants_and_of_the_friction_that_is_seen():
    gain_std, lost = np.full(N, 0.02), np.linspace(0.0, 0.2, N)
    band = np.arange(1.0, 7.0)
    prior = RestNuisance.of(gain_std, bias_std_nm(band, lost), lost, GainChanges.none(gain_std))
    mean, std = (each[: len(KINDS) * N].reshape(len(KINDS), N) for each in (prior.mean, prior.std))
    assert dict(zip(KINDS, mean[:, 0], strict=True)) == pytest.approx(
        {"gain": 0, "bias": 0, "load_friction": 0.05, "one_efficiency": 0.5, "cold_fast": 0, "cold_slow": 0}
    )
    # half of the variance of the constants is that of all axes
    assert std[0] == pytest.approx(np.hypot(0.02 * np.sqrt(0.5), UNEVEN_LOSS * lost))
    assert prior.std[len(KINDS) * N :] == pytest.approx([0.02 * np.sqrt(0.5)])
    # a gear of one efficiency leaves up to its loss times the band in the middle, besides the tenth of all
    assert std[1] == pytest.approx(np.hypot(0.1, 0.5 * lost) * band)
    assert prior.constants == pytest.approx(0.02**2 / (0.02**2 + 2.0 * (UNEVEN_LOSS * lost) ** 2))
    with pytest.raises(ValueError, match="read-only"):
        prior.mean[0] = 1.0
    assert (std[2] == 0.05).all()


def test_an_axis_that_was_not_measured_has_the_prior_of_every_arm():
    bench = Bench(3, [], poses=6)
    table = bench.both()
    blind = replace(table, tau_nm=np.where(np.arange(N) == 3, np.nan, table.tau_nm))
    problem = build_problem(bench.robot, pair_visits(blind, bench.options.efficiency), Knowledge())
    assert np.isfinite(problem.nuisance.std).all()
    assert (problem.nuisance.std > 0).all()
