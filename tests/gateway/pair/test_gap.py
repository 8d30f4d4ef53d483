"""Sensors that do not follow the hands: a shift `d` of the hand that carries them shortens a beam by `beam . d`."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.motion.reactions import ARM_RULES
from gateway.pair.distance import DistanceSensors
from gateway.pair.gap import SensorCheck
from tests.gateway.pair.conftest import BEAM, ORIGIN_M

GAP_M, SYNCS = 0.02, ARM_RULES["sensors"].count
SHIFT_M = np.array([0.4e-3, 0.0, -1.0e-3])


def check(count: int = 6) -> SensorCheck:
    sensors = DistanceSensors(*(each[:count] for each in (ORIGIN_M, BEAM, ORIGIN_M + GAP_M * BEAM, -BEAM)))
    channels = tuple(SimpleNamespace(subindex=number) for number in (1, 2, 3, 4, 5, 8)[:count])
    layout = SimpleNamespace(config=SimpleNamespace(channel=channels), estimator=SimpleNamespace(sensors=sensors))
    return SensorCheck(layout)  # type: ignore[arg-type]


def hands(shift_m: np.ndarray) -> np.ndarray:
    """The second hand, off by more than the sensors' noise and by as much all the time."""
    pose = np.eye(4)
    pose[:3, 3] = shift_m + [2e-3, -1e-3, 3e-3]
    return pose


def answers(change_m: np.ndarray, syncs: int = SYNCS) -> list[str]:
    """What is said when readings have changed by this while the hand went SHIFT_M."""
    found = check()
    assert found.take(np.full(6, GAP_M), hands(np.zeros(3))) == ""
    return [found.take(GAP_M + change_m, hands(SHIFT_M)) for _ in range(syncs)]


def test_sensors_that_follow_the_hands_are_accepted_wherever_these_are():
    noise = 2e-5 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    assert answers(-BEAM @ SHIFT_M + noise, 9) == [""] * 9


@pytest.mark.parametrize(("one", "other"), [(0, 3), (2, 5), (3, 5)])
def test_two_sensors_that_are_swapped_are_named(one, other):
    change = -BEAM @ SHIFT_M
    change[[one, other]] = change[[other, one]]
    number = (1, 2, 3, 4, 5, 8)
    said = answers(change)
    assert said[:-1] == [""] * (SYNCS - 1)
    assert f"sensors {number[one]} and {number[other]} are swapped" in said[-1]


@pytest.mark.parametrize(("factor", "moved"), [(0.0, "0.00"), (-1.0, "-1.00")])
def test_a_sensor_that_is_constant_or_inverted_is_named(factor, moved):
    change = -BEAM @ SHIFT_M
    change[1] *= factor
    why = answers(change)[-1]
    assert f"sensor 2 moved by {moved} mm where the hand motion gives 1.00 mm" in why


def test_a_sensor_that_is_alone_cannot_be_swapped():
    found = check(1)
    found.take(np.array([GAP_M]), hands(np.zeros(3)))
    said = [found.take(np.array([GAP_M]), hands(SHIFT_M)) for _ in range(SYNCS)]
    assert "sensor 1 moved by 0.00 mm" in said[-1]


def test_one_odd_sync_and_none_at_all_say_nothing():
    found = check()
    for _ in range(3):
        assert found.take(None, hands(np.zeros(3))) == ""
    found.take(np.full(6, GAP_M), hands(np.zeros(3)))
    for _ in range(4):
        for change in [np.full(6, 1e-3)] * (SYNCS - 1) + [-BEAM @ SHIFT_M]:
            assert found.take(GAP_M + change, hands(SHIFT_M)) == ""
