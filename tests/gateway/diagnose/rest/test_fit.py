"""A hypothesis at rest: its density, its evidence and its step against closed forms and another library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gateway.data.table import Table
from gateway.diagnose.rest.holdout import left_out
from gateway.identify.rest.hypothesis_fit import fit, over_factors
from gateway.identify.rest.linear import common_columns, modelled, with_terms
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effects.payload_shift import PayloadShift
from gateway.model.effects.torque_offset import TorqueOffset
from tests.data.resting_arm import Bench, effect, problem_of, single_joint_sweep, undirected


@pytest.fixture(scope="module")
def problem():
    bench = Bench(4, [effect("torque_offset", [2], offset_nm=40.0)])
    return problem_of(bench, bench.both())


@pytest.fixture(scope="module")
def fits(problem):
    noise = first_noise(problem)
    return fit(problem, (), noise), fit(problem, (TorqueOffset(1),), noise)


def density(problem, found) -> float:
    """Log density of rows, parameters and noise, by scipy's own distributions."""
    std = found.noise.std[problem.group]
    rows = stats.norm.logpdf(found.residual, scale=std).sum()
    expected = problem.common_mean
    expected[problem.taken_over(found.terms)] = 0.0
    parameters = np.concatenate([found.common - expected, found.flat_theta])
    held = np.isfinite(found.prior_std)
    # the prior's own constants belong to the evidence
    prior = -0.5 * np.sum((parameters[held] / found.prior_std[held]) ** 2)
    used = np.unique(problem.group)
    shape, start = REST_MODEL.noise_weight / 2.0, found.noise.start[used] ** 2
    noise = stats.invgamma.logpdf(found.noise.std[used] ** 2, shape, scale=shape * start) + np.log(start)
    return float(rows + prior + noise.sum())


def test_the_density_of_a_fit_is_that_of_its_distributions(problem, fits):
    plain, found = fits
    assert found.mode - plain.mode == pytest.approx(density(problem, found) - density(problem, plain), abs=1e-6)


def test_the_evidence_is_the_density_less_the_volume_of_the_priors(problem, fits):
    """Laplace: half the logarithm of the information, and the widths of the priors."""
    for found in fits:
        # the information of a step is that of the noise before it
        again = fit(problem, found.terms, found.noise, found, steps=1)
        held = np.isfinite(again.prior_std)
        weighted = again.columns.dense / found.noise.std[problem.group][:, None]
        information = weighted.T @ weighted + np.diag(
            np.where(held, 1.0 / np.where(held, again.prior_std, 1.0), 0.0) ** 2
        )
        widths = np.log(again.prior_std[problem.nuisance_part.start :]).sum()
        expected = again.mode - 0.5 * np.linalg.slogdet(information)[1] - widths
        assert again.evidence == pytest.approx(expected, abs=1e-3)
        assert found.evidence == pytest.approx(expected, abs=0.5)


def test_wrong_standard_deviations_of_two_priors_are_averaged_over():
    """Against the density of the rows by scipy, with priors of each pair of widths; both explain the same rows."""
    rng = np.random.default_rng(3)
    columns, rows = rng.standard_normal((7, 4)), rng.standard_normal(7) * 3.0
    columns[:, 2] = columns[:, 0] + 0.1 * columns[:, 1]
    covariance = np.linalg.inv(np.eye(4) + columns.T @ columns)
    factors = 2.0 ** np.linspace(-1.0, 1.0, 5)
    likely = stats.norm.pdf(np.linspace(-2.0, 2.0, 5))
    first, others = columns[:, :2], columns[:, 2:]
    density = [
        [
            stats.multivariate_normal.pdf(rows, cov=np.eye(7) + one**2 * first @ first.T + other**2 * others @ others.T)
            for other in factors
        ]
        for one in factors
    ]
    expected = np.log(likely @ density @ likely / likely.sum() ** 2 / density[2][2])
    found = over_factors(covariance @ columns.T @ rows, covariance, np.array([True, True, False, False]))
    assert found == pytest.approx(expected, abs=1e-9)


def test_an_offset_that_is_there_is_found_with_its_size(fits):
    plain, found = fits
    assert found.evidence - plain.evidence > 20.0
    assert found.theta[0][0] == pytest.approx(40.0, abs=4.0 * np.sqrt(found.covariance[-1, -1]))


