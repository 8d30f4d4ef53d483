"""Motion that repeats: what differs between its periods is the noise, and unseen parts of the period judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.periods import excitation_runs, noise_between_periods
from gateway.data.rows import Table, concatenate
from gateway.diagnose import diagnose
from gateway.diagnose.moving.moving_rows import blocks, judging
from gateway.model.motion import prepare
from gateway.model.robot import Robot
from tests.data.moving_arm import GRAVITY, World, as_period, coloured, measured

PERIODS, RATE_HZ, PERIOD_S, NOISE = 4, 25.0, 10.0, 0.02


def driven(
    seed: int, world: World, excitation: float, scale: np.ndarray | None = None
) -> tuple[Table, Robot, np.ndarray]:
    """Periods of one excitation: the same motion and the same torque, noise of its own in each."""
    one, robot, scale = measured([seed, int(excitation)], world, PERIOD_S, RATE_HZ, 0.0, arm_seed=seed, scale=scale)
    assert scale is not None
    generator, count = np.random.default_rng([seed, 7, int(excitation)]), len(one)
    parts = []
    for period in range(PERIODS):
        noisy = one.tau_nm + NOISE * scale * coloured(generator, one.tau_nm.shape, RATE_HZ)
        part = as_period(one, noisy, excitation, period, PERIOD_S)
        parts.append(replace(part, run=np.array([f"p{period}"] * count)))
    return concatenate(parts), robot, scale


def bare_and_loaded(seed: int, world: World) -> tuple[Table, Robot, np.ndarray]:
    """Two excitations, each bare and with a load."""
    tables, scale, robot = [], None, None
    for excitation in (11.0, 12.0):
        for payload in (None, (3.0, 0.02, -0.03, 0.15)):
            table, robot, scale = driven(seed, replace(world, payload=payload), excitation, scale)
            tables.append(table)
    assert robot is not None
    assert scale is not None
    return concatenate(tables), robot, scale


def test_noise_is_what_differs_between_periods() -> None:
    table, _, scale = driven(3, World(), 11.0)
    turns = np.ones((len(table), 6), dtype=bool)
    assert noise_between_periods(table, turns) == pytest.approx(NOISE * scale, rel=0.25)
    once = table.extra["x_period"] == 0
    assert np.isnan(noise_between_periods(table.take(once), turns[once])).all()
    touched = np.where((table.extra["x_period"] == 2)[:, None], 50.0, 0.0)
    shaken = replace(table, tau_nm=table.tau_nm + touched)
    assert noise_between_periods(shaken, turns).max() < 2.0 * (NOISE * scale).max() + 25


def test_what_an_axis_holds_at_a_standstill_is_no_noise() -> None:
    """Within its friction an axis at rest holds the torque with which it stopped: another torque in every period."""
    table, robot, scale = driven(3, World(), 11.0)
    is_at_rest = table.extra["x_phase_s"] > 0.6 * PERIOD_S
    held = np.where(is_at_rest[:, None], 5.0 * table.extra["x_period"][:, None], 0.0)
    swept = replace(table, qd_rad_s=np.where(is_at_rest[:, None], 0.0, table.qd_rad_s), tau_nm=table.tau_nm + held)
    assert prepare(swept, None, robot, GRAVITY).floor_nm == pytest.approx(NOISE * scale, rel=0.25)


def test_all_periods_of_an_excitation_are_one_run() -> None:
    table, robot, _ = bare_and_loaded(3, World())
    assert len(np.unique(excitation_runs(table))) == 4
    motion = prepare(table, None, robot, GRAVITY)
    assert len(np.unique(motion.run)) == 4
    assert motion.duration_s > 3 * PERIOD_S
    for part in judging(motion, 4):
        for number in np.unique(part.run):
            mine = part.run == number
            fitted, held = part.phase_s[mine & ~part.held_out], part.phase_s[mine & part.held_out]
            fitted = fitted[np.isin(fitted, part.phase_s[mine & ~part.held_out & part.judged.any(axis=1)])]
            assert np.abs(fitted[:, None] - held).min() > 0.05, "no period shows what another one is judged on"
    tests = np.sum([test for _, test in blocks(motion, 6)], axis=0)
    assert tests.tolist() == [1] * len(motion)


@pytest.fixture(scope="module")
def clean() -> tuple[Table, Robot, np.ndarray]:
    """An arm that lacks nothing."""
    return bare_and_loaded(5, World())


@pytest.mark.slow
def test_an_arm_that_lacks_nothing_is_down_to_the_noise(clean: tuple[Table, Robot, np.ndarray]) -> None:
    table, robot, scale = clean
    result = diagnose(table, robot)
    assert result.verdict == "none_needed"
    assert result.noise_floor_nm == pytest.approx(NOISE * scale, rel=0.25)
    assert "parts of the period" in result.provenance["held_out"]


@pytest.mark.slow
def test_an_unexplained_repeating_torque_is_reported(clean: tuple[Table, Robot, np.ndarray]) -> None:
    table, robot, _ = bare_and_loaded(5, World(strange={2: 0.3}))
    result = diagnose(table, robot)
    assert result.verdict in ("unexplained", "improved")
    assert any("J3" in finding.where and "difference between periods" in finding.what for finding in result.findings)
