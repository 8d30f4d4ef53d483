"""Moving runs: pinocchio's dynamics come back, and the measured runs give the figures published with them."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.data.table import read_csv
from gateway.errors import DataUnusable, InputError
from gateway.estimate import estimate, run
from gateway.estimate.moving_estimate import estimate_moving
from gateway.identify.knowledge import Knowledge, WeighedLoad
from gateway.identify.model_conflict import motion_conflict
from gateway.identify.motion.columns import MovingSetup
from gateway.model.robot import robot_from_urdf
from tests.data.arms import sines, torque_of
from tests.data.moving_arm import World, measured, several

COULOMB = np.array([20.0, 25.0, 15.0, 4.0, 3.0, 2.0])
VISCOUS = np.array([10.0, 12.0, 8.0, 2.0, 1.5, 1.0])
ROTOR = np.array([8.0, 8.0, 5.0, 1.0, 0.6, 0.3])
OFFSET = np.array([3.0, -2.0, 1.0, 0.5, 0.2, -0.1])
TOOL = (8.0, 0.12, -0.03, 0.05)


def motion_of(seed, n=400, rate_hz=50.0):
    """Positions, velocities and accelerations of a sum of sines."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / rate_hz
    wave = 2 * np.pi * rng.uniform(0.2, 0.7, (3, 6))
    size, phase = rng.uniform(0.2, 0.6, (3, 6)), rng.uniform(0, 6, (3, 6))
    return time, *sines(time, size, wave, phase)


def moving_table(arm, table_of, label="none", load=None, seed=0, noise=0.0, inertia=((0.0,) * 3,) * 3):
    time, q, qd, qdd = motion_of(seed)
    tau = torque_of(arm.model(load, inertia=inertia), q, qd, qdd)
    tau += COULOMB * np.tanh(qd / 0.02) + VISCOUS * qd + ROTOR * qdd + OFFSET * (load is None)
    tau += noise * np.random.default_rng(seed + 100).normal(size=tau.shape)
    n = len(time)
    return table_of([label] * n, [-1] * n, q, tau, qd=qd, qdd=qdd, time=time, run=[f"{label}{seed}"] * n)


def friction(found, name):
    return [value for key, value in zip(found.names, found.value, strict=True) if key.startswith(name)]


@pytest.mark.parametrize("link_std", [np.inf, 0.0, 0.05])
def test_friction_and_residual_of_a_bare_run(arm, table_of, link_std):
    found = estimate(moving_table(arm, table_of), arm.robot, Knowledge(link_std=link_std))
    np.testing.assert_allclose(friction(found, "coulomb"), COULOMB, rtol=1e-3)
    np.testing.assert_allclose(friction(found, "viscous"), VISCOUS, rtol=1e-3)
    if link_std == 0.0:  # else the rotor inertia of axis 1 lumps with the links
        np.testing.assert_allclose(friction(found, "rotor_inertia"), ROTOR, rtol=1e-3)
        np.testing.assert_allclose(friction(found, "offset"), OFFSET, atol=1e-3)
    np.testing.assert_allclose(found.rows.rms_nm, 0, atol=1e-2)
    assert np.isnan(found.sigma_nm).all()  # one run determines no noise floor


def test_load_from_bare_and_loaded_run(arm, table_of):
    table = concatenate(
        [moving_table(arm, table_of, noise=0.5), moving_table(arm, table_of, "tool", TOOL, seed=1, noise=0.5)]
    )
    load = estimate(table, arm.robot, Knowledge(link_std=0.05)).loads[0]
    assert load.mass_kg == pytest.approx(TOOL[0], rel=0.06)
    np.testing.assert_allclose(load.com_m, TOOL[1:], atol=0.03)


def test_load_with_known_links_and_a_known_load(arm, table_of):
    point = (5.0, 0.1, 0.0, 0.0)
    table = moving_table(arm, table_of, "tool", point, noise=0.1)
    options = Knowledge(link_std=0.0, known={"tool": point})
    assert (estimate(table, arm.robot, options).rows.rms_nm < 0.2).all()
    with pytest.raises(InputError, match="--known other"):
        estimate(table, arm.robot, Knowledge(link_std=np.inf, known={"other": point}))


