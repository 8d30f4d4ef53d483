"""Friction as a set, and the gear's efficiency by direction, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from sim.friction import JointFriction

STEP = 0.001 / 8.0


def gear(**values: float) -> JointFriction:
    friction = JointFriction(seed=1)
    for name, value in values.items():
        if name == "efficiency":
            friction.set_efficiency(value)
        else:
            setattr(friction, name, value)
    return friction


def settle(friction: JointFriction, u: float, tau: float, omega: float = 0.0, steps: int = 4000) -> float:
    for _ in range(steps):
        omega = friction.speed(omega, u, tau, STEP)
    return omega


@pytest.mark.parametrize("excess", [-4.9, -1.0, 0.0, 3.0, 4.9])
def test_inside_the_band_the_joint_rests(excess):
    assert settle(gear(stiction_nm=5.0, coulomb_nm=5.0), 20.0 + excess, 20.0) == 0.0


@pytest.mark.parametrize("sign", [1, -1])
def test_beyond_the_band_the_joint_accelerates_with_what_is_left(sign):
    friction = gear(stiction_nm=5.0, coulomb_nm=5.0)
    assert settle(friction, 20.0 + sign * 5.5, 20.0, steps=1000) == pytest.approx(sign * 0.5 * STEP * 1000)


def test_kinetic_friction_is_below_stiction():
    friction = gear(stiction_nm=6.0, coulomb_nm=4.0)
    assert settle(friction, 5.5, 0.0, steps=200) == 0.0
    assert settle(friction, 5.5, 0.0, omega=0.5, steps=200) > 0.5
    assert settle(friction, 3.5, 0.0, omega=0.5, steps=20000) == 0.0


@pytest.mark.parametrize(("tau", "direction"), [(30.0, 1), (30.0, -1), (-30.0, 1), (-30.0, -1)])
@pytest.mark.parametrize("efficiency", [0.8, 0.95])
def test_steady_motion_takes_the_torque_of_its_direction(tau, direction, efficiency):
    """Driving eta u = tau + d F, driven back u = eta (tau + d F) (QH165, eq. 9)."""
    coulomb, bias, nu, viscous, speed = 2.0, 0.7, 0.05, 3.0, 0.4
    friction = gear(
        coulomb_nm=coulomb,
        stiction_nm=coulomb,
        bias_nm=bias,
        load_friction=nu,
        viscous_nm_s_rad=viscous,
        efficiency=efficiency,
    )
    behind = tau + direction * (coulomb + nu * abs(tau) + viscous * speed) + bias
    u = behind / efficiency if behind * direction > 0 else behind * efficiency
    omega = direction * speed
    assert friction.speed(omega, u, tau, STEP) == pytest.approx(omega, rel=1e-12)


def test_a_gear_at_rest_may_stand_anywhere_between_driving_and_driven_back():
    efficiency, tau = 0.8, 100.0
    for u in (tau * efficiency + 0.1, tau, tau / efficiency - 0.1):
        assert settle(gear(efficiency=efficiency), u, tau) == 0.0
    assert settle(gear(efficiency=efficiency), tau / efficiency + 0.1, tau) > 0.0
    assert settle(gear(efficiency=efficiency), tau * efficiency - 0.1, tau) < 0.0


def test_a_stuck_joint_creeps_with_the_torque_that_friction_holds_and_comes_to_rest():
    friction = gear(stiction_nm=5.0, coulomb_nm=5.0, creep_rad_s=1e-4)
    angle, omega, speeds = 0.0, 0.0, []
    for _ in range(5000):
        omega = friction.speed(omega, 4.5, 0.0, STEP)
        speeds.append(omega)
        angle += omega * 0.001
    assert 0.0 < angle < 1e-4
    assert 0.0 < speeds[-1] < 0.02 * max(speeds)


def test_each_motion_finds_its_own_level_of_friction():
    friction = gear(stiction_nm=5.0, coulomb_nm=5.0, scatter=0.1)
    levels = []
    for _ in range(300):
        settle(friction, 0.0, 0.0, steps=250)
        force = 4.0
        while settle(friction, force, 0.0, steps=2) == 0.0:
            force += 0.02
        omega = settle(friction, 20.0, 0.0, steps=10)
        levels.append(20.0 - (friction.speed(omega, 20.0, 0.0, STEP) - omega) / STEP)
        settle(friction, 0.0, 0.0, omega=omega, steps=500)
    assert np.mean(levels) == pytest.approx(5.0, abs=0.15)
    assert np.std(levels) == pytest.approx(0.5, rel=0.2)
