"""Which commissioning mistakes are looked for, and what undoing one does to a table."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rigs.tables import make_table
from gateway.diagnose.rest.mistakes import Mistake, candidates


def table():
    rng = np.random.default_rng(0)
    return make_table(
        ["none"] * 4, np.arange(4), rng.normal(size=(4, 6)), rng.normal(size=(4, 6)), std=0.1, direction=1
    )


@pytest.mark.parametrize("axes", [1, 2, 6])
def test_every_mistake_of_the_measured_axes_is_looked_for_once(axes):
    found = list(candidates(np.arange(6) < axes))
    pairs = axes * (axes - 1) // 2
    counts = {name: len([each for each in found if each.name == name]) for name in {each.name for each in found}}
    # a factor on one axis or, where there are several, on all; swapped torque alone, or with the angles
    expected = {"sign_reversed": axes, "axes_swapped": 2 * pairs, "current_rms_peak": 2 * (axes + (axes > 1))}
    assert counts == {name: count for name, count in expected.items() if count}
    assert len(set(found)) == len(found)
    assert {joint for each in found for joint in each.joints} == set(range(1, axes + 1))
    assert {each.handicap > 0 for each in found if len(each.joints) > 2} <= {True}


def test_undoing_a_mistake_touches_its_axes_alone():
    read = table()
    turned = Mistake("sign_reversed", (3,)).undo(read)
    assert turned.tau_nm == pytest.approx(read.tau_nm * [1, 1, -1, 1, 1, 1])
    assert turned.tau_std_nm == pytest.approx(read.tau_std_nm)
    halved = Mistake("current_rms_peak", (2, 5), 2.0).undo(read)
    assert halved.tau_nm == pytest.approx(read.tau_nm * [1, 0.5, 1, 1, 0.5, 1])
    assert halved.tau_std_nm == pytest.approx(read.tau_std_nm * [1, 0.5, 1, 1, 0.5, 1])
    for with_positions in (False, True):
        swapped = Mistake("axes_swapped", (1, 4), with_positions=with_positions).undo(read)
        order = [3, 1, 2, 0, 4, 5]
        assert swapped.tau_nm == pytest.approx(read.tau_nm[:, order])
        assert swapped.q_rad == pytest.approx(read.q_rad[:, order] if with_positions else read.q_rad)
