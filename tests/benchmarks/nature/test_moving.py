"""Moving runs of nature: a pendulum in closed form, what filter and noise do, the same from the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.nature.levels import MILD
from benchmarks.nature.moving_arm import MovingArm, box_inertia, moving_arm
from benchmarks.nature.moving_cell import FINE, PeriodicMotion, measure_moving, reported_nm
from sim.urdf import SimBody, SimChain

G = 9.80665
PERIOD_S = 4.0
SIZE_RAD = 0.5
MASS_KG, LENGTH_M, INERTIA_KG_M2 = 5.0, 0.3, 0.02


def pendulum() -> SimChain:
    body = SimBody(MASS_KG, np.array([LENGTH_M, 0.0, 0.0]), INERTIA_KG_M2 * np.eye(3))
    one = np.ones(1)
    return SimChain("pendulum", np.eye(4)[None], np.array([[0.0, 1.0, 0.0]]), (body,), -2 * one, 2 * one, one, one)


def swing(time_s: np.ndarray) -> tuple[np.ndarray, ...]:
    """From rest to rest: half a cosine there and back."""
    rate = 2.0 * np.pi / PERIOD_S
    angle = rate * np.asarray(time_s)[:, None]
    return (
        SIZE_RAD * (1.0 - np.cos(angle)),
        SIZE_RAD * rate * np.sin(angle),
        SIZE_RAD * rate**2 * np.cos(angle),
    )


def exact(arm: MovingArm) -> MovingArm:
    """The arm with its Coulomb, viscous and load friction and its rotor, and nothing else; CAD is true."""
    nothing = np.zeros(1)
    friction = replace(
        arm.friction,
        bias_share=nothing,
        driving=nothing + 1.0,
        driven=nothing + 1.0,
        declared_efficiency=nothing + 1.0,
        warm_share=np.zeros((2, 1)),
        tail_share=nothing,
        load_power=nothing + 1.0,
    )
    return replace(
        arm,
        chain=pendulum(),
        friction=friction,
        gain=nothing,
        breakaway_share=nothing,
        cogging_nm=np.zeros((1, 4)),
        noise_nm=nothing,
        filter_s=nothing + 1e-9,
        dead_s=nothing,
        resolution_nm=nothing + 1e-9,
        count_rad=nothing + 1e-12,
    )


@pytest.fixture
def arm() -> MovingArm:
    drawn, _ = moving_arm(pendulum(), 10.0, MILD, np.random.default_rng(5))
    return exact(drawn)


@pytest.fixture
def motion() -> PeriodicMotion:
    return PeriodicMotion(swing, PERIOD_S, periods=2, rate_hz=100.0, harmonics=5)


def expected(arm: MovingArm, motion: PeriodicMotion, time_s: np.ndarray, inertia: float, weight: float) -> np.ndarray:
    """The closed form: J qdd - m g l cos q + friction, J with the rotor."""
    q, qd, qdd = swing(time_s)
    rigid = inertia * qdd - weight * np.cos(q)
    own = arm.friction.coulomb_nm + arm.friction.load_loss * np.abs(rigid)
    return rigid + arm.rotor_inertia_kg_m2 * qdd + np.sign(qd) * own + arm.viscous_nm_s_rad * qd


def test_a_pendulum_with_rotor_and_friction_shows_its_closed_form(arm, motion):
    columns = measure_moving(arm, motion, "none", 0.0, np.random.default_rng(0))
    predicted = expected(
        arm, motion, columns["x_phase_s"], INERTIA_KG_M2 + MASS_KG * LENGTH_M**2, MASS_KG * G * LENGTH_M
    )
    turning = np.abs(swing(columns["x_phase_s"])[1]) > 1e-9
    np.testing.assert_allclose(columns["tau_nm"][turning], predicted[turning], atol=1e-6)
    for name, true in zip(("q_rad", "qd_rad_s", "qdd_rad_s2"), swing(columns["x_phase_s"]), strict=True):
        np.testing.assert_allclose(columns[name], true, atol=1e-9)
    assert columns["x_period"].tolist() == [1.0] * 400 + [2.0] * 400
    assert set(columns["run"]) == {"none"}


def test_a_load_adds_its_weight_and_its_inertia_about_the_axis(arm, motion):
    bare = reported_nm(arm, motion, "none", 0.0, np.random.default_rng(0))[0]
    loaded = reported_nm(arm, motion, "tool", 0.0, np.random.default_rng(0))[0]
    _, qd, qdd = swing(np.arange(len(bare)) / (FINE * motion.rate_hz) % PERIOD_S)
    q = swing(np.arange(len(bare)) / (FINE * motion.rate_hz) % PERIOD_S)[0]
    mass, (x, _, z) = arm.tool.mass_kg, arm.tool.com_m
    about_axis = arm.tool.inertia_kg_m2[1, 1] + mass * (x**2 + z**2)
    rigid = about_axis * qdd - mass * G * (x * np.cos(q) + z * np.sin(q))
    weight, inertia = MASS_KG * G * LENGTH_M, INERTIA_KG_M2 + MASS_KG * LENGTH_M**2
    own = inertia * qdd - weight * np.cos(q)
    more = np.sign(qd) * arm.friction.load_loss * (np.abs(own + rigid) - np.abs(own))
    turning = np.abs(qd[:, 0]) > 1e-6
    np.testing.assert_allclose((loaded - bare)[turning], (rigid + more)[turning], atol=1e-6)


def test_a_gear_takes_its_share_from_the_driving_side(arm, motion):
    lossy = replace(arm, friction=replace(arm.friction, declared_efficiency=np.full(1, 0.8)))
    behind, _ = reported_nm(arm, motion, "tool", 0.0, np.random.default_rng(0))
    motor, _ = reported_nm(lossy, motion, "tool", 0.0, np.random.default_rng(0))
    qd = swing(np.arange(len(behind)) / (FINE * motion.rate_hz) % PERIOD_S)[1]
    turning = np.abs(qd) > 1e-6
    drives = behind * qd > 0
    assert 0.2 < drives.mean() < 0.8
    np.testing.assert_allclose(motor[turning & drives], behind[turning & drives] / 0.8, atol=1e-4)
    np.testing.assert_allclose(motor[turning & ~drives], behind[turning & ~drives] * 0.8, atol=1e-4)


def test_a_filter_and_a_dead_time_delay_what_changes_slowly(arm, motion):
    delayed = replace(arm, filter_s=np.array([0.004]), dead_s=np.array([0.003]))
    smooth = replace(arm.friction, coulomb_nm=np.zeros(1), load_loss=np.zeros(1))
    early, delayed = replace(arm, friction=smooth), replace(delayed, friction=smooth)
    prompt, _ = reported_nm(early, motion, "none", 0.0, np.random.default_rng(0))
    shown, _ = reported_nm(delayed, motion, "none", 0.0, np.random.default_rng(0))
    slope = np.gradient(prompt[:, 0], 1.0 / (FINE * motion.rate_hz))
    settled = slice(1000, -10)
    delay = -float(slope[settled] @ (shown - prompt)[settled, 0]) / float(slope[settled] @ slope[settled])
    assert delay == pytest.approx(delayed.delay_s[0], rel=0.05)


def test_boxes_are_bodies():
    for seed in range(20):
        moments = np.linalg.eigvalsh(box_inertia(3.0, 0.5, np.random.default_rng(seed)))
        assert moments[0] > 0.0
        assert moments[0] + moments[1] >= moments[2]
