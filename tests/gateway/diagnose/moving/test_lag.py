"""Delayed torque readings and friction that differs between runs are nuisances: neither is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import Table, concatenate
from gateway.diagnose import diagnose
from gateway.diagnose.moving.moving_rows import lags, prepare_in_step
from gateway.identify.knowledge import Knowledge
from gateway.model.regressor import regressor
from gateway.model.robot import Robot
from tests.data.moving_arm import GRAVITY, World, as_period, coloured, measured

#: Rows of the torque are made at a finer rate, of which it is delayed by whole steps.
FINE_HZ, EVERY, PERIODS, PERIOD_S, NOISE = 200.0, 4, 3, 10.0, 0.02
#: Rows [-] by which the torque of each axis is delayed: of 5 ms each.
DELAY_ROWS = np.array([1, 1, 2, 0, 1, 0])
DRY_SHARE, SCATTER = 0.15, 0.1
LOAD = (3.0, 0.02, -0.03, 0.15)


def recorded(seed: int, world: World, delay: np.ndarray = DELAY_ROWS, scatter: float = SCATTER) -> tuple[Table, Robot]:
    """Two excitations, each bare and loaded, driven periodically; friction of its own level in each of the four."""
    tables, scale, robot = [], None, None
    generator = np.random.default_rng([seed, 7])
    for excitation in (11.0, 12.0):
        for payload in (None, LOAD):
            carrying = replace(world, payload=payload)
            fine, robot, scale = measured(
                [seed, int(excitation)], carrying, PERIOD_S, FINE_HZ, 0.0, arm_seed=seed, scale=scale
            )
            level = 1.0 + scatter * generator.normal(size=6)
            torque = fine.tau_nm + np.sign(fine.qd_rad_s) * DRY_SHARE * scale * (level - 1.0)
            rows = np.arange(EVERY, len(fine), EVERY)
            one = fine.take(rows)
            torque = np.stack([torque[rows - delay[axis], axis] for axis in range(6)], axis=1)
            for period in range(PERIODS):
                noise = NOISE * scale * coloured(generator, torque.shape, FINE_HZ / EVERY)
                part = as_period(one, torque + noise, excitation, period, PERIOD_S)
                tables.append(replace(part, run=np.array([f"{excitation}/{one.load[0]}/{period}"] * len(one))))
    assert robot is not None
    return concatenate(tables), robot


@pytest.fixture(scope="module")
def clean() -> tuple[Table, Robot]:
    """An arm that lacks nothing."""
    return recorded(5, World())


def test_delays_are_reported_where_they_are_certain() -> None:
    table, robot = recorded(5, World())
    early = replace(table, tau_nm=np.roll(table.tau_nm, -2, axis=0))
    assert lags(early, robot, Knowledge()).max() == 0.0, "no drive has its torque before its position"
    few = table.take(np.arange(20))
    assert lags(few, robot, Knowledge()).max() == 0.0


@pytest.mark.slow
def test_each_torque_meets_the_motion_that_it_belongs_to() -> None:
    """Of an axis that is delayed its own motion is moved, and that of all the others where its torque is modelled."""
    at, robot, _ = measured(3, World(), PERIOD_S, FINE_HZ, 0.0)
    delay = np.array([0.0, 0.01, 0.0, 0.0, 0.005, 0.0])
    now = prepare_in_step(at, None, robot, GRAVITY, np.zeros(6))
    then = prepare_in_step(at, None, robot, GRAVITY, delay)
    step = int(np.ceil(len(at) / len(now)))
    rows = np.arange(len(now))[5:-5] * step
    earlier = rows[:, None] - np.rint(delay * FINE_HZ).astype(int)
    for name in ("q_rad", "qd_rad_s", "qdd_rad_s2"):
        expected = np.stack([getattr(at, name)[earlier[:, axis], axis] for axis in range(6)], axis=1)
        assert getattr(then, name)[5:-5] == pytest.approx(expected, abs=1e-6)
    for axis in range(6):
        from_all = at.take(earlier[:, axis])
        columns = regressor(robot, from_all.q_rad, from_all.qd_rad_s, from_all.qdd_rad_s2, tuple(GRAVITY))
        assert then.rigid[5:-5, axis] == pytest.approx(columns[:, axis], abs=1e-5)
    assert np.array_equal(then.tau_nm, now.tau_nm)


@pytest.mark.slow
def test_an_arm_that_lacks_nothing_is_down_to_the_noise(clean: tuple[Table, Robot]) -> None:
    result = diagnose(*clean, Knowledge())
    assert result.effects == ()
    assert result.verdict == "none_needed"
    assert result.provenance["delay_s"] == pytest.approx(DELAY_ROWS / FINE_HZ, abs=1.5e-3)
    assert result.after.holdout_rms_nm == pytest.approx(np.array(result.noise_floor_nm), rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "name"),
    [
        (World(coil=(20_000.0, 0.05, 0.3, 0.2)), ("balancer_spring", (2,))),
        (World(cable={4: 0.5}), ("cable_torque", (5,))),
    ],
)
def test_what_it_lacks_is_found_beside(world: World, name: tuple[str, tuple[int, ...]]) -> None:
    result = diagnose(*recorded(6, world), Knowledge(), only=frozenset({"balancer_spring", "cable_torque"}))
    assert [(effect.name, effect.joints) for effect in result.effects] == [name]
    assert result.verdict == "explained"
