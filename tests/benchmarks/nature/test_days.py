"""DayMotors over a day, and repeated measurements of one load."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.nature.days import DayMotors, sessions
from benchmarks.nature.effect import rows_of
from benchmarks.nature.nature_cell import draw_cell
from sim.offline import PlannedVisit

RISE_K, RISE_S, PER_K = 50.0, 2000.0, 0.001


def motors(**more):
    one = np.ones(6)
    return DayMotors(PER_K * one, RISE_K * one, RISE_S * one, 100.0 * one, morning_c=25.0, warmer_k=0.0, **more)


def visits(count, first_s=0.0):
    return rows_of([PlannedVisit(k, "tool", first_s + 28.0 * k, np.zeros(6)) for k in range(count)])


def test_a_motor_that_holds_half_its_rated_torque_approaches_a_quarter_of_the_rise():
    rows = visits(400)
    torque = np.full((len(rows.time_s), 6), 50.0)
    seen = motors().read(rows, torque)
    expected = 50.0 * (1.0 + PER_K * 0.25 * RISE_K * (1.0 - np.exp(-rows.time_s / RISE_S)))
    assert seen[:, 0] == pytest.approx(expected, rel=1e-9)


def test_a_motor_cools_while_the_brakes_hold():
    warm = motors(above_k=np.full(6, 20.0))
    rows = visits(1, first_s=2000.0)
    first = warm.read(rows, np.zeros((2, 6)) + 1e-9)[0, 0] / 1e-9
    assert first == pytest.approx(1.0 + PER_K * 20.0 * np.exp(-2000.0 / RISE_S), rel=1e-3)


def test_repetitions_have_other_poses_a_remounted_load_and_start_cold_every_day():
    found = list(sessions(draw_cell(1, "base"), 6))
    assert [each.day for each in found] == [1, 1, 2, 2, 3, 3]
    assert len({each.tool.com_m.tobytes() for each in found}) == 6
    assert max(np.abs(each.tool.com_m - found[0].tool.com_m).max() for each in found) < 0.002
    assert len({each.columns["q_rad"].tobytes() for each in found}) == 6
    starts = [each.columns["time_s"].min() for each in found]
    assert all(starts[k] < 300.0 < starts[k + 1] for k in (0, 2, 4))
    again = list(sessions(draw_cell(1, "base"), 6))
    assert np.array_equal(found[5].columns["tau_nm"], again[5].columns["tau_nm"])
