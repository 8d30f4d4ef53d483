"""A nuisance parameter is one entry in one file: `estimate` and `diagnose` at rest fit it and report it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gateway.data.table import write_csv
from tests.data.product_copy import ProductCopy
from tests.data.resting_arm import Bench

#: Zero of the torque sensor of axis 2 [Nm].
ZERO_NM = 40.0
MADE_UP = """    NuisanceKind("sensor_zero", "offset_nm", 0.0, 50.0, _added),
)
KINDS: Final ="""


@pytest.mark.slow
def test_a_nuisance_is_one_entry_that_estimate_and_diagnose_fit(tmp_path):
    bench = Bench(5, [], poses=12)
    table = bench.both()
    table.tau_nm[:, 1] += ZERO_NM
    write_csv(table, tmp_path / "data.csv")
    (tmp_path / "robot.urdf").write_text(bench.arm.urdf)
    copy = ProductCopy(tmp_path / "copy")
    copy.change("gateway/identify/rest/rest_nuisance.py", ")\nKINDS: Final =", MADE_UP)
    for command in ("estimate", "diagnose"):
        line = (command, "data.csv", "--robot", "robot.urdf", "--inertials", "prior:0.05", "--json", f"{command}.json")
        done = copy.command(*line, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        zero = json.loads((tmp_path / f"{command}.json").read_text())["nuisance"]["sensor_zero"]
        away = (np.array(zero["value"]) - [0.0, ZERO_NM, 0.0, 0.0, 0.0, 0.0]) / np.array(zero["std"])
        assert np.abs(away).max() < 3.5
        assert zero["value"][1] > 5.0 * zero["std"][1]
