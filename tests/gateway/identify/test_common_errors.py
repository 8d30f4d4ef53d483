"""Errors that all measurements share: what they change, against the estimate of data with such an error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.nature.nature_cell import draw_cell
from gateway.estimate import estimate
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf
from tests.support.rigs.tables import simulated_table

GAIN_STD = 0.1
OPTIONS = Knowledge(link_std=0.05, gain_std=(GAIN_STD,) * 6)


@pytest.fixture(scope="module")
def measured():
    cell = draw_cell(70001, "base")
    options = replace(OPTIONS, efficiency=tuple(map(float, cell.stated.efficiency)))
    return simulated_table(cell.measure(cell.visits)[0]), robot_from_urdf(cell.stated.urdf, "base"), options


def parts(load):
    return np.array([load.mass_kg, *load.com_m])


def test_a_torque_constant_that_is_wrong_moves_the_load_as_stated(measured):
    table, robot, options = measured
    (load,) = estimate(table, robot, options, "joint").loads
    step = 0.005
    gain = np.ones(6)
    gain[1] += step
    (moved,) = estimate(replace(table, tau_nm=table.tau_nm * gain), robot, options, "joint").loads
    own = np.sqrt(0.5) * GAIN_STD  # half the variance of a constant is common to all axes
    change = (parts(moved) - parts(load)) / step * own
    assert load.common_errors["gain"][:, 1] == pytest.approx(-change, rel=0.2, abs=0.1 * np.abs(change).max())


def test_a_link_that_weighs_more_than_stated_moves_the_load_as_stated(measured):
    table, robot, options = measured
    (load,) = estimate(table, robot, options, "joint").loads
    link, share = 2, 0.05
    heavier = np.ones(6)
    heavier[link] += share
    # the first moment stays: the mass alone is one parameter of the prior
    other = replace(robot, mass_kg=robot.mass_kg * heavier, com_m=robot.com_m / heavier[:, None])
    (moved,) = estimate(table, other, options, "joint").loads
    column = load.common_errors["links"][:, 4 * link]
    assert column == pytest.approx(parts(moved) - parts(load), rel=0.3, abs=0.02 * load.mass_std_kg)


def test_shared_errors_are_a_part_of_the_stated_variance(measured):
    table, robot, options = measured
    (load,) = estimate(table, robot, options, "joint").loads
    shared = sum(np.sum(values**2, axis=1) for values in load.common_errors.values())
    stated = np.array([load.mass_std_kg, *load.com_std_m]) ** 2
    assert (shared < stated).all()
    assert shared[0] > 0.5 * stated[0], "constants of 10 % are most of the uncertainty of the mass"
