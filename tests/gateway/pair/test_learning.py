"""Learning on the run: forgetting, lead, representative relations, and a scalar pair that has to converge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.pair.calibration import PairCalibration
from gateway.pair.iterative_learning import Cycle, IterativeLearning
from gateway.pair.learning_points import Feature, Selection
from gateway.pair.learning_update import Forgetting, LearningRule, from_local, led, local, raw_relation, smoothed
from gateway.pair.path import PairPath
from gateway.pair.transform import apply_correction, correction_between, relation, slave_command
from gateway.pair.transform_function import function_of_knots
from tests.gateway.pair.conftest import FIXED, first_function


def true_commands(path: PairPath, cell: PairCalibration) -> np.ndarray:
    """Slave's commands that would leave no force: millimetres off, smoothly along the path."""
    nominal = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, FIXED)
    u = path.s_m / path.length_m
    off = np.stack([1e-3 * np.sin(3 * u), 2e-3 * u, 1e-3 * u**2, 2e-3 * u, 1e-3 * np.cos(2 * u), 1e-3 * u], axis=1)
    return apply_correction(nominal, off)


def run_cycles(
    learning: IterativeLearning, path: PairPath, cell: PairCalibration, count: int, gain: float = 0.8
) -> list[float]:
    """Cycles in which the hand takes the share `gain` of every mismatch away; largest mismatch per cycle."""
    wanted, largest = true_commands(path, cell), []
    for _ in range(count):
        base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
        mismatch = correction_between(wanted, base)
        largest.append(float(np.abs(mismatch).max()))
        corrections = np.stack([np.zeros_like(mismatch), gain * mismatch], axis=1)
        learning.learn(Cycle(path.commands, base, corrections, 1e5 * mismatch))
    return largest


def learning_of(rule: LearningRule, path: PairPath, cell: PairCalibration, lead: int = 0) -> IterativeLearning:
    return IterativeLearning(rule, path, cell, first_function(path), lead)


def move_knots(learning: IterativeLearning, path: PairPath, cell: PairCalibration, move, force_n: float) -> None:
    """A cycle with a force that moves every knot of the second function by a correction [m, rad]."""
    last = learning.second or learning.first
    base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, last.many(path.s_m))
    corrections, force = np.zeros((len(path), 2, 6)), np.zeros((len(path), 6))
    corrections[:, 1], force[:, 0] = move, force_n
    learning.learn(Cycle(path.commands, base, corrections, force))


@pytest.mark.parametrize(
    ("share", "expected"),
    [(2.0, [False, False, True, False, False, True]), (0.5, [True, True, False, False, True, False])],
)
def test_a_block_is_waited_for_only_once_the_force_was_inside_its_limit(
    path: PairPath, cell: PairCalibration, share: float, expected: list[bool]
) -> None:
    """Blocks of three, hands that take 0.3 of a mismatch: every update leaves 0.7 of the force."""
    wanted = true_commands(path, cell)
    learning, updated = learning_of(LearningRule(cycles=3, smooth_s=0.0), path, cell), list[bool]()
    for _ in expected:
        base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
        mismatch = correction_between(wanted, base)
        if not updated:
            limit_n = share * 1e5 * float(np.linalg.norm(mismatch[:, :3], axis=1).max())
            learning = learning_of(LearningRule(cycles=3, smooth_s=0.0), path, replace(cell, force_limit_n=limit_n))
        corrections = np.stack([np.zeros_like(mismatch), 0.3 * mismatch], axis=1)
        updated.append(learning.learn(Cycle(path.commands, base, corrections, 1e5 * mismatch)).updated)
    assert updated == expected


