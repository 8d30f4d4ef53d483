"""The transform function against scipy's slerp, and its refusals."""

from __future__ import annotations

import timeit

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from gateway.errors import InputError
from gateway.pair.transform_function import TransformFunction, closed, constant_function, function_of_knots, sampled


def rz(degree: float) -> np.ndarray:
    return Rotation.from_euler("z", degree, degrees=True).as_matrix()


def rx(degree: float) -> np.ndarray:
    return Rotation.from_euler("x", degree, degrees=True).as_matrix()


def smooth(count: int) -> TransformFunction:
    rng = np.random.default_rng(9)
    s_m = np.cumsum(rng.uniform(0.05, 0.2, count))
    turn = Rotation.from_rotvec(rng.normal(scale=0.2, size=(count, 3))).as_matrix()
    return TransformFunction(s_m, rng.normal(size=(count, 3)), turn)


def test_midway_between_two_knots() -> None:
    function = TransformFunction([0.0, 1.0], np.zeros((2, 3)), [rz(30), rz(30) @ rx(20)])
    assert np.allclose(function.at(0.5)[:3, :3], rz(30) @ rx(10), atol=1e-15)


def test_literal_pair_of_equations_misses_the_second_knot() -> None:
    first, second = rz(30), rz(30) @ rx(21.4)
    literal = first @ (first @ second.T)
    assert np.linalg.norm(Rotation.from_matrix(literal.T @ second).as_rotvec()) > np.deg2rad(20)
    function = TransformFunction([0.0, 1.0], np.zeros((2, 3)), [first, second])
    assert np.allclose(function.at(1.0 - 1e-15)[:3, :3], second, atol=1e-13)


def test_knots_exactly_and_continuity_from_both_sides() -> None:
    function = smooth(12)
    for length, knot in zip(function.s_m, function.knots, strict=True):
        assert np.array_equal(function.at(length), knot)
        for side in (-1e-13, 1e-13):
            assert np.allclose(function.at(length + side), knot, atol=2e-12)


def test_agrees_with_slerp_and_linear_interpolation() -> None:
    function = smooth(12)
    lengths = np.linspace(function.s_m[0], function.s_m[-1], 301)
    slerp = Slerp(function.s_m, Rotation.from_matrix(function.rotation))(lengths).as_matrix()
    line = np.stack([np.interp(lengths, function.s_m, function.position_m[:, i]) for i in range(3)], axis=1)
    many = function.many(lengths)
    assert np.allclose(many[:, :3, :3], slerp, atol=1e-14)
    assert np.allclose(many[:, :3, 3], line, atol=1e-14)
    assert np.array_equal(many, np.array([function.at(length) for length in lengths.tolist()]))


def test_outside_the_knots_the_value_stays() -> None:
    function = smooth(4)
    assert np.array_equal(function.at(-1.0), function.knots[0])
    assert np.array_equal(function.at(99.0), function.knots[-1])
    assert np.array_equal(function.many([-1.0, 99.0]), function.knots[[0, -1]])
    fixed = constant_function(function.knots[1])
    assert np.array_equal(fixed.at(0.3), function.knots[1])


def test_closed_path_comes_back() -> None:
    function = closed(smooth(4), 2.0)
    assert np.array_equal(function.at(3.0), function.knots[0])
    assert len(function) == 5


@pytest.mark.parametrize(
    ("s_m", "message"), [([0.0, 0.0], "out of order"), ([1.0, 0.0], "out of order"), ([0.0, np.nan], "finite")]
)
def test_knots_out_of_order_are_refused(s_m: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        TransformFunction(s_m, np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)))


def test_half_turn_between_knots_and_broken_matrices_are_refused() -> None:
    with pytest.raises(InputError, match="half a turn"):
        TransformFunction([0.0, 1.0], np.zeros((2, 3)), [np.eye(3), rz(179.99)])
    with pytest.raises(InputError, match="no rotation"):
        TransformFunction([0.0, 1.0], np.zeros((2, 3)), [np.eye(3), 1.001 * np.eye(3)])
    with pytest.raises(InputError, match="shape|needs N"):
        TransformFunction([0.0, 1.0], np.zeros((3, 3)), [np.eye(3)] * 2)


def test_stored_arrays_cannot_be_changed() -> None:
    function = smooth(3)
    with pytest.raises(ValueError, match="read-only"):
        function.position_m[0] = 1.0


def test_other_knots_agree_where_they_lie() -> None:
    function = smooth(5)
    lengths = np.linspace(function.s_m[0], function.s_m[-1], 7)
    again = sampled(function, lengths)
    assert np.array_equal(again.many(lengths), function.many(lengths))
    assert len(sampled(constant_function(function.knots[0]), lengths)) == 7


def test_function_of_knots_is_the_same_function() -> None:
    function = smooth(5)
    again = function_of_knots(function.s_m, function.knots)
    assert np.array_equal(again.at(0.3), function.at(0.3))


def test_evaluation_takes_microseconds() -> None:
    function = smooth(20)
    best = min(timeit.repeat(lambda: function.at(0.9), number=200, repeat=20)) / 200
    assert best < 50e-6