@pytest.mark.parametrize("com_m", [None, (0.1, 0.0, 0.02)])
def test_a_weighed_load_tells_what_the_constants_have_in_common(arm, table_of, com_m):
    """All torques are 5 % too large; without the weight the other load is that much too heavy."""
    loads = {"none": None, "weight": (20.0, 0.1, 0.0, 0.02), "tool": TOOL}
    runs = [moving_table(arm, table_of, name, load, seed=k, noise=0.2) for k, (name, load) in enumerate(loads.items())]
    table = concatenate(runs)
    table = replace(table, tau_nm=1.05 * table.tau_nm)
    stated = Knowledge(link_std=np.inf, gain_std=(0.05,) * 6, change=0.05)
    weighed = {"weight": WeighedLoad(20.0, 0.02, com_m, 0.001)}
    before, after = (
        {load.label: load for load in run(table, arm.robot, knowledge).loads}
        for knowledge in (stated, replace(stated, weighed=weighed))
    )
    assert after["weight"].mass_kg == pytest.approx(20.0, abs=0.08)
    assert after["tool"].mass_std_kg < 0.5 * before["tool"].mass_std_kg
    assert abs(after["tool"].mass_kg - TOOL[0]) < 4 * after["tool"].mass_std_kg
    with pytest.raises(InputError, match="--known other"):
        run(table, arm.robot, Knowledge(weighed={"other": WeighedLoad(5.0)}))


def test_a_loaded_run_alone_lumps_with_link_6(arm, table_of):
    result = run(moving_table(arm, table_of, "tool", TOOL), arm.robot, Knowledge(link_std=np.inf))
    assert np.isnan(result.loads[0].mass_kg)
    assert len(result.loads[0].unidentifiable) == 5
    assert any("cannot be separated from link 6" in finding.what for finding in result.findings)
    assert np.isfinite(result.after.rms_nm).all()


def test_slow_rows_are_left_out_by_the_speed_limit(arm, table_of):
    table = moving_table(arm, table_of)
    found = estimate_moving(table, arm.robot, Knowledge(link_std=np.inf), MovingSetup(slow_share=0.1))
    slow = np.abs(table.qd_rad_s) < 0.1 * arm.robot.velocity_rad_s
    assert slow.any()
    np.testing.assert_array_equal(np.isnan(found.rows.tau_nm), slow)


def test_too_short_a_run(arm, table_of):
    with pytest.raises(DataUnusable, match="fewer than"):
        estimate(moving_table(arm, table_of).take(np.arange(5)), arm.robot, Knowledge(link_std=np.inf))
    with pytest.raises(DataUnusable, match="no moving rows"):
        estimate_moving(moving_table(arm, table_of).take(np.zeros(400, dtype=bool)), arm.robot, Knowledge())


def measured_run(folder, name, file):
    text = (folder / name / "robot.urdf").read_text()
    return read_csv(folder / name / file, None), robot_from_urdf(text, name)


LOADS = {"none": None, "again": None, "a": (2.0, 0.02, -0.01, 0.08), "b": (5.0, -0.03, 0.02, 0.1)}
LOADS |= {"c": (8.0, 0.05, 0.0, 0.12), "d": (3.0, 0.0, 0.06, 0.05)}


@pytest.mark.slow
def test_intervals_of_four_loads_hold_the_truth_with_gains_and_losses_as_every_arm_has_them():
    """Gains off by 3 %, losses of 5 %, noise that is autocorrelated over 0.1 s; white noise and no gains: a quarter."""
    off = []
    for seed in range(6):
        table, robot = several(seed, LOADS)
        for load in run(table, robot, Knowledge(link_std=0.05)).loads:
            mass, *com = LOADS[load.label]
            off.append((load.mass_kg - mass) / load.mass_std_kg)
            off += [(value - true) / std for value, true, std in zip(load.com_m, com, load.com_std_m, strict=True)]
            assert load.mass_std_kg < 0.03 * mass
            assert sum(load.budget.values()) == pytest.approx(1.0)
            assert load.budget["constants"] > 0.1
    assert np.mean(np.abs(off) < 1.96) > 0.88