def test_forgetting_has_the_stated_bias_and_limit() -> None:
    rule = Forgetting(gamma=0.05, phi=0.6)
    for gain in (1.0, 0.5):
        u = 0.0
        for _ in range(500):
            u = float(rule.update(np.array([u]), np.array([gain * (1.0 - u)]), np.zeros(1), 4.0)[0])
        assert 1.0 - u == pytest.approx(rule.bias(gain), rel=1e-9)
        assert rule.bias(gain) == pytest.approx(0.05 / (0.05 + 0.6 * gain))
    assert not rule.converges(4.0)
    assert rule.converges(1.0)
    with pytest.raises(ConfigError, match="does not converge"):
        Forgetting(phi=2.1)
    with pytest.raises(ConfigError, match="gamma"):
        Forgetting(gamma=1.0)


def test_change_rate_enters_with_its_gain() -> None:
    rule = Forgetting(gamma=0.0, phi=0.5, psi_s=0.2)
    assert rule.update(np.array([1.0]), np.array([0.4]), np.array([0.1]), 2.0)[0] == pytest.approx(1.0 + 0.2 + 0.03)


def test_lead_and_symmetric_mean() -> None:
    values = np.arange(10.0)[:, None]
    assert led(values, 3)[:, 0].tolist() == [3, 4, 5, 6, 7, 8, 9, 9, 9, 9]
    assert np.array_equal(smoothed(values, 0), values)
    assert np.allclose(smoothed(values, 2), values)
    peak = np.zeros((9, 1))
    peak[4] = 1.0
    assert np.allclose(smoothed(peak, 1)[:, 0], [0, 0, 0, 1 / 3, 1 / 3, 1 / 3, 0, 0, 0])


def test_local_coordinates_come_back(path: PairPath) -> None:
    reference = path.commands[:20]
    coordinates = np.random.default_rng(0).normal(scale=0.1, size=(20, 6))
    assert np.allclose(local(from_local(coordinates, reference), reference), coordinates, atol=1e-13)


def test_raw_relation_is_that_of_the_corrected_commands(path: PairPath, cell: PairCalibration) -> None:
    corrections = np.random.default_rng(0).normal(scale=1e-3, size=(len(path), 2, 6))
    base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, FIXED)
    raw = raw_relation(cell.bases, path.commands, base, corrections)
    k = 33
    expected = relation(
        cell.w_t_b1,
        apply_correction(path.commands[k], corrections[k, 0]),
        cell.w_t_b2,
        apply_correction(base[k], corrections[k, 1]),
    )
    assert np.allclose(raw[k], expected, atol=1e-14)


def test_every_cycle_contracts_to_the_interpolation_error(path: PairPath, cell: PairCalibration) -> None:
    largest = run_cycles(learning_of(LearningRule(smooth_s=0.0), path, cell), path, cell, 8)
    assert largest[1] == pytest.approx(0.2 * largest[0], rel=0.1)
    assert largest[-1] < 0.03 * largest[0]


@pytest.mark.parametrize("kind", ["mean", "weighted", "median", "mode"])
def test_blocks_update_once_per_r_cycles(path: PairPath, cell: PairCalibration, kind: str) -> None:
    rule = LearningRule(cycles=3, kind=kind, smooth_s=0.0)  # type: ignore[arg-type]
    largest = run_cycles(learning_of(rule, path, cell), path, cell, 13)
    assert largest[0] == largest[1] == largest[2]
    assert largest[3] == pytest.approx(0.2 * largest[0], rel=0.1)
    assert largest[-1] < 0.03 * largest[0]


def test_rereferenced_rebuild_converges_with_five_cycles(path: PairPath, cell: PairCalibration) -> None:
    rule = LearningRule(cycles=5, schedule="rereferenced", smooth_s=0.0)
    largest = run_cycles(learning_of(rule, path, cell), path, cell, 20, gain=1.0)
    assert max(largest[10:]) < 0.03 * largest[0]


def test_sliding_rebuild_is_refused_with_the_reason() -> None:
    with pytest.raises(ConfigError, match=r"unstable from R = 5 on"):
        LearningRule(cycles=5, schedule="sliding")  # type: ignore[arg-type]


