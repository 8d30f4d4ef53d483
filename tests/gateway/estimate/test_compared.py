"""Results of one arm before and after a service, of readings from pinocchio."""

from dataclasses import replace

import numpy as np

from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.result.compare import compare

TOOL = (8.0, 0.12, -0.03, 0.05)


def result(arm, poses, measured, seed, mass_kg=TOOL[0], scale=(1.0,) * 6):
    """Estimate of the tool, with the true torque constants of the axes larger by `scale`."""
    loads = {"none": None, "tool": (mass_kg, *TOOL[1:])}
    table = measured(arm, poses, loads, np.random.default_rng(seed), left=0.02)
    options = Knowledge(link_std=0.05, gain_std=(0.03,) * 6)
    return run(replace(table, tau_nm=table.tau_nm / np.array(scale)), arm.robot, options)


def test_an_exchanged_motor_of_an_axis_that_carries_no_weight_is_not_called_unchanged(arm, poses, measured):
    """J1 is vertical: its readings are friction alone. J2 carries the arm: +30 % are beyond 10 %."""
    before = result(arm, poses, measured, 1)
    after = result(arm, poses, measured, 2, scale=(1.3, 1.3, 1.0, 1.0, 1.0, 1.0))
    found = compare(before, after, ("a", "b"), {})
    outcomes = {row.where: row.outcome for row in found.quantities if row.what == "torque constant"}
    assert outcomes["J1"] == "cannot tell"
    assert outcomes["J2"] != "unchanged"
    assert any("J1 torque constant" in remark and "not measured" in remark for remark in found.remarks)


def test_errors_of_links_and_constants_are_the_same_in_both_results(arm, poses, measured):
    pair = [result(arm, poses, measured, seed, mass_kg) for seed, mass_kg in ((1, 8.0), (3, 9.0))]
    alone = [replace(each, loads=(replace(each.loads[0], common_errors={}),)) for each in pair]
    half_kg, apart_kg = (compare(*two, ("a", "b"), {}).quantities[0].half_width for two in (pair, alone))
    assert half_kg < 0.8 * apart_kg
