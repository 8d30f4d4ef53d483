"""Shares of a variance by source, against the variance of the linear map computed one source at a time."""

import numpy as np
import pytest

from gateway.identify.load_estimate import Sources, budget_by_priors, budget_of
from gateway.identify.solve import ByGroup, Prior, solve


def problem():
    rng = np.random.default_rng(0)
    design, weight = rng.standard_normal((20, 4)), rng.uniform(0.5, 3.0, 20)
    std = np.array([np.inf, 0.3, 0.2, 1.0])
    rows = rng.standard_normal((2, 4))
    return design, weight, Prior(np.zeros(4), std, rows, np.zeros(2))


SOURCES = Sources(
    np.array(["noise"] * 15 + ["friction"] * 5),
    {"constants": np.array([0.0, 1.0, 0.25, 0.0]), "friction": np.array([0.0, 0.0, 0.75, 0.0]),
     "links": np.array([0.0, 0.0, 0.0, 1.0])},
)  # fmt: skip


@pytest.mark.slow
def test_shares_are_those_of_the_variance_when_one_source_alone_varies():
    design, weight, prior = problem()
    covariance = solve(design, np.zeros(20), weight, prior).covariance
    direction = np.array([1.0, 0.0, 0.0, 0.5])
    found = budget_of(ByGroup.of(design * weight[:, None]), prior, covariance, direction, SOURCES)
    rng = np.random.default_rng(1)
    draws = {source: [] for source in found}
    for source, values in draws.items():
        for _ in range(3000):
            noise = np.where(SOURCES.row == source, rng.standard_normal(20) / weight, 0.0)
            share = np.sqrt(SOURCES.parameter.get(source, np.zeros(4)))
            mean = np.where(np.isfinite(prior.std), np.nan_to_num(prior.std, posinf=0.0), 0.0) * share
            right = rng.standard_normal(2) * (source == "links")
            drawn = Prior(mean * rng.standard_normal(4), prior.std, prior.rows, right)
            values.append(direction @ solve(design, noise, weight, drawn).value)
    variance = {source: np.var(values) for source, values in draws.items()}
    total = direction @ covariance @ direction
    assert sum(variance.values()) == pytest.approx(total, rel=0.06)
    for source, share in found.items():
        assert share == pytest.approx(variance[source] / total, abs=0.03)
    assert sum(found.values()) == pytest.approx(1.0)


def test_the_order_does_not_matter():
    design, weight, prior = problem()
    covariance = solve(design, np.zeros(20), weight, prior).covariance
    weighted, order = design * weight[:, None], np.random.default_rng(2).permutation(20)
    direction = np.array([1.0, 0.0, 0.0, 0.0])
    one = budget_of(ByGroup.of(weighted), prior, covariance, direction, SOURCES)
    other = Sources(SOURCES.row[order], SOURCES.parameter)
    two = budget_of(ByGroup.of(weighted[order]), prior, covariance, direction, other)
    assert one == pytest.approx(two)


def test_nothing_has_no_budget():
    design, weight, prior = problem()
    assert budget_of(ByGroup.of(design * weight[:, None]), prior, np.zeros((4, 4)), np.ones(4), SOURCES) == {}


def test_shares_of_a_variance_are_those_of_the_linear_model():
    """Rows with unit noise and two priors: each source alone moves the estimate by its own part."""
    rng = np.random.default_rng(3)
    design, precision = rng.normal(size=(30, 3)), np.array([0.0, 4.0, 25.0])
    covariance = np.linalg.inv(design.T @ design + np.diag(precision))
    found = budget_by_priors(
        covariance[0], precision, {"one": np.array([1]), "two": np.array([2])}, float(covariance[0, 0])
    )
    noise = covariance[0] @ design.T @ design @ covariance[0]
    assert found["noise"] == pytest.approx(noise / covariance[0, 0])
    assert found["one"] == pytest.approx(covariance[0, 1] ** 2 * 4.0 / covariance[0, 0])
    assert sum(found.values()) == pytest.approx(1.0)
    assert budget_by_priors(covariance[0], precision, {}, float("nan")) == {}


def test_priors_that_tie_parameters_together_are_in_the_budget():
    rng = np.random.default_rng(5)
    design, root = rng.normal(size=(30, 3)), rng.normal(size=(2, 2))
    precision = np.zeros((3, 3))
    precision[1:, 1:] = root @ root.T
    covariance = np.linalg.inv(design.T @ design + precision)
    found = budget_by_priors(covariance[0], precision, {"tied": np.array([1, 2])}, float(covariance[0, 0]))
    tied = covariance[0] @ precision @ covariance[0]
    assert found["tied"] == pytest.approx(tied / covariance[0, 0])
    assert sum(found.values()) == pytest.approx(1.0)