def test_forgetting_keeps_a_share_of_the_first_function(path: PairPath, cell: PairCalibration) -> None:
    forgetting = Forgetting(gamma=0.1, phi=0.5)
    rule = LearningRule(forgetting=forgetting, smooth_s=0.0)
    largest = run_cycles(learning_of(rule, path, cell), path, cell, 60, gain=1.0)
    assert largest[-1] / largest[0] == pytest.approx(forgetting.bias(1.0), abs=0.02)


def test_phase_lead_finds_the_error_of_a_delayed_correction(path: PairPath, cell: PairCalibration) -> None:
    delay, wanted = 5, true_commands(path, cell)
    after = []
    for lead in (0, delay):
        learning = IterativeLearning(LearningRule(smooth_s=0.0), path, cell, first_function(path, 40), lead)
        base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
        mismatch = correction_between(wanted, base)
        delayed = mismatch[np.maximum(np.arange(len(path)) - delay, 0)]
        learning.learn(Cycle(path.commands, base, np.stack([0 * delayed, delayed], axis=1), delayed))
        again = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
        after.append(np.abs(correction_between(wanted, again))[delay:-delay].max())
    assert after[1] < 0.2 * after[0]


def test_second_function_is_used_once_it_has_settled(path: PairPath, cell: PairCalibration) -> None:
    learning = learning_of(LearningRule(choice="convergence", smooth_s=0.0), path, cell)
    first = learning.first
    used = []
    for _ in range(5):
        run_cycles(learning, path, cell, 1)
        used.append(learning.in_use is first)
    assert used == [True, True, False, False, False]
    base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
    jump = np.full((len(path), 2, 6), 1e-3)
    learning.learn(Cycle(path.commands, base, jump, np.full((len(path), 6), 1e4)))
    assert learning.in_use is first


@pytest.mark.parametrize(
    ("moved_mm", "force_n", "used"),
    [
        ([0.04, 0.06, 0.04, 0.04], [9.0] * 4, [False, False, False, True]),
        ([0.04, 0.04, 0.1, 0.2, 0.3], [9.0] * 5, [False, True, True, True, False]),
        ([0.04, 0.04, 0.2, 0.1, 0.2], [9.0] * 5, [False, True, True, True, True]),
        ([0.04, 0.04, 0.01, 0.02, 0.03, 0.04], [9.0] * 6, [False, True, True, True, True, True]),
        ([0.04, 0.04, 0.04], [9.0, 9.0, 9.1], [False, True, False]),
        ([0.04, 0.04, 0.04], [9.0, 9.5, 9.4], [False, True, True]),
    ],
)
def test_a_second_function_is_used_while_it_stays_settled(
    path: PairPath, cell: PairCalibration, moved_mm: list[float], force_n: list[float], used: list[bool]
) -> None:
    """Two small updates in a row; given up for a larger force or knots that move ever further."""
    learning = learning_of(LearningRule(choice="convergence", smooth_s=0.0), path, cell)
    found = []
    for distance_mm, force in zip(moved_mm, force_n, strict=True):
        move_knots(learning, path, cell, (1e-3 * distance_mm, 0.0, 0.0, 1e-4, 0.0, 0.0), force)
        found.append(learning.in_use is learning.second)
    assert found == used


def test_a_turn_that_is_too_large_is_not_settled(path: PairPath, cell: PairCalibration) -> None:
    learning = learning_of(LearningRule(choice="convergence", smooth_s=0.0), path, cell)
    for _ in range(4):
        move_knots(learning, path, cell, (1e-5, 0.0, 0.0, 2.1e-4, 0.0, 0.0), 1.0)
    assert learning.in_use is learning.first


def test_reset_forgets_everything(path: PairPath, cell: PairCalibration) -> None:
    learning = learning_of(LearningRule(), path, cell)
    run_cycles(learning, path, cell, 3)
    assert learning.in_use is not learning.first
    learning.reset()
    assert learning.in_use is learning.first
    assert learning.second is None


