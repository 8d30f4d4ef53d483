"""Known loads and a stored bare identification as rows."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.errors import InputError
from gateway.identify.prior_loads import bare_rows, load_vector, unknown_labels
from gateway.result.result import Bare


def test_labels_in_the_order_they_appear_without_bare_and_known():
    assert unknown_labels(["none", "b", "a", "b", "tool"], {"tool": (1, 0, 0, 0)}) == ("b", "a")
    with pytest.raises(InputError, match="--known x: no row carries this load; the data hold none, b"):
        unknown_labels(["none", "b"], {"x": (1, 0, 0, 0)})


def test_load_vector_is_mass_and_first_moment():
    assert load_vector((4.0, 0.5, -0.25, 1.0)).tolist() == [4.0, 2.0, -1.0, 4.0]


def bare(covariance: np.ndarray, combination: np.ndarray, value: np.ndarray) -> Bare:
    return Bare(
        robot="r",
        gravity_m_s2=(0.0, 0.0, -9.81),
        columns=(),
        names=(),
        value=tuple(value.tolist()),
        covariance=tuple(map(tuple, covariance.tolist())),
        combination=tuple(map(tuple, combination.tolist())),
    )


def test_bare_rows_weigh_as_the_covariance_says():
    random = np.random.default_rng(0)
    mix = random.normal(size=(3, 3))
    covariance, combination, value = mix @ mix.T, random.normal(size=(3, 24)), random.normal(size=3)
    rows, right = bare_rows(bare(covariance, combination, value))
    assert not rows[:, 24:].any()  # neither gains nor biases are stored
    rows = rows[:, :24]
    assert rows.T @ rows == pytest.approx(combination.T @ np.linalg.inv(covariance) @ combination)
    assert rows.T @ right == pytest.approx(combination.T @ np.linalg.inv(covariance) @ value)


def test_bare_rows_of_a_direction_that_is_known_exactly_stay_finite():
    rows, right = bare_rows(bare(np.diag([1.0, 0.0]), np.eye(2, 24), np.array([2.0, 3.0])))
    assert np.isfinite(rows).all()
    assert np.linalg.lstsq(rows, right, rcond=None)[0][:2] == pytest.approx([2.0, 3.0])
