"""A weighed load, with its uncertainty or without its centre: what it says of the constants and of other loads."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from gateway.diagnose import diagnose
from gateway.errors import InputError
from gateway.estimate import Coefficient, run
from gateway.identify.knowledge import Knowledge, WeighedLoad

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
    result = run(table, arm.robot, replace(stated, weighed={"weight": WeighedLoad(WEIGHT[0])}))
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
    options = Knowledge(link_std=np.inf, weighed={"weight": WeighedLoad(WEIGHT[0])}, gain_std=(0.05,) * 6)
    for method in ("difference", "posture"):
        loads = {load.label: load for load in run(table, arm.robot, options, method).loads}
        assert loads["weight"].mass_kg == pytest.approx(WEIGHT[0], rel=1e-3), method
        assert abs(loads["tool"].mass_kg - TOOL[0]) < 4 * loads["tool"].mass_std_kg, method
    found = diagnose(table, arm.robot, Knowledge(weighed={"weight": WeighedLoad(WEIGHT[0])}, gain_std=(0.05,) * 6))
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
    result = run(
        made,
        None,
        Knowledge(link_std=np.inf, weighed={"weight": WeighedLoad(WEIGHT[0])}),
        "coefficient",
        coefficient=how,
    )
    assert [load.label for load in result.loads] == ["tool"]


def test_a_label_that_no_row_carries_is_refused(table, arm):
    for method in ("joint", "difference", "posture"):
        with pytest.raises(InputError, match="--known anvil: no row carries this load"):
            run(table, arm.robot, Knowledge(link_std=np.inf, weighed={"anvil": WeighedLoad(5.0)}), method)
    with pytest.raises(InputError, match="--known anvil: no row carries this load"):
        diagnose(table, arm.robot, Knowledge(weighed={"anvil": WeighedLoad(5.0)}))


@pytest.mark.slow
def test_intervals_of_the_constants_hold_where_the_weight_was_measured_with_an_error(arm, poses, measured):
    """The weight is 20 g and 3 mm off what is stated, one standard deviation each; it narrows the intervals."""
    rng, axes, held, narrower = np.random.default_rng(8), np.array([1, 2, 3, 4]), 0, []
    cells = 20
    for _ in range(cells):
        gain = rng.normal(0.0, 0.03, 6)
        made = measured(arm, poses, {"none": None, "weight": WEIGHT}, rng, left=0.01)
        made = replace(made, tau_nm=made.tau_nm * (1.0 + gain))
        mass, centre = WEIGHT[0] + rng.normal(0.0, 0.02), np.array(WEIGHT[1:]) + rng.normal(0.0, 0.003, 3)
        load = WeighedLoad(mass, 0.02, (float(centre[0]), float(centre[1]), float(centre[2])), 0.003)
        free = Knowledge(link_std=np.inf, gain_std=(0.03,) * 6, change=0.05)
        found = run(made, arm.robot, replace(free, weighed={"weight": load})).nuisance["gain"]
        std = np.array(found.std)
        held += int((np.abs(np.array(found.value) - gain) < 1.96 * std)[axes].sum())
        if len(narrower) < 5:
            narrower.append(std[axes] / np.array(run(made, arm.robot, free).nuisance["gain"].std)[axes])
    assert held >= binom.ppf(0.001, cells * len(axes), 0.95)
    assert (np.mean(narrower, axis=0) < 0.6).all()


def test_the_lever_method_takes_a_mass_as_exact(table, arm):
    weighed = Knowledge(link_std=np.inf, weighed={"weight": WeighedLoad(10.0, 0.1)})
    how = Coefficient(2, "x_k_m", 100.0, 1.0)
    made = replace(table, extra={"x_k_m": np.ones(len(table))})
    with pytest.raises(InputError, match="leave"):
        run(made, None, weighed, "coefficient", coefficient=how)
