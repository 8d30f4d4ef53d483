"""Cells of moving loads: truth and oracle agree with each other, and figures say what the cells say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.moving.cells import MovingCell, draw_cell
from benchmarks.moving.excitations import USED, random_series
from benchmarks.moving.oracle import about_centre, oracle_std
from benchmarks.moving.scores import drawn_truth, load_truth, score
from benchmarks.moving.timing import plain_least_squares
from benchmarks.nature.levels import MILD
from benchmarks.nature.moving_arm import MovingArm, draw_moving_arm, moving_arm
from benchmarks.nature.moving_cell import PeriodicMotion
from gateway.estimate import run
from gateway.model.robot import robot_from_urdf
from sim.engine import Engine
from sim.urdf import read_chain


@dataclass(frozen=True)
class Few:
    """A cell of few samples."""

    arm: MovingArm
    motion: PeriodicMotion
    start_s: dict[str, float]
    link_std: float = 0.03


@pytest.fixture(scope="module")
def few() -> Few:
    rng = np.random.default_rng(8)
    arm, _ = draw_moving_arm(MILD, rng)
    series = random_series(arm, 8.0, 2, rng)
    return Few(arm, PeriodicMotion(series.at, 8.0, 2, 20.0, 10), {"none": 3000.0, "tool": 3200.0})


def test_a_drawn_series_keeps_every_limit_and_ends_at_rest():
    rng = np.random.default_rng(4)
    arm, _ = draw_moving_arm(MILD, rng)
    series = random_series(arm, 10.0, 2, rng)
    times = np.linspace(0.0, 10.0, 901)
    q, qd, qdd, _ = series.at(times)
    chain = arm.chain
    assert (q >= chain.lower_rad).all()
    assert (q <= chain.upper_rad).all()
    assert (np.abs(qd) <= chain.velocity_rad_s).all()
    with Engine([arm.carrying("tool")], arm.gravity_m_s2) as dynamics:
        torque = dynamics.torque_nm(q, qd, qdd) + arm.rotor_inertia_kg_m2 * qdd
    share = (np.abs(torque) / chain.effort_nm).max()
    assert 0.3 < share < (1.0 + USED) / 2.0
    for edge in (0, -1):
        np.testing.assert_allclose(q[edge], series.start_rad, atol=1e-9)
        np.testing.assert_allclose(qd[edge], 0.0, atol=1e-9)
        np.testing.assert_allclose(qdd[edge], 0.0, atol=1e-9)


def test_the_oracle_needs_four_times_the_periods_for_half_the_noise(few):
    """With no scatter of friction, four times the periods are half the noise: the same standard deviation."""
    even = replace(few.arm, friction=replace(few.arm.friction, tail_share=np.zeros(6)), resolution_nm=np.zeros(6))
    once = oracle_std(replace(few, arm=replace(even, noise_nm=0.5 * even.noise_nm)))
    often = oracle_std(replace(few, arm=even, motion=replace(few.motion, periods=8)))
    np.testing.assert_allclose(once["load"], often["load"], rtol=1e-6)
    noisy = oracle_std(replace(few, arm=even))
    assert (noisy["load"] > once["load"]).all()


def test_the_inertia_about_the_centre_comes_back(few):
    tool = few.arm.tool
    mass, com = tool.mass_kg, tool.com_m
    about = tool.inertia_kg_m2 + mass * (com @ com * np.eye(3) - np.outer(com, com))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = about
    parameters = np.array([mass, *(mass * com), xx, xy, yy, xz, yz, zz])
    np.testing.assert_allclose(about_centre(parameters), load_truth(few.arm.tool))


def test_rows_of_a_cell_are_bare_and_loaded_periods():
    cell = draw_cell(1, "stated", periods=2, rate_hz=20.0)
    table = cell.table()
    assert sorted(set(table.run)) == ["none", "tool"]
    assert table.moving.all()
    assert len(set(table.extra["x_excitation"])) == 1
    assert cell.knowledge.gain_std == tuple(cell.arm.gain_std)
    assert draw_cell(1, "known", periods=2).knowledge.gain_std == (0.0,) * 6
    assert draw_cell(1, "ratios", periods=2).knowledge.gain_std is None


def test_plain_least_squares_finds_the_load_of_a_quiet_run():
    cell = draw_cell(5, "known", periods=2, rate_hz=20.0)
    found, _ = plain_least_squares(cell.stated.urdf, cell.stated.link_std, cell.table())
    tool = cell.arm.tool
    np.testing.assert_allclose(found[60], tool.mass_kg, rtol=0.02)
    np.testing.assert_allclose(found[61:64], tool.mass_kg * tool.com_m, atol=0.005 * tool.mass_kg)


def test_an_arm_of_seven_axes_follows_the_same_path():
    text = Path("tests/cells/seven/robot.urdf").read_text(encoding="utf-8")
    rng = np.random.default_rng(2)
    arm, stated = moving_arm(read_chain(text, "seven"), 5.0, MILD, rng)
    arm = replace(arm, gain=np.zeros(7), friction=replace(arm.friction, declared_efficiency=np.ones(7)))
    series = random_series(arm, 10.0, 2, rng)
    start_s = {"none": 3000.0, "tool": 3200.0}
    stated = replace(stated, efficiency=np.ones(7))
    cell = MovingCell(2, "known", arm, stated, (0.0,) * 7, series, 25.0, start_s)
    result = run(cell.table(), robot_from_urdf(stated.urdf, "seven"), cell.knowledge)
    oracle = oracle_std(cell)
    assert oracle["coulomb_nm"].shape == (7,)
    assert result.loads[0].mass_kg == pytest.approx(arm.tool.mass_kg, rel=0.02)
    np.testing.assert_allclose(result.loads[0].com_m, arm.tool.com_m, atol=0.005)
    assert score(drawn_truth(arm, cell.motion, start_s, oracle), result)["impossible"] == 0
