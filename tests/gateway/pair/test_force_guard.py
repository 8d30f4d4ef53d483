"""When the force stops both arms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.pair.force import ForceGuard, cause_of


def test_trips_after_more_than_20_ms_above_twice_the_limit() -> None:
    guard = ForceGuard(40.0, 0.004)
    assert [guard.step(81.0) for _ in range(7)] == [False] * 5 + [True] * 2


def test_short_peaks_and_forces_below_do_not_trip_and_a_trip_stays() -> None:
    guard = ForceGuard(40.0, 0.004)
    for _ in range(50):
        assert not any(guard.step(200.0) for _ in range(5))
        assert not guard.step(80.0)
    for _ in range(6):
        guard.step(math.nan)
    assert guard.step(0.0)


def test_useless_limits_are_refused() -> None:
    with pytest.raises(ConfigError, match="force guard"):
        ForceGuard(0.0, 0.004)


@pytest.mark.parametrize(
    ("calm_s", "rise_s", "word"),
    [(0.0, 0.5, "from the start"), (0.4, 0.06, "slipped"), (0.4, 0.3, "it grew for 0.")],
)
def test_how_the_force_got_there_says_what_is_wrong(calm_s: float, rise_s: float, word: str) -> None:
    dt_s = 0.004
    calm = np.full(round(calm_s / dt_s), 20.0)
    rise = np.linspace(35.0, 90.0, round(rise_s / dt_s))
    assert word in cause_of(np.concatenate([calm, rise]), 80.0, dt_s)
