"""Torque offset for friction, delayed by the servos' lag: against hand calculation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.pair.joint_targets import FrictionOffset, Presliding

COULOMB, VISCOUS = np.array([18.0, 27, 15, 3.6, 3, 1.8]), np.array([12.0, 18, 10, 2.4, 2, 1.2])


@pytest.mark.parametrize(("coulomb", "viscous"), [(COULOMB, VISCOUS), (COULOMB.repeat(2)[:7], VISCOUS.repeat(2)[:7])])
def test_friction_of_a_target_comes_when_the_servo_reaches_it(coulomb: np.ndarray, viscous: np.ndarray) -> None:
    arm = SimpleNamespace(coulomb_nm=coulomb, viscous_nm_s_rad=viscous)
    offset = FrictionOffset(arm, 0.004, 0.016)  # type: ignore[arg-type]
    at_rest, moving = np.zeros_like(coulomb), np.full_like(coulomb, -0.5 * 0.004)
    for _ in range(10):
        assert offset.at(at_rest).tolist() == at_rest.tolist()
    offsets = [offset.at((step + 1) * moving) for step in range(6)]
    assert not any(early.any() for early in offsets[:4])
    assert offsets[4] == pytest.approx(-coulomb - 0.5 * viscous)
    assert offsets[5] == pytest.approx(offsets[4])


def test_a_joint_that_stops_keeps_its_offset_until_its_targets_turn_round() -> None:
    """A tenth of a millimetre by a metre of hand is what it takes; speed plays no part."""
    arm = SimpleNamespace(coulomb_nm=COULOMB, viscous_nm_s_rad=VISCOUS)
    offset = FrictionOffset(arm, 0.004, 0.0)  # type: ignore[arg-type]
    for moved in np.append(np.linspace(1e-3, 0.0, 20), np.zeros(100)).cumsum():
        offsets = offset.at(np.full(6, moved))
    assert offsets == pytest.approx(COULOMB)
    back = [offset.at(np.full(6, moved - step)) for step in (2e-6, 4e-6, 1e-5, 1e-4, 1e-4)]
    assert back[0] == pytest.approx(COULOMB * (2.0 * np.exp(-0.2) - 1.0) - VISCOUS * 5e-4)
    assert back[-1] == pytest.approx(-COULOMB, rel=1e-3)


def test_friction_of_a_joint_that_has_not_moved_may_have_either_sign():
    assert Presliding(2, 0.004).turned.tolist() == [0.0, 0.0]


def test_friction_reverses_over_distance_and_not_with_speed():
    """Dahl: 1 - 2 exp(-d / 5e-5) after turning round."""
    joint = Presliding(3, 0.004)
    joint.move(np.array([1e-2, -1e-2, 0.0]))
    assert joint.turned == pytest.approx([1.0, -1.0, 0.0])
    joint.move(np.array([-2e-5, -1e-5, 0.0]))
    joint.move(np.array([-3e-5, -1e-5, 0.0]))
    assert joint.turned == pytest.approx([-1.0 + 2.0 * np.exp(-1.0), -1.0, 0.0])
    for _ in range(500):
        joint.move(np.array([0.0, 0.0, 1e-6]))
    assert joint.turned[2] == pytest.approx(1.0, abs=1e-4)


def test_half_the_friction_of_a_joint_at_rest_is_uncertain():
    """Within a tenth of a second, whatever the SYNC; one that creeps on holds it all, one of little keeps that."""
    for dt_s in (0.001, 0.004):
        joint = Presliding(3, dt_s)
        joint.move(np.array([1e-2, 1e-2, 2e-5]))
        little = joint.turned[2]
        for _ in range(round(0.1 / dt_s)):
            joint.move(np.array([0.0, 0.001 * dt_s, 0.0]))
        assert joint.turned == pytest.approx([0.5 + 0.5 * np.exp(-1.0), 1.0, little], abs=0.02)


def test_an_encoder_that_trembles_at_rest_leaves_friction_open():
    joint = Presliding(1, 0.004)
    joint.move(np.array([1.0]))
    for index in range(2000):
        joint.move(np.array([2e-6 * (-1.0) ** index]))
    assert abs(joint.turned[0]) < 0.1