def test_a_gain_beyond_its_usual_range_is_not_taken_for_one():
    """A balancer that the model lacks looks like gravity of the other sign: the gain has a limit."""
    table, robot, _ = measured(1, World(coil=(20_000.0, 0.2, 0.7, 0.4)))
    gain = estimate(table, robot, Knowledge(link_std=0.01)).nuisance["gain"]
    assert np.abs(gain.value).max() < 0.065
    free = estimate(table, robot, Knowledge(link_std=0.01, gain_std=(0.001,) * 6)).nuisance["gain"]
    assert np.abs(free.value).max() < 0.02


def test_the_stated_torque_constants_decide_the_uncertainty_of_a_mass():
    table, robot = several(2, {"none": None, "b": LOADS["b"]})
    certain, unsure = (run(table, robot, Knowledge(link_std=0.05, gain_std=(std,) * 6)).loads[0] for std in (0.0, 0.03))
    assert unsure.mass_std_kg > 1.2 * certain.mass_std_kg
    assert unsure.budget["constants"] > certain.budget["constants"]


@pytest.mark.data
def test_measured_run_of_a_tx40(measured_data):
    """Published with the data: base parameters and friction, slow rows left out."""
    table, robot = measured_run(measured_data, "tx40", "run_1_first.csv")
    found = estimate_moving(table, robot, Knowledge(link_std=np.inf), MovingSetup(nuisances=()))
    np.testing.assert_allclose(found.rows.rms_nm, [1.49, 1.47, 0.96, 0.42, 4.12, 1.41], atol=0.006)
    assert found.rank == 36 + 24 - 2  # the rotors of axes 1 and 2 lump with the links they turn


@pytest.mark.data
def test_measured_run_of_a_ur10(measured_data):
    table, robot = measured_run(measured_data, "ur10", "run_1_first.csv")
    found = estimate_moving(table, robot, Knowledge(link_std=np.inf), MovingSetup(slow_share=0.0, nuisances=()))
    np.testing.assert_allclose(found.rows.rms_nm, [2.87, 1.88, 1.71, 0.37, 0.34, 1.36], atol=0.006)
    assert (estimate(table, robot, Knowledge(link_std=np.inf)).rows.rms_nm <= found.rows.rms_nm).all()


@pytest.mark.data
def test_measured_run_of_a_kr300(measured_data):
    """CAD links fixed, no offset, equal weights first and three times the residual's: the published figures."""
    table, robot = measured_run(measured_data, "kr300", "run_A.csv")
    motion = MovingSetup(smooth_rad_s=0.01, slow_share=0.0, passes=4, nuisances=())
    found = estimate_moving(table, robot, Knowledge(link_std=0.0), motion)
    np.testing.assert_allclose(found.rows.rms_nm, [236, 907, 1449, 58, 44, 41], rtol=0.01)
    load = found.loads[0]
    assert load.mass_kg == pytest.approx(27, abs=0.5)
    assert load.com_m[2] + 0.24 == pytest.approx(-1.55, abs=0.01)  # before the flange, which is at z = -0.24 m
    assert load.mass_std_kg > 10  # and the interval says how little that means
    said = run(table, robot, Knowledge(link_std=0.0)).findings
    assert any("diagnose" in finding.advice for finding in said)


#: Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of gravity [kg m2], of a body: a plate, turned.
INERTIA = np.array([0.11, 0.08, 0.15, 0.01, -0.02, 0.015])


