"""Ripple without a stated gear ratio: the order is named where the angles determine it, and only there."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gateway.diagnose import diagnose
from gateway.diagnose.rest.pose_selection import RIPPLE, questions
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.ripple import order_analysis
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.hypothesis_fit import fit, fit_without_effects
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effects.torque_ripple import (
    LEAST_PER_REVOLUTION,
    MOST_PER_REVOLUTION,
    TorqueRipple,
    orders_at_rest,
)
from sim.effects import apply_effects
from sim.offline import half_floor, point_jacobian
from tests.data.resting_arm import Bench, effect, found, problem_of

RIPPLE_OR_OFFSET = frozenset({"torque_ripple", "torque_offset"})


def swinging(seed: int, poses: int, axis: int, order: float, ratio: float = 5.0) -> Bench:
    """An arm of which one axis has ripple of so many noise floors (RMS), diagnosed with its URDF alone."""
    bench = Bench(seed, [], poses=poses)
    size = float(np.sqrt(2.0) * ratio * half_floor(bench.plant, bench.arm.protocol)[axis])
    entry = effect("torque_ripple", [axis + 1], amplitude_nm=size, per_revolution=order, phase_rad=1.0)
    bench.plant = apply_effects(bench.plant, [entry])
    bench.options = replace(bench.options, gear_ratio=None)
    return bench


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "axis", "order"), [(2100, 5, 287.2), (2102, 1, 57.1)])
def test_ripple_is_named_with_its_order_where_the_angles_determine_it(seed, axis, order):
    bench = swinging(seed, 18, axis, order)
    result = diagnose(bench.both(), bench.robot, bench.options)
    assert found(result) == [("torque_ripple", (axis + 1,))]
    named_ripple = result.effects[0]
    assert named_ripple.parameters["per_revolution"] == pytest.approx(order, abs=0.7)
    size = 5.0 * np.sqrt(2.0) * half_floor(bench.plant, bench.arm.protocol)[axis]
    assert named_ripple.parameters["amplitude_nm"] == pytest.approx(size, abs=4.0 * named_ripple.std["amplitude_nm"])
    assert result.verdict == "explained"
    words = [finding for finding in result.findings if "is the best of" in finding.what]
    assert [finding.where for finding in words] == [f"J{axis + 1}"]
    assert "gear ratio" in words[0].advice


@pytest.mark.slow
@pytest.mark.parametrize("poses", [8])
def test_where_any_order_would_do_none_is_named_and_the_reason_is_reported(poses):
    bench = swinging(2101, poses, 3, 163.9)
    result = diagnose(bench.both(), bench.robot, bench.options, only=RIPPLE_OR_OFFSET)
    assert result.verdict == "unexplained"
    assert result.effects == ()
    words = [finding for finding in result.findings if "gear ratio would decide" in finding.what]
    assert len(words) == 1
    assert "J4" in words[0].where
    assert f"{poses} poses" in words[0].what
    assert result.next[0].poses_rad
    # and it does
    with_ratio = replace(bench.options, gear_ratio=np.full(6, 163.9))
    result = diagnose(bench.both(), bench.robot, with_ratio, only=RIPPLE_OR_OFFSET)
    assert ("torque_ripple", (4,)) in found(result)


@pytest.mark.parametrize(
    ("structure_p", "ratio", "asked"), [(1e-5, None, True), (1e-5, 120.0, False), (0.5, None, False)]
)
def test_more_angles_are_asked_for_where_a_ripple_may_be_hidden(structure_p, ratio, asked):
    bench = Bench(3, [], poses=6)
    knowledge = Knowledge(link_std=0.05, gear_ratio=None if ratio is None else np.full(6, ratio))
    problem = problem_of(bench, bench.both())
    decision = SimpleNamespace(full=fit_without_effects(problem), near=(), structure_p=structure_p)
    entries = questions(problem, decision, bench.robot, knowledge)  # type: ignore[arg-type]
    assert [entry.tells_apart for entry in entries] == [RIPPLE] * asked
    assert all(len(entry.poses_rad) == REST.asked for entry in entries)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2101])
def test_a_torque_without_order_is_not_called_ripple(seed):
    bench = Bench(seed, [], poses=18)
    size = float(20.0 * half_floor(bench.plant, bench.arm.protocol)[2])
    spring = effect("linkage_spring", [3], stiffness_nm=size, phase_rad=0.4)
    bench.plant = apply_effects(bench.plant, [spring], point_jacobian(bench.arm.chain))
    result = diagnose(bench.both(), bench.robot, replace(bench.options, gear_ratio=None), only=RIPPLE_OR_OFFSET)
    assert result.verdict in ("unexplained", "improved")
    assert "torque_ripple" not in {name for name, _ in found(result)}


def left_of_axis(bench: Bench, axis: int):
    problem = problem_of(bench, bench.both())
    return order_analysis(problem, fit(problem, (), first_noise(problem)), axis)


@pytest.mark.slow
def test_random_torque_by_pose_is_named_as_seldom_as_stated():
    """A torque that comes back with the pose and has no order at all, on axis 3 of arms at eighteen poses."""
    chances = []
    for seed in range(20):
        bench = Bench(300 + seed % 4, [], poses=18)
        size = 5.0 * half_floor(bench.plant, bench.arm.protocol)[2]
        torque = dict(enumerate(size * np.random.default_rng(seed).standard_normal(18)))
        table = bench.both()
        more = np.array([torque[int(pose)] for pose in table.pose])
        problem = problem_of(
            bench, replace(table, tau_nm=table.tau_nm + np.where(np.arange(6) == 2, more[:, None], 0.0))
        )
        swing = order_analysis(problem, fit(problem, (), first_noise(problem)), 2)
        chances.append(1.0 if swing is None else swing.chance)
    assert np.mean(np.array(chances) * 6 <= REST.ripple_p) <= 1 / 40
    assert 0.2 < np.mean(np.array(chances) < 0.5) < 0.8


def test_too_few_angles_and_little_that_is_left_are_not_asked():
    assert left_of_axis(swinging(2102, REST.ripple_angles - 1, 1, 57.1), 1) is None
    assert left_of_axis(swinging(2102, 18, 1, 57.1), 2) is None
    swing = left_of_axis(swinging(2102, 18, 1, 57.1), 1)
    assert swing is not None
    assert swing.angles == 18
    assert swing.term.per_revolution == pytest.approx(57.1, abs=0.7)


def test_equally_spaced_angles_report_the_orders_they_cannot_distinguish():
    """At angles a step apart, orders that differ by whole turns per step are the same."""
    bench = swinging(2102, 18, 2, 57.1)
    step = 0.1
    bench.poses[:, 2] = -0.85 + step * np.random.default_rng(0).permutation(18)
    swing = left_of_axis(bench, 2)
    assert swing is not None
    fold = 2.0 * np.pi / step
    named_ripple = np.array([swing.term.per_revolution, *swing.aliases])
    away = np.abs((named_ripple[:, None] - np.array([57.1, -57.1])) / fold)
    assert (np.abs(away - np.round(away)).min(axis=1) * fold < 2.5).all()
    assert len(swing.aliases) == REST.aliases


def test_orders_that_are_looked_through_miss_none():
    q = np.linspace(-1.0, 1.0, 9)
    orders = orders_at_rest(q)
    assert orders[0] == LEAST_PER_REVOLUTION
    assert orders[-1] < MOST_PER_REVOLUTION <= orders[-1] + 0.51
    # between two orders a swing turns by less than half a radian at either end
    assert np.diff(orders) * 1.0 == pytest.approx(0.5)
    assert not len(orders_at_rest(np.full(9, 0.3)))


def test_what_was_looked_through_is_paid_for_and_is_no_part_of_the_effect():
    assert TorqueRipple(2, 57.1).tries == 1
    assert TorqueRipple(2, 57.1, 900).tries == 900
    assert TorqueRipple(2, 57.1, 900) == TorqueRipple(2, 57.1)
