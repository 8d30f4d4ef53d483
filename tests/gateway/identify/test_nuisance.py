"""Nuisance parameters: priors, losses read from half differences, options that mean something."""

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.identify.nuisance import (
    bias_std_nm,
    efficiency_of,
    gain_prior,
    gain_stds,
    losses,
    parse_torque_gain,
)


def test_a_table_that_states_nothing_is_trusted_to_three_percent():
    assert gain_stds(None, 4).tolist() == [0.03] * 4


def test_exact_constants_are_held_and_not_divided_by():
    stds = gain_stds([0.0, 0.02], 2)
    assert 0 < stds[0] < 1e-6
    assert stds[1] == 0.02


@pytest.mark.parametrize("stated", [[0.5], [0.3], [-0.01], [float("nan")], [0.01, 0.01]])
def test_constants_that_say_nothing_are_refused(stated):
    with pytest.raises(ConfigError):
        gain_stds(stated, 1)


def test_options_in_words():
    assert parse_torque_gain("exact") == 0.0
    assert parse_torque_gain("prior:0.05") == parse_torque_gain("0.05") == 0.05
    assert parse_torque_gain("0") == 0.0


@pytest.mark.parametrize("text", ["prior:0", "prior:0.5", "prior:x", "prior:", "0.5", "ignore", "prior:nan"])
def test_options_that_mean_nothing_say_what_to_use(text):
    with pytest.raises(ConfigError, match="such as 0.03, or exact"):
        parse_torque_gain(text)


def test_losses_are_the_slope_over_the_torque():
    rng = np.random.default_rng(0)
    torque = rng.uniform(-200, 200, (30, 2))
    difference = [10.0, 4.0] + np.array([0.12, 0.0]) * np.abs(torque) + 0.1 * rng.standard_normal((30, 2))
    value, std = losses(difference, torque)
    np.testing.assert_allclose(value, [0.12, 0.0], atol=4e-3)
    assert (np.abs(value - [0.12, 0.0]) < 4 * std).all()


def test_losses_are_unknown_where_the_torque_does_not_change():
    difference = np.full((10, 3), 5.0) + 0.5 * np.random.default_rng(0).standard_normal((10, 3))
    torque = np.column_stack([np.full(10, 40.0), np.zeros(10), np.full(10, np.nan)])
    value, std = losses(difference, torque)
    assert np.isnan(value).all()
    assert np.isnan(std).all()


@pytest.mark.parametrize("eta", [0.6, 0.75, 0.95, 1.0])
def test_an_efficiency_comes_back_from_its_losses(eta):
    assert efficiency_of((1 / eta - eta) / 2) == pytest.approx(eta)


@pytest.mark.parametrize("eta", [0.75, 0.85, 0.95])
def test_the_prior_of_a_gain_holds_what_an_unstated_efficiency_leaves_in_the_middle(eta):
    """Half the sum of `tau / eta` and `tau eta`, where friction is small."""
    mean, std = gain_prior(np.full(1, 1e-9), np.array([(1 / eta - eta) / 2]))
    assert abs((1 / eta + eta) / 2 - 1 - mean[0]) < 2 * std[0]


def test_undetectable_losses_move_nothing_and_widen():
    mean, std = gain_prior(np.array([0.02]), np.array([np.nan]))
    assert mean.tolist() == [0.0]
    assert std[0] > 0.02


def test_the_bias_is_a_tenth_of_the_band():
    assert bias_std_nm(np.array([30.0]), np.zeros(1)).tolist() == pytest.approx([3.0])
