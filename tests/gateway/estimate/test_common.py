"""Checks that every estimator of rest rows has to pass."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from gateway.errors import ConfigError, DataUnusable, GatewayError, InputError
from gateway.estimate import estimate, run
from gateway.identify.knowledge import Knowledge
from gateway.result.result import from_json, to_json
from tests.gateway.estimate.conftest import assert_same, value_of

TOOL = (8.0, 0.12, -0.03, 0.05)
METHODS = ("joint", "difference", "posture")


def tool_of(found, label="tool"):
    return value_of(next(load for load in found.loads if load.label == label))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("link_std", [np.inf, 0.05, 0.0])
def test_exact_without_noise(arm, poses, measured, method, link_std):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    found = estimate(table, arm.robot, Knowledge(link_std=link_std), method)
    assert_same(tool_of(found), TOOL)
    assert found.loads[0].unidentifiable == ()
    np.testing.assert_allclose(found.rows.rms_nm, 0, atol=2e-4)


@pytest.mark.parametrize("method", METHODS)
def test_gravity_from_the_wall_and_gear_efficiency(arm, poses, measured, method, band_nm):
    gravity, eta = (9.80665, 0.0, 0.0), np.array([0.8, 0.75, 0.9, 0.85, 0.8, 0.7])
    table = measured(arm, poses, {"none": None, "tool": TOOL}, gravity=gravity, efficiency=eta)
    options = Knowledge(link_std=np.inf, gravity_m_s2=gravity, efficiency=tuple(eta))
    found = estimate(table, arm.robot, options, method)
    assert_same(tool_of(found), TOOL)
    np.testing.assert_allclose(found.band_nm, band_nm, rtol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_the_rows_does_not_matter(arm, poses, measured, method):
    table = measured(arm, poses, {"none": None, "tool": TOOL}, np.random.default_rng(0), left=0.1)
    mixed = table.take(np.random.default_rng(1).permutation(len(table)))
    one, two = (tool_of(estimate(part, arm.robot, Knowledge(link_std=np.inf), method)) for part in (table, mixed))
    np.testing.assert_allclose(one[0], two[0], rtol=1e-6)
    np.testing.assert_allclose(one[1], two[1], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_intervals_hold_the_truth(arm, poses, measured, method):
    """30 tables of a scattered friction band, four numbers each."""
    rng = np.random.default_rng(2)
    inside = []
    for _ in range(30):
        table = measured(arm, poses[:8], {"none": None, "tool": TOOL}, rng, left=0.15)
        value, std = tool_of(estimate(table, arm.robot, Knowledge(link_std=np.inf), method))
        inside.append(np.abs(value - TOOL) < 1.96 * std)
    # of the errors of gains and biases that the intervals allow for these tables have none
    assert np.mean(inside) > 0.88


@pytest.mark.parametrize("method", METHODS)
def test_a_known_first_load_replaces_the_unloaded_arm(arm, poses, measured, method):
    first = (3.0, 0.05, 0.02, -0.04)
    table = measured(arm, poses, {"first": first, "tool": TOOL})
    options = Knowledge(link_std=0.0 if method == "posture" else np.inf, known={"first": first})
    found = estimate(table, arm.robot, options, method)
    assert [load.label for load in found.loads] == ["tool"]
    assert_same(tool_of(found), TOOL)


@pytest.mark.parametrize("method", METHODS)
def test_several_loads_at_once(arm, poses, measured, method):
    other = (2.0, 0.0, 0.1, 0.02)
    table = measured(arm, poses, {"none": None, "a": TOOL, "b": other})
    found = estimate(table, arm.robot, Knowledge(link_std=np.inf), method)
    assert_same(tool_of(found, "a"), TOOL)
    assert_same(tool_of(found, "b"), other)


@pytest.mark.parametrize("method", METHODS)
def test_one_posture_is_refused_with_the_reason(arm, poses, measured, method):
    table = measured(arm, poses[:1], {"none": None, "tool": TOOL})
    with pytest.raises(DataUnusable, match=r"one posture.*rank 3"):
        estimate(table, arm.robot, Knowledge(link_std=np.inf), method)


@pytest.mark.parametrize("method", METHODS)
def test_a_known_load_that_is_not_there_is_refused(arm, poses, measured, method):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    with pytest.raises(InputError, match=r"--known other"):
        estimate(table, arm.robot, Knowledge(link_std=np.inf, known={"other": TOOL}), method)


@pytest.mark.parametrize("method", METHODS)
def test_wrist_axes_alone_leave_the_mass_open(arm, poses, measured, method):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    tau = table.tau_nm.copy()
    tau[:, :3] = np.nan
    found = estimate(replace(table, tau_nm=tau), arm.robot, Knowledge(link_std=0.05), method)
    load = found.loads[0]
    assert np.isnan(load.mass_kg)
    assert "mass_kg" in load.unidentifiable
    said = run(replace(table, tau_nm=tau), arm.robot, Knowledge(link_std=0.05), method)
    assert any("J1, J2, J3" in finding.where for finding in said.findings)
    assert said.after.rms_nm[0] != said.after.rms_nm[0]


@pytest.mark.parametrize("method", METHODS)
def test_one_orientation_of_the_flange_leaves_the_height_open_or_is_refused(arm, measured, method):
    """Axis 1 turns, axes 2 and 3 cancel: link 6 keeps its attitude to gravity, its x axis level."""
    turn = np.linspace(-0.5, 0.5, 8)
    q = np.column_stack([np.linspace(-1, 1, 8), turn, -turn, np.zeros(8), np.zeros(8), np.zeros(8)])
    table = measured(arm, q, {"none": None, "tool": TOOL})
    if method == "difference":
        with pytest.raises(DataUnusable, match="one side of the flange"):
            estimate(table, arm.robot, Knowledge(link_std=np.inf), method)
        return
    found = estimate(table, arm.robot, Knowledge(link_std=0.0), method)
    load = found.loads[0]
    assert load.unidentifiable == ("com_z_m",)
    np.testing.assert_allclose([load.mass_kg, load.com_m[0]], TOOL[:2], rtol=2e-2)
    # the torque of J4 is inside its friction band, where a gear may hold a part of it
    assert abs(load.com_m[1] - TOOL[2]) < min(0.1 * abs(TOOL[2]), 2.0 * load.com_std_m[1])
    assert np.isnan(load.com_m[2])


@pytest.mark.parametrize("method", METHODS)
def test_result_file_round_trip(arm, poses, measured, method):
    table = measured(arm, poses, {"none": None, "tool": TOOL}, np.random.default_rng(0), left=0.1)
    result = run(table, arm.robot, Knowledge(link_std=np.inf), method, {"data": ["made.csv"]})
    again = from_json(to_json(result))
    assert to_json(again) == to_json(result)
    load = again.loads[0]
    assert abs(load.mass_kg - TOOL[0]) < 5 * load.mass_std_kg
    assert again.after.loads == again.loads == again.before.loads
    assert len(again.rows.tau_nm) == len(again.rows.load)
    assert again.provenance == {"data": ["made.csv"]}
    assert load.correlation[0][0] == 1.0
    assert not again.failed


def test_an_unknown_method_or_no_robot(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    with pytest.raises(ConfigError, match="--method guess"):
        estimate(table, arm.robot, Knowledge(link_std=np.inf), "guess")
    with pytest.raises(ConfigError, match="robot model"):
        estimate(table, None, Knowledge(link_std=np.inf), "joint")


@pytest.mark.parametrize("method", METHODS)
def test_no_rest_rows(arm, poses, measured, method):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    empty = table.take(np.zeros(len(table), dtype=bool))
    with pytest.raises(DataUnusable):
        estimate(empty, arm.robot, Knowledge(link_std=np.inf), method)


def broken(table, rng):
    """The same table with axes, rows, sides or noise missing, as data are that come from elsewhere."""
    tau, std, side = table.tau_nm.copy(), table.tau_std_nm.copy(), table.direction.copy()
    if rng.random() < 0.3:
        tau[:, rng.integers(0, 6, 3)] = np.nan
    if rng.random() < 0.2:
        tau[rng.random(tau.shape) < 0.3] = np.nan
    tau *= rng.choice([1.0, 0.0, 1e6, 1e-6], p=[0.7, 0.1, 0.1, 0.1])
    if rng.random() < 0.4:
        std[rng.random(std.shape) < rng.choice([0.5, 1.0])] = rng.choice([0.0, 0.3, 5.0])
    if rng.random() < 0.3:
        side[:, rng.integers(0, 6, 2)] = 0
    keep = rng.random(len(table)) < rng.choice([0.6, 1.0])
    return replace(table, tau_nm=tau, tau_std_nm=std, direction=side).take(keep)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_whatever_the_rows_are_a_result_or_a_typed_error_comes_out(arm, measured, method):
    rng = np.random.default_rng(0)
    for _ in range(25):
        q = rng.uniform(-2, 2, (rng.integers(1, 10), 6))
        q[:, rng.integers(0, 6, rng.integers(0, 5))] = 0.0
        loads = {"none": None, "tool": (rng.choice([0.0, 0.5, 50.0]), *(0.2 * rng.normal(size=3)))}
        sides = [(1, -1), (1,), (-1,)][rng.integers(3)]
        table = broken(measured(arm, q, loads, rng, left=rng.choice([0.0, 0.1, 1.0]), sides=sides), rng)
        options = Knowledge(link_std=float(rng.choice([np.inf, 0.0, 0.05])))
        with contextlib.suppress(GatewayError):
            result = run(table, arm.robot, options, method)
            assert to_json(from_json(to_json(result))) == to_json(result)
            for load in result.loads:
                assert np.isfinite(load.mass_kg) == np.isfinite(load.mass_std_kg)
                assert np.isfinite(load.mass_kg) != ("mass_kg" in load.unidentifiable)
