"""From the parameters that a result states back to the torque of an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.errors import DataUnusable
from gateway.identify.stated_effects import LASTING, stated_terms
from gateway.model.effects.axis_coupling import TorqueMixing
from gateway.model.effects.balancer_spring import REACH_M, CoilBalancer, GasBalancer
from gateway.model.effects.cable_torque import HarmonicCable, LinearCable
from gateway.model.effects.joint_elasticity import JointElasticity
from gateway.model.effects.joint_zero_offset import JointZeroOffset
from gateway.model.effects.link_mass import LinkMass
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.torque_constant_scale import TorqueConstantScale
from gateway.model.effects.torque_offset import TorqueOffset
from gateway.model.effects.torque_ripple import TorqueRipple
from gateway.model.rest import neutral
from gateway.model.visits import Gears, visits_at
from gateway.result.result import EffectResult

GEARS = Gears.of(np.linspace(0.8, 0.9, 6), 6)
Q = np.random.default_rng(2).uniform(-1.5, 1.5, (40, 6))
FITTED = (
    (CoilBalancer(1, 0.7, 0.3, 500.0), [900.0, 120.0, 0.25, 0.6]),
    (CoilBalancer(1, 0.35, -2.5, 5e4), [4e4, -3000.0, -2.4, 1.4]),
    (GasBalancer(1, 0.7, 0.5, 500.0, 0.7), [300.0, 0.4, 0.2, -0.3]),
    (LinearCable(4), [-20.0, 4.0]),
    (HarmonicCable(3), [-12.0, 5.0]),
    (JointElasticity(1, 900.0), [2e-6]),
    (JointZeroOffset(2), [-0.03]),
    (TorqueConstantScale(1), [0.12]),
    (TorqueConstantScale(None), [-0.05]),
    (TorqueOffset(5), [3.5]),
    (LoadDependentFriction(1), [0.07]),
    (TorqueMixing(3, 5), [-0.4]),
    (LinkMass(2), [4.0, 0.3, -0.1, 0.8]),
    (TorqueRipple(1, 105.0), [2.0, -1.0]),
)


def stated(term, theta) -> EffectResult:
    values, std = term.report(np.array(theta), np.eye(len(theta)))
    return EffectResult(term.name, term.joints, values, std)


@pytest.mark.parametrize(("term", "theta"), FITTED, ids=lambda value: getattr(value, "name", ""))
def test_what_is_stated_gives_the_model_that_was_fitted(term, theta):
    rows = visits_at(Q, GEARS)
    ((found, solved),) = stated_terms([stated(term, theta)], GEARS, 6)
    expected = term.apply(neutral(len(Q), 6), np.array(theta), rows)
    solved_model = found.apply(neutral(len(Q), 6), solved, rows)
    for name in expected.__slots__:
        want = getattr(expected, name)
        close = pytest.approx(want, rel=1e-4, abs=1e-4 * np.abs(want).max(initial=1e-9))
        assert getattr(solved_model, name) == close, name


def test_every_lasting_effect_is_solved_here():
    assert {term.name for term, _ in FITTED} == LASTING


def test_the_torque_of_a_coil_is_that_of_its_length_and_lever():
    """Closed form: force times lever of a spring between link 2 and the base, from the stated numbers alone."""
    effect = stated(*FITTED[0])
    known = effect.parameters
    ((term, theta),) = stated_terms([effect], GEARS, 6)
    product = known["lever_ratio"] * REACH_M**2 / 2.0  # lever times anchor
    angle = Q[:, 1] - known["phase_rad"]
    length = np.sqrt(REACH_M**2 - 2.0 * product * np.cos(angle))
    force = known["stiffness_n_m"] * (length - known["free_length_m"])
    found = term.apply(neutral(len(Q), 6), theta, visits_at(Q, GEARS)).passive_nm[:, 1]
    assert found == pytest.approx(-force * product * np.sin(angle) / length, rel=1e-6)


@pytest.mark.parametrize("name", ["thermal_drift", "payload_shift", "base_tilt", "sign_reversed", "velocity_friction"])
def test_an_effect_that_does_not_last_is_refused(name):
    with pytest.raises(DataUnusable, match=f"effect {name}"):
        stated_terms([EffectResult(name, (1,), {"per_s": 1e-4})], GEARS, 6)


def test_an_effect_with_other_parameters_is_refused_by_name():
    effect = replace(stated(*FITTED[3]), parameters={"stiffness_nm_rad": 20.0})
    with pytest.raises(DataUnusable, match="cable_torque is not determined"):
        stated_terms([effect], GEARS, 6)


def test_friction_by_direction_is_in_the_offsets_of_the_arm():
    assert stated_terms([EffectResult("static_friction", (2,), {"bias_nm": 3.0})], GEARS, 6) == ()
