"""Pairing both sides of a rest visit, each through the gear by its own direction."""

import numpy as np
import pytest

from gateway.model.visits import pair_visits


def test_both_sides_become_gravity_and_band(rest_table):
    """Worked by hand: gravity 100, friction 20 behind a gear of 0.8."""
    eta = 0.8
    up, down = 120.0 / eta, 80.0 * eta  # driving, driven back
    table = rest_table(load=["none"] * 2, pose=[3, 3], direction=[1, -1], tau=[up, down], std=0.4, count=4)
    visits = pair_visits(table, np.full(6, eta))
    assert len(visits) == 1
    assert visits.two_sided.all()
    np.testing.assert_allclose(visits.tau_nm, 100.0)
    np.testing.assert_allclose(visits.band_nm, 20.0)
    np.testing.assert_allclose(visits.tau_std_nm, 0.4 / 2 / np.sqrt(2))
    assert (visits.direction == 0).all()
    assert (visits.gear_nm == 0).all()


def test_averaging_before_the_gear_would_leave_a_bias():
    eta, gravity = 0.8, 100.0
    naive = (gravity / eta + gravity * eta) / 2
    assert naive == pytest.approx(gravity * 1.025)


def test_negative_torque_is_driven_the_other_way_round(rest_table):
    eta = 0.8
    table = rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[-80.0 * eta, -120.0 / eta])
    visits = pair_visits(table, eta)
    np.testing.assert_allclose(visits.tau_nm, -100.0)
    np.testing.assert_allclose(visits.band_nm, 20.0)


def test_order_of_the_sides_does_not_matter(rest_table):
    one = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0]))
    two = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=[-1, 1], tau=[8.0, 12.0]))
    np.testing.assert_allclose(one.band_nm, two.band_nm)
    np.testing.assert_allclose(one.tau_nm, two.tau_nm)


def test_one_side_stays_one_sided(rest_table):
    table = rest_table(load=["a", "a", "b"], pose=[1, 2, 1], direction=[1, -1, -1], tau=[12.0, 8.0, 3.0])
    visits = pair_visits(table)
    assert len(visits) == 3
    assert not visits.two_sided.any()
    assert np.isnan(visits.band_nm).all()
    assert visits.direction[:, 0].tolist() == [1, -1, -1]


def test_unknown_side_keeps_what_the_gear_leaves_open(rest_table):
    visits = pair_visits(rest_table(load=["a"], pose=[1], direction=[0], tau=[100.0]), 0.8)
    np.testing.assert_allclose(visits.tau_nm, 100.0)
    np.testing.assert_allclose(visits.gear_nm, 100.0 * (1.25 - 0.8) / 2)


def test_repeated_visits_pair_in_the_order_of_time(rest_table):
    table = rest_table(
        load=["a"] * 4, pose=[1] * 4, direction=[1, -1, 1, -1], tau=[12.0, 8.0, 13.0, 9.0], time=[0.0, 5.0, 50.0, 55.0]
    )
    visits = pair_visits(table)
    np.testing.assert_allclose(visits.tau_nm[:, 0], [10.0, 11.0])
    np.testing.assert_allclose(visits.time_s, [2.5, 52.5])


def test_other_angles_or_runs_do_not_pair(rest_table):
    far = rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0], q=[[0.0] * 6, [0.1] * 6])
    assert len(pair_visits(far)) == 2
    apart = rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0], run=["r", "s"])
    assert len(pair_visits(apart)) == 2


def test_take_and_an_empty_table(rest_table):
    table = rest_table(load=["a", "b"], pose=[1, 1], direction=[1, 1], tau=[1.0, 2.0])
    visits = pair_visits(table)
    assert visits.take(visits.load == "b").tau_nm[0, 0] == 2.0
    assert len(pair_visits(table.take(np.zeros(2, dtype=bool)))) == 0
