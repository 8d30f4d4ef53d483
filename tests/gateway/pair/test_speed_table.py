"""Functions between stored speeds: the patent's increments, continuity, extrapolation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.errors import InputError
from gateway.pair.transform_function import ExtrapolationWarning, SpeedTable, TransformFunction


def two_knots(angle: float, step: float) -> TransformFunction:
    turn = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, 0.0, angle]]).as_matrix()
    return TransformFunction([0.0, 1.0], [[0.0, 0.0, 0.0], [step, 0.0, 0.0]], turn)


def angle_of(function: TransformFunction) -> float:
    return float(
        np.linalg.norm(Rotation.from_matrix(function.knots[0, :3, :3].T @ function.knots[1, :3, :3]).as_rotvec())
    )


def test_printed_example() -> None:
    table = SpeedTable({0.5: two_knots(0.010, 1e-3), 1.0: two_knots(0.016, 3e-3)})
    between = table.at(0.8)
    assert angle_of(between) == pytest.approx(0.0136, abs=1e-12)
    assert between.knots[1, 0, 3] == pytest.approx(1e-3 + 0.6 * 2e-3)


def test_stored_speeds_come_back_and_three_are_piecewise_straight() -> None:
    table = SpeedTable({1.5: two_knots(0.03, 3e-3), 0.0: two_knots(0.0, 0.0), 0.75: two_knots(0.02, 1e-3)})
    for speed, angle in ((0.0, 0.0), (0.375, 0.01), (0.75, 0.02), (1.125, 0.025), (1.5, 0.03)):
        assert angle_of(table.at(speed)) == pytest.approx(angle, abs=1e-12)


def test_extrapolation_warns_and_is_clipped() -> None:
    table = SpeedTable({1.0: two_knots(0.01, 1e-3), 2.0: two_knots(0.02, 2e-3)})
    with pytest.warns(ExtrapolationWarning, match="extrapolated"):
        assert angle_of(table.at(2.2)) == pytest.approx(0.022)
    with pytest.warns(ExtrapolationWarning, match="clipped"):
        assert angle_of(table.at(5.0)) == pytest.approx(0.023)
    with pytest.warns(ExtrapolationWarning, match="clipped"):
        assert angle_of(table.at(0.1)) == pytest.approx(0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table.at(1.5)


def test_knots_of_both_functions_count_and_the_result_is_continuous() -> None:
    rng = np.random.default_rng(8)
    lengths = [np.array([0.0, 0.3, 1.0]), np.array([0.0, 0.5, 0.7, 1.0])]
    functions = [
        TransformFunction(
            length,
            rng.normal(size=(len(length), 3)),
            Rotation.from_rotvec(0.01 * rng.normal(size=(len(length), 3))).as_matrix(),
        )
        for length in lengths
    ]
    between = SpeedTable({1.0: functions[0], 2.0: functions[1]}).at(1.4)
    assert between.s_m.tolist() == [0.0, 0.3, 0.5, 0.7, 1.0]
    for knot in between.s_m:
        assert np.allclose(between.at(knot - 1e-14), between.at(knot), atol=1e-12)
    middle = 0.6 * functions[0].at(0.5)[:3, 3] + 0.4 * functions[1].at(0.5)[:3, 3]
    assert np.allclose(between.at(0.5)[:3, 3], middle)


def test_useless_tables_and_speeds_are_refused() -> None:
    with pytest.raises(InputError, match="at least two"):
        SpeedTable({1.0: two_knots(0.0, 0.0)})
    with pytest.raises(InputError, match="not negative"):
        SpeedTable({-1.0: two_knots(0.0, 0.0), 1.0: two_knots(0.0, 0.0)})
    with pytest.raises(InputError, match="finite"):
        SpeedTable({0.0: two_knots(0.0, 0.0), 1.0: two_knots(0.0, 0.0)}).at(float("nan"))
