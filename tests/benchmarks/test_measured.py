"""The last fifth of a measured run is seen by no fit."""

from __future__ import annotations

import numpy as np

from benchmarks.measured import split
from benchmarks.rigs.tables import make_table
from gateway.data.rows import MOVING


def test_the_last_fifth_of_the_time_is_held_out():
    time = np.linspace(3.0, 13.0, 101)
    table = make_table(["none"] * 101, np.full(101, MOVING), np.zeros((101, 6)), np.zeros((101, 6)), time=time)
    fitted, held = split(table)
    assert len(fitted.time_s) + len(held.time_s) == 101
    assert fitted.time_s.max() <= 11.0 < held.time_s.min()
