"""Base parameters: ranks known in closed form, same torque, and names that say what lumps."""

import numpy as np
import pytest

from gateway.model.base import base_parameters, moving_base, rest_base
from gateway.model.regressor import gravity_regressor, regressor
from gateway.model.robot import robot_from_urdf

TILTED = (1.0, -2.0, -9.5)


def test_ranks_of_the_closed_form(six_axes):
    assert rest_base(six_axes).rank == 10
    assert rest_base(six_axes, TILTED).rank == 12
    assert rest_base(six_axes, (0.0, 0.0, 9.80665)).rank == 10  # on the ceiling
    first_five = range(20)
    assert rest_base(six_axes, columns=first_five).rank == 8
    assert rest_base(six_axes, TILTED, columns=first_five).rank == 10
    q = np.random.default_rng(0).uniform(-2, 2, (80, 6))
    rows = gravity_regressor(six_axes, q)
    names = [f"p{k}" for k in range(24)]
    assert [base_parameters(rows[:, axis], names).rank for axis in range(6)] == [0, 10, 8, 6, 4, 2]


def test_rank_with_a_constant_per_axis_is_sixteen(six_axes):
    q = np.random.default_rng(0).uniform(-2, 2, (80, 6))
    rows = np.concatenate([gravity_regressor(six_axes, q), np.broadcast_to(np.eye(6), (80, 6, 6))], axis=2)
    assert base_parameters(rows, [f"p{k}" for k in range(30)]).rank == 16


def test_one_posture_has_rank_three_for_a_load(random_urdf):
    for seed in range(5):
        robot = robot_from_urdf(random_urdf(seed), "r")
        for q in np.random.default_rng(seed).uniform(-3, 3, (20, 1, 6)):
            rows = gravity_regressor(robot, q)[:, :, 20:]
            assert base_parameters(rows, list("mxyz")).rank == 3


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.80665), TILTED])
def test_base_columns_give_the_same_torque(random_urdf, gravity):
    robot = robot_from_urdf(random_urdf(1), "r")
    rng = np.random.default_rng(2)
    q, qd, qdd = rng.normal(size=(3, 50, 6))
    phi = rng.normal(size=24)
    base = rest_base(robot, gravity)
    rows = gravity_regressor(robot, q, gravity)
    np.testing.assert_allclose(rows[:, :, base.indices] @ (base.combination @ phi), rows @ phi, atol=1e-9)
    np.testing.assert_allclose(base.combination[:, base.indices], np.eye(base.rank), atol=1e-12)
    moving = moving_base(robot, gravity)
    full, phi = regressor(robot, q, qd, qdd, gravity), rng.normal(size=60)
    np.testing.assert_allclose(full[:, :, moving.indices] @ (moving.combination @ phi), full @ phi, atol=1e-8)


def test_moving_base_of_a_spherical_wrist_has_thirty_six(six_axes):
    assert moving_base(six_axes).rank == 36


def test_names_say_what_lumps():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 30))
    base = base_parameters(np.column_stack([a, b, 0.5 * a, np.zeros(30)]), ["alpha", "beta", "gamma", "delta"])
    assert base.rank == 2
    assert base.names == ("alpha + 0.5 gamma", "beta")


def test_tolerance_is_relative_to_scaled_columns():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(40, 3)) * [1e-5, 1.0, 1e6]
    assert base_parameters(columns, list("abc")).rank == 3
    assert base_parameters(np.zeros((4, 2)), list("ab")).rank == 0


@pytest.mark.parametrize("seed", range(4))
def test_base_parameters_give_the_same_torque_whatever_the_units_of_the_columns(seed):
    """Dependent columns in units from a thousandth to a thousand; any parameters, torque of the kept ones alone."""
    rng = np.random.default_rng(seed)
    free = rng.normal(size=(40, 3))
    unit = 10.0 ** rng.integers(-3, 4, 6)
    rows = np.column_stack([free, free @ rng.normal(size=(3, 3))]) * unit
    base = base_parameters(rows[:, None, :], [f"p{number}" for number in range(6)])
    assert base.rank == 3
    parameters = rng.normal(size=6) / unit
    assert rows[:, base.indices] @ (base.combination @ parameters) == pytest.approx(
        rows @ parameters, rel=1e-8, abs=1e-8
    )


def test_the_choice_among_equal_columns_does_not_depend_on_rounding():
    rng = np.random.default_rng(2)
    rows = rng.standard_normal((80, 5))
    rows = np.column_stack([rows, rows[:, 0] + rows[:, 1], rows[:, 3]])
    chosen = base_parameters(rows, list("abcdefg")).indices.tolist()
    for seed in range(20):
        noise = 1.0 + 1e-15 * np.random.default_rng(seed).standard_normal(rows.shape)
        assert base_parameters(rows * noise, list("abcdefg")).indices.tolist() == chosen
