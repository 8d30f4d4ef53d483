"""When an axis counts as at rest: closed forms over speed, noise and SYNC period."""

from __future__ import annotations

import numpy as np
import pytest

from drives.standstill import STILL_REVOLUTIONS, STILL_S, Standstill

TURN = 65_536.0


def rests(counts: np.ndarray, period_s: float) -> list[bool]:
    """Whether the axis counts as at rest after each position."""
    axis, at_rest = Standstill(TURN), []
    for row, count in enumerate(counts):
        axis.see(row * period_s, round(float(count)))
        at_rest.append(axis.at_rest())
    return at_rest


@pytest.mark.parametrize("period_s", [0.001, 0.004, 0.01, 0.02])
@pytest.mark.parametrize("speed_turns_s", [0.02, 0.3, 50.0])
def test_an_axis_that_moves_is_never_at_rest_and_one_that_stopped_is_after_the_time(period_s, speed_turns_s):
    """A tenth of the range in 50 ms is 0.006 revolutions a second: a slow one behind a low gear ratio moves as well."""
    rows = round(1.0 / period_s)
    moving = TURN * speed_turns_s * period_s * np.arange(rows)
    seen = rests(np.concatenate([moving, np.full(rows, moving[-1])]), period_s)
    assert not any(seen[:rows])
    assert seen.index(True) - (rows - 1) == pytest.approx(STILL_S / period_s, rel=0.2, abs=1.0)


@pytest.mark.parametrize("period_s", [0.001, 0.004, 0.01, 0.02])
@pytest.mark.parametrize("width", [0.0, 0.1, 0.9])
def test_an_axis_that_flickers_within_the_range_is_at_rest_also_before_it_has_moved(period_s, width):
    counts = TURN * STILL_REVOLUTIONS * width * np.random.default_rng(1).integers(0, 2, round(1.0 / period_s))
    assert rests(counts, period_s)[-1]