def test_columns_are_the_derivatives_of_the_modelled_rows(problem, fits):
    """Also under a load that has shifted, whose first moment then goes with its mass."""
    found = fits[0]
    times = np.sort(problem.rows.time_s[problem.rows.load != "none"])
    term = PayloadShift(float(times[3]))
    setting = with_terms(problem, [term], [np.array([0.02, -0.01, 0.03])], found.nuisance)
    columns = common_columns(problem, setting, found.links, found.loads, found.band).dense
    sums = problem.group % (2 * problem.axes) < problem.axes
    for place, step in ((3, 1e-3), (problem.load_part(0).start, 1e-3), (problem.load_part(0).start + 2, 1e-3)):
        moved = np.concatenate([found.links, found.loads.ravel()])
        sides = []
        for sign in (1.0, -1.0):
            at = moved + sign * step * (np.arange(len(moved)) == place)
            sides.append(modelled(problem, setting, at[:24], at[24:].reshape(-1, 4), found.band))
        change = (sides[0] - sides[1]) / (2 * step)
        assert columns[sums, place] == pytest.approx(change[sums], abs=1e-4)
        # growth of friction with the torque carries no information on the load
        assert not columns[~sums, place].any()
    for axis in range(6):
        raised = found.band + 1e-4 * (np.arange(6) == axis)
        change = modelled(problem, setting, found.links, found.loads, raised)
        change = change - modelled(problem, setting, found.links, found.loads, found.band)
        assert columns[:, problem.band_part.start + axis] == pytest.approx(1e4 * change, abs=1e-6)


def settled(problem):
    """A fit that no further step moves."""
    result = fit(problem, (), first_noise(problem))
    for _ in range(12):
        last, result = result, fit(problem, (), result.noise, result, steps=1)
    assert np.isclose(result.mode, last.mode, atol=1e-6)
    return result


def no_side(bench: Bench) -> Table:
    return undirected(bench.both())


def one_sweep(bench: Bench) -> Table:
    table = single_joint_sweep(bench, 2)
    return replace(table, direction=np.where(np.arange(6) == 2, table.direction, 0).astype(np.int8))


@pytest.mark.parametrize("made", [no_side, one_sweep], ids=["no side", "one axis"])
def test_a_band_that_no_approach_determines_stays_out_of_the_fit(made):
    """The middle of both sides bends at the band: free to follow that alone, it would never settle."""
    bench = Bench(3, [])
    problem = problem_of(bench, made(bench))
    assert problem.sided.sum() == (0 if made is no_side else 1)
    result = settled(problem)
    assert result.band[~problem.sided] == pytest.approx(0.0, abs=1e-9)
    assert (result.band[problem.sided] > 0.5 * bench.arm.plant.coulomb_nm[problem.sided]).all()


@pytest.mark.parametrize("made", [Bench.both, no_side, one_sweep], ids=["both sides", "no side", "one axis"])
def test_held_out_rows_are_predicted_by_a_fit_without_them_whatever_columns_are_empty(made):
    """Bands without a side and links on a vertical axis have empty columns, sweeps have dependent ones."""
    bench = Bench(3, [])
    problem = problem_of(bench, made(bench))
    result = settled(problem)
    assert (np.abs(result.columns.dense).max(axis=0) < 1e-12).any()
    std = result.noise.std[problem.group]
    weighted, right = result.columns.dense / std[:, None], result.residual / std
    held = np.isfinite(result.prior_std)
    prior = np.diag(1.0 / np.where(held, result.prior_std, 1.0))[held]
    pull = ((problem.common_mean - result.common) / problem.common_std)[held]
    expected = np.empty_like(right)
    pose = problem.rows.pose[problem.visit]
    for number in np.unique(pose):
        keep = pose != number
        rows = np.vstack([weighted[keep], prior])
        scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-9)
        moved = np.linalg.lstsq(rows / scale, np.concatenate([right[keep], pull]), rcond=1e-9)[0] / scale
        expected[~keep] = (right - weighted @ moved)[~keep]
    np.testing.assert_allclose(left_out(problem, result), std * expected, atol=1e-5 * std.max(), rtol=1e-4)
    # and so no held-out figure is more than a few noise floors on an arm that lacks nothing
    assert np.abs(expected).max() < 6.0
