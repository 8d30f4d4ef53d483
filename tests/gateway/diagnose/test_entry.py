"""What is held out has to be of the kind and of the arm that is diagnosed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.diagnose import diagnose
from gateway.errors import DataUnusable, InputError
from tests.data.moving_arm import World, measured
from tests.data.resting_arm import Bench
from tests.support.rigs.tables import make_table


def resting(count=6):
    rng = np.random.default_rng(3)
    return make_table(["none"] * count, np.arange(count), rng.uniform(-1, 1, (count, 6)), rng.normal(size=(count, 6)))


def test_a_rest_table_held_out_of_moving_runs_is_refused():
    table, robot, _ = measured(0, World(), duration_s=6.0)
    with pytest.raises(DataUnusable, match=r"--holdout: the fitted rows move, the held-out rows are at rest"):
        diagnose(table, robot, holdout=resting())


def test_a_moving_run_held_out_of_rest_visits_is_refused():
    bench = Bench(3, [])
    table, _, _ = measured(0, World(), duration_s=3.0)
    with pytest.raises(DataUnusable, match="are at rest, the held-out rows move"):
        diagnose(bench.both(), bench.robot, bench.options, holdout=table)


def test_of_a_mixed_hold_out_the_rows_of_the_other_kind_are_left_out_aloud():
    table, robot, _ = measured(0, World(), duration_s=12.0)
    first, last = table.take(table.time_s < 9.0), table.take(table.time_s >= 9.5)
    result = diagnose(first, robot, holdout=concatenate([last, resting()]))
    assert result.holdout_kind == "given"
    assert any("6 rest rows of the hold-out were not used" in finding.what for finding in result.findings)


def test_a_hold_out_of_another_number_of_axes_is_refused():
    table, robot, _ = measured(0, World(), duration_s=6.0)
    other = replace(
        table, **{name: getattr(table, name)[:, :5] for name in ("q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm")}
    )
    with pytest.raises(InputError, match="of 5 axes, robot 'compact10' has 6"):
        diagnose(table, robot, holdout=other)
