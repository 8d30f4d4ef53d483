"""The calibration benchmark draws what it says, counts what holds, and rejects intervals that are too narrow."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.calibrated.__main__ import figures
from benchmarks.calibrated.answers import answer_of
from benchmarks.calibrated.nature import at_rest, draw, poses


def test_half_sums_are_torque_with_gain_and_offset():
    cell = draw(3, 0.01)
    q_rad, gain = poses(cell, 4), 0.02 * np.ones(6)
    rows = at_rest(cell, q_rad, "none", "r", 0.0, gain, np.zeros((4, 6)), repeats=1)
    up, down = (np.array([row["tau"] for row in rows[first::2]]) for first in (0, 1))
    unloaded = at_rest(cell, q_rad, "none", "r", 0.0, np.zeros(6), np.zeros((4, 6)), repeats=1)
    middle = 0.5 * (np.array([row["tau"] for row in unloaded[0::2]]) + np.array([row["tau"] for row in unloaded[1::2]]))
    assert np.abs(0.5 * (up + down) - 1.02 * middle).max() < 0.15 * cell.band_nm.max()
    assert (0.5 * (up - down) > 0.8 * cell.band_nm).all()


@pytest.mark.parametrize(("scale", "rejected"), [(1.0, False), (2.0, True)])
def test_intervals_that_are_too_narrow_are_rejected(scale: float, rejected: bool):
    z = scale * np.random.default_rng(0).standard_normal((60, 4))
    answers = [{"condition": "rest", "z": row.tolist(), "std": [0.01] * 4, "warnings": []} for row in z]
    met = [entry["met"] for name, entry in figures(answers, ["rest"]).items() if "hold" in name]
    assert (False in met) == rejected


def test_a_table_at_rest_is_estimated():
    answer = answer_of((1, "rest"))
    assert answer["refused"] == ""
    assert np.isfinite(answer["z"]).all()
