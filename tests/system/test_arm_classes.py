"""A recording ends on arms with light wrists, with axes in one line and without link masses."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.strangers.simulated import record
from gateway.data.recording.reader import read
from tests.data.arm_classes import CLASSES

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["seven light", "seven with a thin flange", "six without mass"])
def test_record_ends_and_the_poses_are_held(name: str, tmp_path):
    code, output = record(CLASSES[name], tmp_path)
    assert code == 0, output
    table = read(tmp_path / "run.h5").table()
    assert len(np.unique(table.pose)) == 2
    assert np.isfinite(table.tau_nm).all()