def test_all_ten_parameters_of_a_load_come_back_without_noise(arm, table_of):
    tensor = INERTIA[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    bare, loaded = moving_table(arm, table_of), moving_table(arm, table_of, "tool", TOOL, seed=1, inertia=tensor)
    bare = replace(bare, tau_nm=bare.tau_nm - OFFSET)
    options = Knowledge(link_std=np.inf, gain_std=(0.0,) * 6)
    load = run(concatenate([bare, loaded]), arm.robot, options).loads[0]
    assert load.mass_kg == pytest.approx(TOOL[0], rel=1e-4)
    np.testing.assert_allclose(load.com_m, TOOL[1:], atol=1e-4)
    np.testing.assert_allclose(load.inertia_kg_m2, INERTIA, atol=2e-3)
    assert load.unidentifiable == ()
    assert all(std < 0.01 for std in load.inertia_std_kg_m2)


@pytest.fixture(scope="module", params=["alone", "beside rest visits"])
def run_and_loaded_run(request, arm, poses, measured, table_of):
    """A moving run of the unloaded arm and one with a load, alone or with rest visits of both."""
    table = [moving_table(arm, table_of, noise=3.0), moving_table(arm, table_of, "tool", TOOL, seed=1, noise=3.0)]
    if request.param == "beside rest visits":
        table.append(measured(arm, poses, {"none": None, "tool": TOOL}, np.random.default_rng(2), left=0.05))
    return concatenate(table)


@pytest.mark.parametrize("link_std", [0.05, 0.0])
@pytest.mark.parametrize(("factor", "warned"), [(1.0, False), (0.8, True)])
def test_link_masses_that_a_motion_contradicts_are_named_and_not_used(
    arm, run_and_loaded_run, link_std, factor, warned
):
    table = run_and_loaded_run
    robot = replace(arm.robot, mass_kg=factor * arm.robot.mass_kg, inertia_kg_m2=factor * arm.robot.inertia_kg_m2)
    found = estimate(table, robot, Knowledge(link_std=link_std))
    conflicts = [finding for finding in found.findings if finding.check == "link_masses"]
    assert [finding.severity for finding in conflicts] == ["warn"] * warned
    assert abs(found.loads[0].mass_kg - TOOL[0]) < 3 * found.loads[0].mass_std_kg


def test_a_motion_that_contradicts_the_robot_model_grossly_gives_no_load(arm, run_and_loaded_run):
    robot = replace(arm.robot, mass_kg=3.0 * arm.robot.mass_kg, inertia_kg_m2=3.0 * arm.robot.inertia_kg_m2)
    found = estimate(run_and_loaded_run, robot, Knowledge(link_std=0.05))
    assert found.loads[0].refused in {finding.what for finding in found.findings if finding.check == "torque_constants"}


@pytest.mark.parametrize("factor", [0.1, 4.0])
def test_one_axis_that_is_off_is_no_factor_of_all(factor):
    torque_nm = np.ones((50, 6))
    one_off_nm = torque_nm * np.array([factor, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert motion_conflict(torque_nm, one_off_nm, np.zeros(6)) is None
    found = motion_conflict(torque_nm, 4.0 * torque_nm, np.zeros(6))
    assert found is not None
    assert found.check == "torque_constants"


def test_a_placeholder_inertia_of_a_link_is_named_and_not_used(arm, table_of):
    """20 kg m2 on the last link of 1 kg would be a radius of gyration of 4.5 m."""
    last = 'ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"'
    assert last in arm.text
    exported = replace(arm, text=arm.text.replace(last, re.sub("0.025?|0.03", "20", last)))
    parts = [("none", None, 0), ("tool", TOOL, 1)]
    table = concatenate([moving_table(arm, table_of, label, load, seed, noise=0.5) for label, load, seed in parts])
    found = estimate(table, exported.robot, Knowledge(link_std=0.05))
    assert [each.where for each in found.findings if each.check == "link_inertia_placeholder"] == ["link_6"]
    (load,) = found.loads
    assert (np.abs(load.com_m - TOOL[1:]) < 2.5 * load.com_std_m).all()
    assert abs(load.mass_kg - TOOL[0]) < 2.5 * load.mass_std_kg
