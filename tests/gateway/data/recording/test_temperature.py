"""Temperatures of visits and periods: stored, read back, in the rows; a recording without them stays readable."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from gateway.cell.config import load_cell
from gateway.data.recording.reader import read_unsealed
from gateway.errors import InputError
from gateway.excite.excitation import fingerprint
from tests.data.visits import ARM_HEADER, CELL, header_of, recording_of, visit
from tests.gateway.data.recording.test_periods import SERIES, period

WARM_C = np.array([40.0, 41.5, np.nan, 39.0, 38.5, 37.0])


@pytest.fixture
def path(tmp_path) -> Path:
    """Two visits and two periods, the second of each without temperatures."""
    warm = [replace(visit(1, -1), temperature_c=WARM_C), replace(period(1, start=1000), temperature_c=WARM_C + 5.0)]
    content = [warm[0], visit(1, 1, start_s=1.0), warm[1], period(2, start=2000)]
    arm = replace(ARM_HEADER, excitations={fingerprint(SERIES): SERIES.plain()})
    return recording_of(tmp_path / "run.h5", header_of(load_cell(CELL)), content, arm, finish=False)


def test_rows_have_the_temperature_that_was_read_and_nan_where_none_was(path, monkeypatch):
    monkeypatch.chdir(CELL.parents[2])
    recording = read_unsealed(path)
    table = recording.table()
    rest = table.take(~table.moving).temperature_c
    assert np.array_equal(rest, [WARM_C, np.full(6, np.nan)], equal_nan=True)
    moving = table.take(table.moving)
    first = moving.temperature_c[moving.extra["x_period"] == 1]
    assert np.array_equal(first, np.tile(WARM_C + 5.0, (len(first), 1)), equal_nan=True)
    assert np.isnan(moving.temperature_c[moving.extra["x_period"] == 2]).all()


@pytest.mark.parametrize("broken", [np.full(6, np.inf), np.full(5, 20.0)])
def test_a_temperature_that_is_no_number_per_axis_is_refused(path, broken, monkeypatch):
    monkeypatch.chdir(CELL.parents[2])
    with h5py.File(path, "r+") as file:
        file["arms/main/visits/0001"].attrs["temperature_c"] = broken
    with pytest.raises(InputError, match="temperature_c"):
        read_unsealed(path)
