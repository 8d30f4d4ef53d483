"""The cells of the conflict benchmark are what they claim, and their answers are scored as stated."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.conflict.answers import answer_of
from benchmarks.conflict.arm import GRAVITY_M_S2, LinkMasses
from benchmarks.conflict.figures import false_alarm, is_unreported, warned
from benchmarks.conflict.plant import draw_cell, measure


def test_torque_is_that_of_a_point_mass_when_links_and_friction_vanish():
    cell = draw_cell(1)
    cell.true = LinkMasses(np.zeros(6), np.zeros((6, 3)))
    cell.loads["tool"] = np.array([2.0, 0.0, 0.0, 0.0])
    cell.poses_rad = np.zeros((1, 6))
    cell.gain[:] = cell.repeat_rad = cell.scatter = 0.0
    for field in ("coulomb_nm", "driving", "driven", "bias_nm"):
        getattr(cell.friction, field)[:] = 0.0
    columns = measure(cell)
    flange_x_m = cell.arm.geometry.origin_m[:, 0].sum() - cell.arm.geometry.origin_m[:2, 0].sum()
    # axis 2 turns about +y: a positive turn lowers what is in front of it
    noise_nm = 5 * 0.01 * cell.size_nm[1] / np.sqrt(200)
    assert columns["tau2_nm"][-1] == pytest.approx(-2.0 * GRAVITY_M_S2 * flange_x_m, abs=noise_nm)
    assert columns["tau2_nm"][0] == pytest.approx(0.0, abs=noise_nm)


def test_right_cell_is_answered_and_reversed_signs_are_refused():
    right, wrong = (answer_of((0, name, "floor", "estimate")) for name in ("clean", "torque sign, all"))
    assert right["exit"] == 0
    assert not false_alarm(right)
    assert right["loads"][0]["off"] < 3.0
    assert wrong["exit"] == 7
    assert warned(wrong)
    assert not is_unreported(wrong)
