"""The weighted linear problem against statsmodels and written-out normal equations."""

import numpy as np
import pytest
import statsmodels.api as sm

from gateway.identify.solve import Prior, determined, solve


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    design = rng.normal(size=(40, 5)) * [1.0, 100.0, 0.01, 1.0, 5.0]
    std = rng.uniform(0.5, 3.0, 40)
    target = design @ [1.0, 0.02, 50.0, -2.0, 0.3] + std * rng.normal(size=40)
    return design, target, std


def test_free_solution_is_generalised_least_squares(problem):
    design, target, std = problem
    found = solve(design, target, 1 / std)
    oracle = sm.GLS(target, design, sigma=std**2).fit()
    np.testing.assert_allclose(found.value, oracle.params, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, oracle.normalized_cov_params, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.residual, target - design @ oracle.params, rtol=1e-8, atol=1e-10)
    white = design / std[:, None]
    hat = white @ np.linalg.inv(white.T @ white) @ white.T
    np.testing.assert_allclose(found.basis.leverage, np.diag(hat), rtol=1e-9)
    np.testing.assert_allclose(found.basis.dense @ found.basis.dense.T, hat, atol=1e-10)
    assert (found.rank, found.null.shape) == (5, (5, 0))
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(white.T @ white)[1])
    assert found.misfit == pytest.approx(np.sum((found.residual / std) ** 2))


def test_priors_are_rows_of_unit_standard_deviation(problem):
    design, target, std = problem
    mean, spread = np.array([0.0, 0.01, 40.0, 0.0, 0.0]), np.array([0.1, np.inf, 1.0, np.inf, np.inf])
    further, right = np.array([[1.0, 0.0, 0.0, 2.0, 0.0]]), np.array([-3.0])
    found = solve(design, target, 1 / std, Prior(mean, spread, further, right))
    held = np.isfinite(spread)
    big = np.vstack([design / std[:, None], np.diag(np.where(held, 1 / spread, 0))[held], further])
    side = np.concatenate([target / std, (mean / spread)[held], right])
    np.testing.assert_allclose(found.value, np.linalg.lstsq(big, side, rcond=None)[0], rtol=1e-9)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(big.T @ big), rtol=1e-8, atol=1e-12)


def test_what_rows_cannot_determine_is_named(problem):
    design, target, std = problem
    design = np.column_stack([design, design[:, 0] + 3 * design[:, 3], np.zeros(40)])
    found = solve(design, target, 1 / std)
    assert found.rank == 5
    found_directions = determined(found, np.eye(7))
    assert found_directions.tolist() == [False, True, True, False, True, False, False]
    combination = np.zeros((1, 7))
    combination[0, [0, 5]] = 1.0, 1.0  # what lumps with the sixth column
    assert determined(found, combination).all()
    np.testing.assert_allclose(design @ found.value, target - found.residual)


def test_a_prior_makes_them_known(problem):
    design, target, std = problem
    design = np.column_stack([design, design[:, 0]])
    prior = Prior.free(6).with_std(np.array([5]), np.array([0.5]))
    assert determined(solve(design, target, 1 / std, prior), np.eye(6)).all()


def test_units_do_not_change_the_rank(problem):
    design, target, std = problem
    found = solve(design * 1e-9, target, 1 / std)
    assert found.rank == 5
    np.testing.assert_allclose(found.value * 1e-9, solve(design, target, 1 / std).value, rtol=1e-8)


def test_a_prior_as_normal_equations_is_the_prior_as_rows():
    generator = np.random.default_rng(2)
    columns, tau = generator.normal(size=(300, 4)), generator.normal(size=300)
    rows, right = generator.normal(size=(2, 4)), generator.normal(size=2)
    prior = Prior(generator.normal(size=4), np.array([np.inf, 1.0, 0.5, 0.1]), rows, right)
    value = np.linalg.solve(columns.T @ columns + prior.precision, columns.T @ tau + prior.pull)
    found = solve(columns, tau, np.ones(300), prior)
    assert value == pytest.approx(found.value, abs=1e-8)
    assert found.misfit == pytest.approx(((tau - columns @ value) ** 2).sum() + prior.penalty(value))


def test_condition_is_that_of_columns_of_unit_length():
    """Two unit columns at an angle with cosine c have singular values sqrt(1 + c) and sqrt(1 - c)."""
    design = np.array([[1.0, 0.6], [0.0, 0.8], [0.0, 0.0]]) * [3.0, 0.01]
    assert solve(design, np.ones(3), np.ones(3)).condition == pytest.approx(np.sqrt(1.6 / 0.4))


@pytest.mark.parametrize("size", [0.0, 1e-18, 1e-15], ids=["zero", "of rounding", "of more rounding"])
def test_columns_that_say_nothing_take_up_no_row(problem, size):
    """Columns without content, and those that others make up, leave every leverage as it is without them."""
    design, target, std = problem
    plain = solve(design, target, 1 / std)
    noise = size * np.random.default_rng(1).normal(size=(40, 3))
    more = np.column_stack([noise[:, 0], design, noise[:, 1:], design[:, 1] - 2.0 * design[:, 4], design[:, 2]])
    found = solve(more, target, 1 / std)
    np.testing.assert_allclose(found.basis.leverage, plain.basis.leverage, rtol=1e-7)
    basis, expected = found.basis.dense, plain.basis.dense
    np.testing.assert_allclose(basis @ basis.T, expected @ expected.T, atol=1e-9)
    np.testing.assert_allclose(found.residual, plain.residual, atol=1e-9)
    assert found.rank == plain.rank == 5
    assert found.basis.leverage.sum() == pytest.approx(5.0)


def test_more_columns_than_rows_take_up_no_more_than_the_rows_say():
    """Five rows of one constant, and seven columns of nothing: the constant's leverage is one fifth of each row."""
    design = np.zeros((5, 8))
    design[:, 3] = 2.0
    found = solve(design, np.arange(5.0), np.ones(5))
    assert found.basis.leverage == pytest.approx(np.full(5, 0.2))
    assert found.value[3] == pytest.approx(1.0)
    assert np.delete(found.value, 3) == pytest.approx(np.zeros(7))
    assert not solve(np.zeros((5, 2)), np.arange(5.0), np.ones(5)).basis.leverage.any()


def test_standard_deviations_that_combinations_tie_together_are_those_of_the_covariance():
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T
    prior = Prior(np.zeros(3), np.array([2.0, 1e6, 1e6]), np.column_stack([np.zeros(2), root]), np.zeros(2))
    np.testing.assert_allclose(prior.stds(np.array([1, 2])), [0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(np.linalg.inv(prior.precision)[1:, 1:], covariance, rtol=1e-6)
    assert prior.precision[0, 0] == 0.25
