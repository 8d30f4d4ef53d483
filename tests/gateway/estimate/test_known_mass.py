"""A load whose mass is known and whose centre is not: what it says of the torque constants, and of other loads."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.diagnose import diagnose
from gateway.errors import InputError
from gateway.estimate import Coefficient, run
from gateway.identify.knowledge import Knowledge

WEIGHT, TOOL = (10.0, 0.05, -0.02, 0.08), (8.0, 0.12, -0.03, 0.05)
GAIN = np.array([0.0, 0.06, -0.05, 0.04, -0.06, 0.05])


@pytest.fixture(scope="module")
def table(arm, poses, measured):
    """The unloaded arm, a weight and a tool, read by drives whose constants are off by 4 to 6 %."""
    noise = np.random.default_rng(5)
    made = measured(arm, poses, {"none": None, "weight": WEIGHT, "tool": TOOL}, noise, left=0.01)
    return replace(made, tau_nm=made.tau_nm * (1.0 + GAIN))


def test_the_mass_alone_gives_the_torque_constants_and_the_other_load(table, arm):
    stated = Knowledge(link_std=np.inf, gain_std=(0.05,) * 6, change=0.05)
    plain = run(table, arm.robot, stated)
    result = run(table, arm.robot, replace(stated, masses={"weight": WEIGHT[0]}))
    gain = result.nuisance["gain"]
    off = (np.array(gain.value) - GAIN)[1:]
    assert (np.abs(off) < 4 * np.array(gain.std)[1:]).all()
    assert max(gain.std[1:4]) < 0.015, "a known mass determines axes 2 to 4 but for what changes between runs"
    loads = {load.label: load for load in result.loads}
    before = {load.label: load for load in plain.loads}
    assert loads["tool"].mass_std_kg < 0.5 * before["tool"].mass_std_kg
    assert abs(loads["tool"].mass_kg - TOOL[0]) < 4 * loads["tool"].mass_std_kg
    assert loads["weight"].mass_kg == pytest.approx(WEIGHT[0], rel=1e-3)
    assert [sum("weight's mass" in entry.what for entry in found.next) for found in (plain, result)] == [1, 0]
    for value, std, truth in zip(loads["weight"].com_m, loads["weight"].com_std_m, WEIGHT[1:], strict=True):
        assert abs(value - truth) < 4 * std


@pytest.mark.slow
def test_every_method_and_the_diagnosis_take_it(table, arm):
    options = Knowledge(link_std=np.inf, masses={"weight": WEIGHT[0]}, gain_std=(0.05,) * 6)
    for method in ("difference", "posture"):
        loads = {load.label: load for load in run(table, arm.robot, options, method).loads}
        assert loads["weight"].mass_kg == pytest.approx(WEIGHT[0], rel=1e-3), method
        assert abs(loads["tool"].mass_kg - TOOL[0]) < 4 * loads["tool"].mass_std_kg, method
    found = diagnose(table, arm.robot, Knowledge(masses={"weight": WEIGHT[0]}, gain_std=(0.05,) * 6))
    loads = {load.label: load for load in found.loads}
    assert loads["weight"].mass_kg == pytest.approx(WEIGHT[0], rel=1e-3)
    assert abs(loads["tool"].mass_kg - TOOL[0]) < 4 * loads["tool"].mass_std_kg


def test_one_axis_with_a_lever_takes_it(table, arm):
    levers = {"tool": 0.5, "weight": 0.4, "none": 0.4}
    lever = np.array([levers[label] for label in table.load.tolist()])
    torque = np.array([{"none": 0.0, "weight": WEIGHT[0]}.get(label, TOOL[0]) for label in table.load.tolist()])
    tau = np.array(table.tau_nm)
    tau[:, 1] = 9.81 * torque * lever
    made = replace(table, tau_nm=tau, extra={"x_k_m": lever}).take(table.load != "none")
    how = Coefficient(2, "x_k_m", 100.0, 1.0)
    result = run(made, None, Knowledge(link_std=np.inf, masses={"weight": WEIGHT[0]}), "coefficient", coefficient=how)
    assert [load.label for load in result.loads] == ["tool"]


def test_a_label_that_no_row_carries_is_refused(table, arm):
    for method in ("joint", "difference", "posture"):
        with pytest.raises(InputError, match="--known anvil: no row carries this load"):
            run(table, arm.robot, Knowledge(link_std=np.inf, masses={"anvil": 5.0}), method)
    with pytest.raises(InputError, match="--known anvil: no row carries this load"):
        diagnose(table, arm.robot, Knowledge(masses={"anvil": 5.0}))


def test_rows_in_motion_need_the_centre(table, arm):
    moving = replace(table, moving=np.ones(len(table.load), dtype=bool))
    for call in (
        lambda: run(moving, arm.robot, Knowledge(link_std=np.inf, masses={"weight": 10.0})),
        lambda: diagnose(moving, arm.robot, Knowledge(masses={"weight": 10.0})),
    ):
        with pytest.raises(InputError, match="state weight=10,X,Y,Z"):
            call()
