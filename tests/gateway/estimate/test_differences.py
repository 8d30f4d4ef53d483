"""Differences between loads: readings of one approach direction are subtracted, and gains change between occasions."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.errors import DataUnusable
from gateway.estimate import Coefficient, estimate
from gateway.identify.knowledge import Knowledge

TOOL = (8.0, 0.12, -0.03, 0.05)
G_M_S2 = 9.80665
#: Standard deviation of the change of a gain from one occasion to the next: of an axis, and common to all.
CHANGE = (0.004, 0.003)


def scattered(arm, poses, measured, bare, loaded):
    """Unloaded arm and load, each approached from these directions; friction scatters by 5 % of the band."""
    rng = np.random.default_rng(4)
    parts = [({"none": None}, bare), ({"tool": TOOL}, loaded)]
    return concatenate([measured(arm, poses, load, rng, left=0.05, sides=sides) for load, sides in parts])


@pytest.mark.parametrize(
    ("bare", "loaded", "known", "warned"),
    [((1, -1), (1,), True, False), ((-1,), (1, -1), True, False), ((1,), (-1,), False, True)],
    ids=["loaded from one side", "bare from one side", "unknown directions"],
)
def test_friction_is_not_taken_for_mass(arm, poses, measured, bare, loaded, known, warned):
    table = scattered(arm, poses, measured, bare, loaded)
    if not known:
        table = replace(table, direction=np.zeros_like(table.direction))
    found = estimate(table, arm.robot, Knowledge(link_std=np.inf), "difference")
    (load,) = found.loads
    # without directions a share of the torque may be friction: wider, but it still determines the mass
    assert abs(load.mass_kg - TOOL[0]) < 2.0 * load.mass_std_kg < (0.8 if known else 1.5)
    assert any("friction is not separated" in each.what for each in found.findings) == warned


def test_opposite_directions_are_refused_or_left_out_by_name(arm, poses, measured):
    with pytest.raises(DataUnusable, match="opposite"):
        estimate(scattered(arm, poses, measured, (1,), (-1,)), arm.robot, Knowledge(link_std=np.inf), "difference")
    # J2 alone came from the other side, in poses 3 and 4: twice its friction band is in these readings
    table = scattered(arm, poses, measured, (1,), (1,))
    other = (table.load == "tool") & np.isin(table.pose, [3, 4])
    tau, direction = table.tau_nm.copy(), table.direction.copy()
    tau[other, 1] -= 2.0 * arm.band_nm[1]
    direction[other, 1] = -1
    table = replace(table, tau_nm=tau, direction=direction)
    found = estimate(table, arm.robot, Knowledge(link_std=np.inf), "difference")
    assert abs(found.loads[0].mass_kg - TOOL[0]) < 2.0 * found.loads[0].mass_std_kg
    (named,) = [each for each in found.findings if "opposite" in each.what]
    assert (named.where, named.what[:11]) == ("load tool, J2", "poses 3, 4 ")


def test_a_change_of_gain_between_occasions_is_in_the_uncertainty_of_a_difference(arm, poses, measured):
    """The variance is the sum of the squared effects of one standard deviation of each change, on each occasion."""
    table = scattered(arm, poses, measured, (1, -1), (1, -1))
    share = 1e-2  # of a standard deviation, so that the estimate stays linear

    def mass(tau_nm, change=1.0):
        changed = replace(table, tau_nm=tau_nm)
        return estimate(changed, arm.robot, Knowledge(link_std=np.inf, change=change), "difference").loads[0]

    steady, free = mass(table.tau_nm), mass(table.tau_nm, 1e-6)
    patterns = [*(CHANGE[0] * np.eye(6)), np.full(6, CHANGE[1])]
    variance = 0.0
    for occasion in ("none", "tool"):
        here = (table.load == occasion)[:, None]
        for pattern in patterns:
            moved = mass(table.tau_nm * (1.0 + share * pattern * here))
            variance += ((moved.mass_kg - steady.mass_kg) / share) ** 2
    stated = steady.mass_std_kg**2 - free.mass_std_kg**2
    # the stated deviation is wider by Student's t
    assert 0.9 * variance < stated < 1.3 * variance
    assert steady.budget["drift"] == pytest.approx(stated / steady.mass_std_kg**2, rel=0.1)


def by_lever(table_of, bare_nm, loaded_nm, direction):
    """Joint torque of J2 at levers of 1 m, three poses under each load; `direction` by load."""
    torque = np.full((6, 6), np.nan)
    torque[:, 1] = [*bare_nm, *loaded_nm]
    facing = np.repeat(np.array(direction), 3)[:, None] * np.ones((1, 6))
    labels, number, lever = ["none"] * 3 + ["tool"] * 3, [0, 1, 2] * 2, {"x_k": np.ones(6)}
    return table_of(labels, number, np.zeros((6, 6)), torque, direction=facing, extra=lever)


def test_the_coefficient_method_has_the_change_of_gain_on_the_torque_of_the_whole_arm(table_of):
    """400 Nm bare and 480 Nm loaded: sqrt(400^2 + 480^2) * 0.5 % / g = 0.319 kg, beside a scatter of 0.01 kg."""
    options = Knowledge(link_std=np.inf, gain_std=(0.0,) * 6)
    table = by_lever(table_of, [400.0] * 3, [480.0, 480.1, 479.9], (1, 1))
    (load,) = estimate(table, None, options, "coefficient", coefficient=Coefficient(2, "x_k", 100, 1.0)).loads
    expected = np.hypot(*CHANGE) * np.hypot(400.0, 480.0) / G_M_S2
    assert load.mass_kg == pytest.approx(80.0 / G_M_S2)
    assert load.mass_std_kg == pytest.approx(expected, rel=0.01)


def test_the_coefficient_method_subtracts_torques_of_one_direction(table_of):
    how = Coefficient(2, "x_k", 100, 1.0)
    opposite = by_lever(table_of, [400.0] * 3, [400.0] * 3, (1, -1))
    with pytest.raises(DataUnusable, match="opposite"):
        estimate(opposite, None, Knowledge(), "coefficient", coefficient=how)
    unknown = by_lever(table_of, [400.0] * 3, [480.0] * 3, (0, 0))
    found = estimate(unknown, None, Knowledge(), "coefficient", coefficient=how)
    assert any("friction is not separated" in each.what for each in found.findings)
    assert found.loads[0].mass_std_kg > 2.0
    both = by_lever(table_of, [440.0] * 3, [520.0] * 3, (1, 1))
    down = by_lever(table_of, [360.0] * 3, [0.0] * 3, (-1, -1))
    both = concatenate([both, down.take(down.load == "none")])
    (load,) = estimate(both, None, Knowledge(), "coefficient", coefficient=how).loads
    assert load.mass_kg == pytest.approx(80.0 / G_M_S2)
