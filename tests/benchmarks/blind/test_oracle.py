"""The oracle against closed forms, and against the noise that the cells are drawn with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind import oracle
from benchmarks.nature.effect import Mechanism, on_axis, rows_of
from benchmarks.nature.levels import levels_of
from benchmarks.nature.measuring import quiet, reported_nm
from benchmarks.nature.nature_cell import draw_cell
from benchmarks.nature.strength import halves


def test_one_parameter_with_a_prior():
    # 1 / (sum a^2 / s^2 + 1 / p^2)
    columns = np.array([[[1.0], [2.0]], [[3.0], [0.0]]])
    weight = np.tile(np.diag([1 / 0.5**2, 1 / 0.25**2]), (2, 1, 1))
    expected = 1.0 / ((1 + 9) / 0.5**2 + 4 / 0.25**2 + 1 / 2.0**2)
    assert oracle.posterior(columns, weight, np.array([1 / 4.0]))[0, 0] == pytest.approx(expected)


def test_a_nuisance_of_the_same_shape_adds_its_prior():
    # y = a (x + b): what is known of x is the noise and the prior of b together
    columns = np.ones((5, 1, 2))
    covariance = oracle.posterior(columns, np.full((5, 1, 1), 1 / 0.3**2), np.array([0.0, 1 / 0.7**2]))
    assert covariance[0, 0] == pytest.approx(0.3**2 / 5 + 0.7**2)


def test_evidence_for_an_effect_grows_with_the_square_of_its_size_and_falls_where_something_else_may_explain_it():
    cell = draw_cell(2, "base")

    def ratio(size_nm: float, **changes) -> float:
        offset = Mechanism(
            "offset", (3,), size_nm, on_reading=lambda _, tau: tau + on_axis(2, np.full(len(tau), size_nm))
        )
        other = replace(cell, effects=(offset,), arm=replace(cell.arm, **changes))
        return oracle.log_likelihood_ratios(other, cell.visits, ())[0]

    size_nm = 2.0 * float(cell.arm.floor_nm[2])
    assert ratio(2.0 * size_nm) == pytest.approx(4.0 * ratio(size_nm), rel=0.01)
    assert oracle.log_likelihood_ratios(cell, cell.visits, ()) == []
    uneven = replace(cell.arm.friction, bias_std=100.0 * cell.arm.friction.bias_std)
    assert ratio(size_nm, friction=uneven) < 0.2 * ratio(size_nm)


@pytest.mark.slow
@pytest.mark.parametrize("condition", ["base", "efficiency", "all"])
def test_the_truth_is_within_the_oracle_interval(condition):
    # the posterior mean of the same model, from measured half-sums, misses by what the oracle states
    misses = np.array([_miss(seed, condition) for seed in range(30)])
    assert 0.75 < np.sqrt(np.mean(misses**2)) < 1.3
    assert np.abs(misses.mean(axis=0)).max() < 0.6


def _miss(seed: int, condition: str) -> np.ndarray:
    """Error of the posterior mean over its standard deviation, of mass, x, y, z."""
    cell = draw_cell(seed, condition)
    arm, rows = cell.arm, rows_of(cell.visits)
    columns, outliers = cell.measure(cell.visits)
    tau = reported_nm(arm, rows, (), quiet(arm, rows))[1][0::2]
    design, precision = oracle.design_of(arm, rows, (), tau)
    weight = oracle.weights_of(arm, rows, (), tau)
    for wrong in outliers:
        weight[wrong.visit] = oracle.without_axis(weight[wrong.visit], wrong.joint - 1)
    covariance = oracle.posterior(design, weight, precision)
    left = halves(columns["tau_nm"], arm.friction.declared_efficiency).half_sum_nm - _expected(cell)
    error = (covariance @ np.einsum("vap,vab,vb->p", design, weight, left))[:4]
    load = arm.load
    centre = np.append(error[0], (error[1:] - load[1:] / load[0] * error[0]) / load[0])
    return centre / oracle.centre_std(covariance[:4, :4], load)


def _expected(cell) -> np.ndarray:
    """Half-sums of the arm as its owner states it, with the true load."""
    arm, rows = cell.arm, rows_of(cell.visits)
    cad = np.concatenate([[b.mass_kg, *(b.mass_kg * b.com_m)] for b in arm.chain.bodies if b])
    middle = np.full(6, np.mean(levels_of(cell.condition).efficiency))
    friction = replace(arm.friction, bias_share=np.zeros(6), driving=middle, driven=middle)
    stated = replace(arm, links=cad, gain=np.zeros(6), cogging_nm=np.zeros((6, 4)), friction=friction)
    seen, _ = reported_nm(stated, rows, (), quiet(stated, rows))
    return halves(seen, friction.declared_efficiency).half_sum_nm
