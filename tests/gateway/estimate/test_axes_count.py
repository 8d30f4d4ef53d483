"""Loads on arms of four and of seven axes, by every method; the torques are pinocchio's."""

import numpy as np
import pytest

from gateway.data.table import read_data, write_csv
from gateway.errors import DataUnusable
from gateway.estimate import estimate, run
from gateway.identify.knowledge import Knowledge
from gateway.result.result import from_json, to_json
from tests.cells import CELLS
from tests.data.arms import sines, torque_of
from tests.gateway.estimate.conftest import Arm, assert_same, value_of
from tests.support.rigs.tables import make_table

METHODS = ("joint", "difference", "posture")
LOAD = (3.0, 0.05, -0.03, 0.06)


@pytest.fixture(params=CELLS, ids=lambda cell: cell.name)
def arm(request):
    cell = request.param
    return Arm(cell.urdf, 0.04 * cell.robot.effort_nm)


def postures(arm, count=12):
    robot = arm.robot
    return np.random.default_rng(3).uniform(0.8 * robot.lower_rad, 0.8 * robot.upper_rad, (count, robot.axes))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("link_std", [np.inf, 0.05, 0.0])
def test_exact_without_noise(arm, measured, method, link_std):
    table = measured(arm, postures(arm), {"none": None, "tool": LOAD})
    found = estimate(table, arm.robot, Knowledge(link_std=link_std), method)
    assert_same(value_of(found.loads[0]), LOAD)
    assert found.loads[0].unidentifiable == ()
    assert found.rows.rms_nm.shape == (arm.robot.axes,)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_intervals_hold_the_truth(arm, measured, method):
    rng, inside = np.random.default_rng(5), []
    for _ in range(20):
        table = measured(arm, postures(arm, 8), {"none": None, "tool": LOAD}, rng, left=0.15)
        value, std = value_of(estimate(table, arm.robot, Knowledge(link_std=np.inf), method).loads[0])
        inside.append(np.abs(value - LOAD) < 1.96 * std)
    assert 0.86 < np.mean(inside) <= 1.0


def test_a_table_and_a_result_of_that_many_axes_come_back(arm, measured, tmp_path):
    axes = arm.robot.axes
    table = measured(arm, postures(arm), {"none": None, "tool": LOAD})
    write_csv(table, tmp_path / "run.csv")
    read = read_data([tmp_path / "run.csv"], (), None)
    assert read.axes == axes
    np.testing.assert_array_equal(read.q_rad, table.q_rad)
    result = run(read, arm.robot, Knowledge(link_std=np.inf))
    again = from_json(to_json(result))
    assert again.loads[0].frame == f"link_{axes}"
    lists = (again.after.rms_nm, again.after.holdout_rms_nm, again.noise_floor_nm, again.friction_band_nm)
    assert {len(values) for values in lists} == {axes}
    assert len(again.next[0].poses_rad[0]) == axes
    assert len(again.bare.combination[0]) == 4 * axes
    stored = Knowledge(link_std=np.inf, bare=again.bare)
    loaded = read.take(read.load == "tool")
    found = estimate(loaded, arm.robot, stored, "posture").loads[0]
    np.testing.assert_allclose(value_of(found)[0], LOAD, rtol=1e-3, atol=1e-4)


def test_a_moving_run_gives_the_load(arm):
    robot = arm.robot
    time = np.linspace(0.0, 20.0, 1500)
    size, rate = 0.5 * np.minimum(robot.upper_rad, 1.5), np.linspace(0.7, 1.9, robot.axes)[None]
    q, qd, qdd = sines(time, size, rate, np.arange(robot.axes))
    tau = [torque_of(arm.model(load), q, qd, qdd) + 5.0 * np.tanh(qd / 0.02) + 2.0 * qd for load in (None, LOAD)]
    table = make_table(
        ["none"] * 1500 + ["tool"] * 1500, np.full(3000, -1), np.tile(q, (2, 1)), np.concatenate(tau),
        time=np.tile(time, 2), qd=np.tile(qd, (2, 1)), qdd=np.tile(qdd, (2, 1)),
        run=["a"] * 1500 + ["b"] * 1500,
    )  # fmt: skip
    found = estimate(table, robot, Knowledge(link_std=np.inf), "joint")
    assert found.method == "moving"
    np.testing.assert_allclose(value_of(found.loads[0])[0], LOAD, rtol=2e-3, atol=2e-3)
    assert found.band_nm.shape == (robot.axes,)


def test_what_the_arm_cannot_determine_is_reported(arm, measured):
    """Postures that differ by the turn of the first axis alone give rank 3."""
    q = np.repeat(postures(arm, 1), 3, axis=0)
    q[:, 0] = (-1.0, 0.0, 1.0)
    table = measured(arm, q, {"none": None, "tool": LOAD})
    first = max(2, arm.robot.axes - 2)
    with pytest.raises(DataUnusable, match=f"turn axes {first} to {arm.robot.axes}"):
        estimate(table, arm.robot, Knowledge(link_std=np.inf), "difference")
