"""Inertia of a load: pinocchio's parallel axes come back, and what is reported is always a body."""

import numpy as np
import pinocchio
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.identify.inertia import (
    central_directions,
    is_body,
    load_inertia,
    nearest_body,
)
from gateway.result.inertia import tensor_of
from gateway.result.names import INERTIA_PARTS, INERTIA_WHOLE

ROW, COLUMN = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
MOMENTS = [4, 7, 9, 5, 6, 8]


def ten_of(mass, com, tensor):
    """Ten parameters about the origin, by pinocchio, in the order of the regressor."""
    values = pinocchio.Inertia(mass, np.asarray(com), tensor).toDynamicParameters()
    return values[[0, 1, 2, 3, 4, 5, 7, 6, 8, 9]]


def some_body(seed):
    """A body of point masses."""
    rng = np.random.default_rng(seed)
    points, masses = rng.normal(0.0, 0.1, (6, 3)) + rng.normal(0, 0.15, 3), rng.uniform(0.1, 2.0, 6)
    total = masses.sum()
    com = masses @ points / total
    away = points - com
    second = (masses[:, None] * away).T @ away
    return total, com, np.trace(second) * np.eye(3) - second


def test_inertia_about_the_centre_of_gravity_in_the_order_of_a_result():
    mass, com, tensor = some_body(1)
    ten = ten_of(mass, com, tensor)
    found = load_inertia(ten, np.eye(10) * 1e-10, free=False)
    np.testing.assert_allclose(found.value_kg_m2, tensor[ROW, COLUMN], atol=1e-12)
    assert found.unidentifiable == ()
    assert not found.free


def test_the_derivatives_are_those_of_the_function():
    ten = ten_of(*some_body(2))

    def central(values):
        mass, com = values[0], values[1:4] / values[0]
        origin = tensor_of(values[MOMENTS])
        return (origin - mass * (com @ com * np.eye(3) - np.outer(com, com)))[ROW, COLUMN]

    step = 1e-6
    numeric = np.array([(central(ten + step * unit) - central(ten - step * unit)) / (2 * step) for unit in np.eye(10)])
    np.testing.assert_allclose(central_directions(ten), numeric.T, atol=1e-7)


def test_barely_known_moments_stay_open_by_name():
    ten = ten_of(*some_body(3))
    spread = np.full(10, 1e-8)
    spread[6] = 1.0  # Ixz
    found = load_inertia(ten, np.diag(spread), free=True)
    assert found.unidentifiable == ("inertia_xz_kg_m2",)
    np.testing.assert_array_equal(np.isnan(found.std_kg_m2), np.isnan(found.value_kg_m2))
    assert INERTIA_PARTS[int(np.flatnonzero(np.isnan(found.value_kg_m2))[0])] == "inertia_xz_kg_m2"
    assert load_inertia(ten, np.eye(10), free=True).unidentifiable == (INERTIA_WHOLE,)


@example(seed=45, size=2.75)  # many steps until the nearest body is found
@given(seed=st.integers(0, 10_000), size=st.floats(1e-3, 3.0))
def test_what_is_given_is_a_body_and_no_further_from_the_truth(seed, size):
    rng = np.random.default_rng(seed)
    true = ten_of(*some_body(seed))
    mixed = rng.normal(size=(10, 10))
    scale = size * np.array([0.1, *[0.02] * 3, *[0.02] * 6])
    covariance = scale[:, None] * (mixed @ mixed.T / 10.0 + 0.1 * np.eye(10)) * scale
    free = rng.multivariate_normal(true, covariance)
    free[0] = abs(free[0]) + 0.05
    body = nearest_body(free, covariance)
    assert is_body(body)
    metric = np.linalg.inv(covariance)

    def far(one, other):
        return float((one - other) @ metric @ (one - other))

    if is_body(free):
        np.testing.assert_array_equal(body, free)
    else:
        assert far(body, true) <= far(free, true) * 1.0001 + 1e-6
        assert far(body, free) <= far(true, free) * 1.0001 + 1e-6
    principal = np.linalg.eigvalsh(
        tensor_of(body[MOMENTS]) - body[0] * (np.dot(c := body[1:4] / body[0], c) * np.eye(3) - np.outer(c, c))
    )
    assert principal[0] > 0
    assert principal[0] + principal[1] >= principal[2]


def test_a_point_is_given_as_a_body():
    ten = ten_of(5.0, np.array([0.1, -0.02, 0.08]), np.zeros((3, 3)))
    body = nearest_body(ten, np.eye(10) * 1e-6)
    assert is_body(body)
    np.testing.assert_allclose(body, ten, atol=2e-5)


@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan])
def test_what_has_no_mass_is_no_body(mass):
    assert not is_body(np.array([mass, *np.ones(9)]))