def test_points_grow_where_force_acts_and_old_ones_stay(path: PairPath, cell: PairCalibration) -> None:
    selection = Selection(features=(Feature("force", 10.0),), largest_count=14)
    learning = learning_of(LearningRule(selection=selection, smooth_s=0.0), path, cell)
    before = set(learning.points.tolist())
    base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, FIXED)
    bump = np.exp(-0.5 * ((np.arange(len(path)) - 108.0) / 4.0) ** 2)
    corrections = np.zeros((len(path), 2, 6))
    corrections[:, 1, 0] = 1e-3 * bump + 1e-4 * np.sin(np.arange(len(path)) / 9.0)
    force = np.zeros((len(path), 6))
    force[:, 0] = 50.0 * bump
    learning.learn(Cycle(path.commands, base, corrections, force))
    assert 108 in set(learning.points.tolist()) - before
    off = correction_between(
        slave_command(cell.w_t_b1, path.commands[108], cell.w_t_b2, learning.in_use.at(float(path.s_m[108]))), base[108]
    )
    assert off[0] == pytest.approx(1e-3, rel=0.15)


# -- the force that was left -------------------------------------------------------------------------------------------


def left_cycles(
    path: PairPath, cell: PairCalibration, share: float, trust: np.ndarray | None = None
) -> list[np.ndarray]:
    """What is wrong (M, 6) with the slave's commands before each of three cycles whose hands do not yield at all."""
    learning = learning_of(LearningRule(left_share=share, smooth_s=0.0), path, cell)
    wanted, wrong = true_commands(path, cell), []
    for _ in range(3):
        base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
        wrong.append(correction_between(wanted, base))
        still = np.zeros((len(path), 2, 6))
        learning.learn(Cycle(path.commands, base, still, 0.0 * wrong[-1], left=wrong[-1], trust=trust))
    return wrong


def test_of_the_force_that_was_left_the_stated_share_is_learned(path: PairPath, cell: PairCalibration) -> None:
    """At the nine points, where the function meets what was learned: 0.3 of it stays, cycle by cycle."""
    points = path.uniform(9)
    first, second, third = (each[points] for each in left_cycles(path, cell, 0.7))
    assert second == pytest.approx(0.3 * first, abs=2e-6)
    assert third == pytest.approx(0.09 * first, abs=2e-6)


def test_barely_known_values_stay_near_the_first_function(path: PairPath, cell: PairCalibration) -> None:
    """Weight one half at the end of the path: what is learned settles at half of what is estimated there."""
    points, trust = path.uniform(9), np.ones(len(path))
    trust[-1] = 0.5
    wrong = left_cycles(path, cell, 1.0, trust)
    first, last = wrong[0][points], wrong[-1][points]
    assert last[:-1] == pytest.approx(0.0 * first[:-1], abs=2e-6)
    assert last[-1] == pytest.approx(0.5 * first[-1], abs=2e-5)


def test_corrections_of_a_cycle_whose_force_is_known_stay_where_they_were_made(
    path: PairPath, cell: PairCalibration
) -> None:
    """With a lead of 10 commands; it belongs to corrections alone, which come later than their force."""
    base = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, FIXED)
    everywhere = function_of_knots(path.s_m, np.tile(FIXED, (len(path), 1, 1)))
    jump = np.zeros((len(path), 2, 6))
    jump[60:, 1, 0] = 1e-3
    for left, at in ((None, 50), (np.zeros((len(path), 6)), 60)):
        learning = IterativeLearning(LearningRule(smooth_s=0.0), path, cell, everywhere, 10)
        learning.learn(Cycle(path.commands, base, jump, jump[:, 1], left=left))
        again = slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, learning.in_use.many(path.s_m))
        assert np.flatnonzero(correction_between(again, base)[:, 0] > 1e-4)[0] == at
