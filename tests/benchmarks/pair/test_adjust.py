"""Position adjustment on a spring that answers late."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.errors import ConfigError
from tests.support.pair.adjust import Adjustment, AdjustmentRule

CHAIN = np.diag(np.repeat([1.6e5, 3.6e3], 3))
DT_S = 0.004


def adjust(gap: np.ndarray, rule: AdjustmentRule, noise: float = 0.0, delay: int = 9) -> tuple[str, Adjustment, int]:
    adjustment = Adjustment(rule, DT_S, CHAIN, delay * DT_S)
    rng = np.random.default_rng(0)
    sent = [np.zeros(6)] * delay
    for cycle in range(1, 100_000):
        felt = CHAIN @ (gap - sent[-delay]) + noise * rng.normal(size=6)
        verdict = adjustment.step(felt)
        sent.append(adjustment.correction)
        if verdict != "running":
            return verdict, adjustment, cycle
    raise AssertionError("never ended")


def test_force_goes_and_the_gap_is_the_correction() -> None:
    gap = np.array([1.5e-3, -2e-3, 1e-3, 3e-3, -1e-3, 2e-3])
    verdict, adjustment, cycles = adjust(gap, AdjustmentRule())
    assert verdict == "done"
    assert np.abs(CHAIN @ (gap - adjustment.correction))[:3].max() < 3.0
    assert cycles * DT_S > np.linalg.norm(gap[:3]) / 1e-3


def test_speed_is_limited() -> None:
    adjustment = Adjustment(AdjustmentRule(), DT_S, CHAIN, 0.035)
    adjustment.step(np.array([1e4, 0, 0, 0, 0, 1e4]))
    assert np.linalg.norm(adjustment.correction[:3]) == pytest.approx(1e-3 * DT_S)
    assert np.linalg.norm(adjustment.correction[3:]) == pytest.approx(5e-3 * DT_S)


def test_given_up_when_too_far_or_too_long() -> None:
    assert adjust(np.array([0.05, 0, 0, 0, 0, 0]), AdjustmentRule(time_s=100.0))[0] == "too_far"
    assert adjust(np.array([0.015, 0, 0, 0, 0, 0]), AdjustmentRule(time_s=2.0))[0] == "too_long"
    assert adjust(np.zeros(6), AdjustmentRule(time_s=1.0), noise=50.0)[0] == "too_long"


def test_quiet_cycles_must_follow_each_other() -> None:
    adjustment = Adjustment(AdjustmentRule(), DT_S, CHAIN, 0.035)
    for cycle in range(1, 30):
        verdict = adjustment.step(np.array([50.0 if cycle == 8 else 0.0, 0, 0, 0, 0, 0]))
        assert verdict == ("done" if cycle >= 18 else "running")
        if verdict == "done":
            break
    assert cycle == 18


def test_two_hands_take_half_each() -> None:
    one = Adjustment(AdjustmentRule(), DT_S, CHAIN, 0.035)
    two = Adjustment(AdjustmentRule(), DT_S, CHAIN, 0.035, hands=2)
    for each in (one, two):
        each.step(np.array([1.0, 0, 0, 0, 0, 0]))
    assert two.correction[0] == pytest.approx(0.5 * one.correction[0])


def test_gain_that_would_oscillate_is_refused() -> None:
    with pytest.raises(ConfigError, match="must lie between"):
        Adjustment(AdjustmentRule(compliance=(7e-6, 8e-6)), DT_S, CHAIN, 0.035)
    with pytest.raises(ConfigError, match="must lie between"):
        Adjustment(AdjustmentRule(compliance=(1e-6, 8e-6)), DT_S, CHAIN, 0.035)
