"""From motion to offsets: by formulas computed here, and against a simulated drive's own arithmetic elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.law import TURN_ROUND_RAD, AxisTerms, FeedforwardLaw
from gateway.feedforward.ramp import Ramp
from gateway.identify.links import body_parameters
from gateway.model.regressor import regressor


def terms(**changes):
    values = {
        "ratio": 100.0,
        "position_sign": -1.0,
        "torque_sign": 1.0,
        "efficiency": 0.8,
        "rotor_kg_m2": 30.0,
        "coulomb_nm": 40.0,
        "viscous_nm_s_rad": 50.0,
        "velocity_share": 0.8,
        "limit_nm": 20.0,
    }
    return AxisTerms(**values | changes)


@pytest.fixture
def parameters(qh165):
    bodies = [body_parameters(qh165.mass_kg[i], qh165.com_m[i], qh165.inertia_kg_m2[i]) for i in range(6)]
    return np.concatenate(bodies)


@pytest.fixture
def law(qh165, parameters):
    return FeedforwardLaw(ArmDynamics(qh165, parameters), [terms()] * 6)


Q, QD, QDD = [0.3, 0.5, -0.4, 0.2, 0.7, 0.1], [0.4, -0.4, 0.3, 0.5, -0.2, 0.1], [0.5, -0.6, 0.2, -1.0, 0.7, 0.9]


def test_both_offsets_by_formula(law, qh165, parameters):
    rigid = regressor(qh165, [Q], [QD], [QDD])[0] @ parameters
    rates, gains = np.array(QD), np.array(QDD)
    output = rigid + 40.0 * np.sign(rates) + 50.0 * rates
    motor = np.where(output * rates > 0, output / 0.8, output * 0.8) + 30.0 * gains
    velocity, torque = law.offsets(Q, QD, QDD, np.sign(QD).tolist())
    np.testing.assert_allclose(torque, motor / 100.0, rtol=1e-12)
    np.testing.assert_allclose(velocity, -0.2 * 100.0 * rates, rtol=1e-12)


def test_friction_of_the_load_and_at_the_onset_of_motion_by_formula(qh165, parameters):
    law = FeedforwardLaw(
        ArmDynamics(qh165, parameters), [terms(load_friction=0.05, onset_nm=12.0, stribeck_rad_s=0.3)] * 6
    )
    rigid = regressor(qh165, [Q], [QD], [QDD])[0] @ parameters
    rates = np.array(QD)
    dry = 40.0 + 0.05 * np.abs(rigid) + 12.0 * np.exp(-((rates / 0.3) ** 2))
    output = rigid + dry * np.sign(rates) + 50.0 * rates
    motor = np.where(output * rates > 0, output / 0.8, output * 0.8) + 30.0 * np.array(QDD)
    _, torque = law.offsets(Q, QD, QDD, np.sign(QD).tolist())
    np.testing.assert_allclose(torque, motor / 100.0, rtol=1e-12)


def test_at_rest_and_with_no_motion_known_the_offset_is_gravity_over_a_loss_free_gear(law, qh165, parameters):
    rest = [0.0] * 6
    rigid = regressor(qh165, [Q], [rest], [rest])[0] @ parameters
    velocity, torque = law.offsets(Q, rest, rest, rest)
    np.testing.assert_allclose(torque, rigid / 100.0, rtol=1e-12, atol=1e-12)
    assert velocity == [0.0] * 6


def test_friction_reverses_within_a_small_distance_and_keeps_its_sense_at_rest(law):
    forward = law.sense([0.0] * 6, [TURN_ROUND_RAD] * 6)
    assert forward == pytest.approx([1.0] * 6)
    assert law.sense(forward, [0.1] * 6) == [1.0] * 6
    assert law.sense(forward, [0.0] * 6) == forward
    half = law.sense(forward, [-TURN_ROUND_RAD] * 6)
    assert half == pytest.approx([0.0] * 6)
    assert law.sense(half, [-0.1] * 6) == [-1.0] * 6


def test_the_offset_has_no_jump_as_the_sense_passes_zero(law):
    rest = [0.0] * 6
    before, after = (law.offsets(Q, rest, rest, [side] * 6)[1] for side in (-1e-9, 1e-9))
    np.testing.assert_allclose(before, after, atol=1e-5)


def test_at_rest_the_offset_is_that_of_the_side_the_axis_came_from(law, qh165, parameters):
    """Driven up the motor carried T / eta + friction, let down T eta - friction: it still does while it rests."""
    rest = [0.0] * 6
    rigid = regressor(qh165, [Q], [rest], [rest])[0] @ parameters
    for side in (-1.0, 1.0):
        output = rigid + 40.0 * side
        expected = np.where(output * side > 0, output / 0.8, output * 0.8) / 100.0
        np.testing.assert_allclose(law.offsets(Q, rest, rest, [side] * 6)[1], expected, rtol=1e-12)


def test_a_drive_that_feeds_all_of_the_velocity_is_given_none(qh165, parameters):
    law = FeedforwardLaw(ArmDynamics(qh165, parameters), [terms(velocity_share=1.0)] * 6)
    assert law.offsets(Q, QD, QDD, [0.0] * 6)[0] == pytest.approx([0.0] * 6)


def test_a_coupled_wrist_gets_the_torque_of_both_joints(qh165, parameters):
    """Motor 6 turns with q5 too: theta = A q, so that f = A^-T tau keeps the power (virtual work)."""
    coupling = np.eye(6)
    coupling[5, 4] = -1.0
    bare = terms(efficiency=1.0, rotor_kg_m2=0.0, coulomb_nm=0.0, viscous_nm_s_rad=0.0, torque_sign=1.0)
    law = FeedforwardLaw(ArmDynamics(qh165, parameters), [bare] * 6, coupling)
    velocity, torque = law.offsets(Q, QD, QDD, [1.0] * 6)
    gear = 100.0 * np.array(torque)
    rates = np.array(velocity) / (-0.2 * 100.0)
    np.testing.assert_allclose(rates, coupling @ QD)
    rigid = regressor(qh165, [Q], [QD], [QDD])[0] @ parameters
    assert gear @ rates == pytest.approx(rigid @ np.array(QD))


def test_the_axis_furthest_beyond_its_limit_is_named(law):
    assert law.excess([1.0, -20.0, 0, 0, 0, 0]) is None
    assert law.excess([25.0, -40.0, 0, 0, 0, 0]) == (1, -40.0)
    assert law.excess([float("nan"), 0, 0, 0, 0, 0]) is not None


def test_the_ramp_rises_smoothly_and_falls_to_zero():
    ramp = Ramp(0.01, 0.5)
    ramp.rise()
    gains = [ramp.step(enabled=True) for _ in range(60)]
    assert gains[0] > 0.0
    assert gains[49:] == pytest.approx([1.0] * 11)
    assert max(np.diff([0.0, *gains])) < 1.5 / 50 + 1e-9
    ramp.fall()
    assert [ramp.step(enabled=True) for _ in range(60)][-1] == 0.0
    assert ramp.resting


def test_leaving_operation_enabled_cuts_the_offsets_while_ramping_and_for_good():
    ramp = Ramp(0.01, 0.5)
    ramp.rise()
    assert [ramp.step(enabled=True) for _ in range(20)][-1] > 0.1
    assert ramp.step(enabled=False) == 0.0
    assert ramp.step(enabled=True) == 0.0
    assert "OPERATION ENABLED" in ramp.reason
