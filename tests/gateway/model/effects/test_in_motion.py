"""Columns of each effect in motion against what the effect does to the torque, written out here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.data.rows import MOVING
from gateway.identify.links import link_values
from gateway.model.effect import MotionSetup
from gateway.model.effects import DRAWN, FRICTION, LIBRARY, MISTAKES, terms_by_residual, terms_in_motion
from gateway.model.effects.axis_coupling import MotorCoupling, TorqueMixing
from gateway.model.effects.balancer_spring import REACH_M, CoilBalancer, GasBalancer, HarmonicBalancer
from gateway.model.effects.base_tilt import BaseTilt
from gateway.model.effects.cable_torque import CableSlope, HarmonicCable, LinearCable
from gateway.model.effects.current_rms_peak import is_rms_peak
from gateway.model.effects.joint_elasticity import JointElasticity
from gateway.model.effects.joint_zero_offset import JointZeroOffset
from gateway.model.effects.link_mass import LinkMass
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.payload_shift import PayloadShift
from gateway.model.effects.thermal_drift import ThermalDrift
from gateway.model.effects.torque_constant_scale import TorqueConstantScale
from gateway.model.effects.torque_offset import TorqueOffset
from gateway.model.effects.torque_ripple import TorqueRipple
from gateway.model.effects.velocity_friction import RootFriction, SquareFriction, Stribeck
from gateway.model.motion import Modelled, MovingRows, prepare
from gateway.model.regressor import regressor
from gateway.model.robot import robot_from_urdf
from gateway.model.term import Seen, wrist
from tests.support.rigs.tables import make_table

URDF = (Path(__file__).parents[4] / "examples" / "small" / "robot.urdf").read_text()
GRAVITY = np.array([0.0, 0.0, -9.80665])
LOAD = np.array([3.0, 0.09, -0.06, 0.3])
N, RATE_HZ = 240, 20.0


@pytest.fixture(scope="module")
def motion() -> MovingRows:
    rng = np.random.default_rng(3)
    time = np.arange(N) / RATE_HZ
    omega, phase = rng.uniform(0.6, 1.8, 6), rng.uniform(0.0, 6.0, 6)
    angle = np.outer(time, omega) + phase
    q, qd, qdd = np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
    heat = np.linspace(25.0, 31.0, N)[:, None] + np.arange(6)
    measured = {"time": time, "qd": qd, "qdd": qdd, "temperature": heat}
    table = make_table(["tool"] * N, np.full(N, MOVING), q, rng.normal(size=(N, 6)), **measured)
    return prepare(table, None, robot_from_urdf(URDF, "small"), GRAVITY)


@pytest.fixture(scope="module")
def body(motion) -> np.ndarray:
    """Parameters (60,) of the drawn links, the load on the last."""
    links = link_values(motion.robot).ravel()
    links[50:54] += LOAD
    return links


@pytest.fixture(scope="module")
def modelled(motion, body) -> Modelled:
    rigid = motion.rigid @ body
    return Modelled(rigid, rigid + 5.0 * motion.sign, np.tile(body, (N, 1)), np.full(N, LOAD[0]))


def torque(motion, body, q=None, gravity=GRAVITY) -> np.ndarray:
    """Torque (n, 6) of the rigid bodies at other angles or under another gravity."""
    q = motion.q_rad if q is None else q
    return np.asarray(regressor(motion.robot, q, motion.qd_rad_s, motion.qdd_rad_s2, tuple(gravity))) @ body


def test_columns_of_one_axis_are_their_closed_forms(motion, modelled):
    q, qd, sign, rigid = motion.q_rad, motion.qd_rad_s, motion.sign, modelled.rigid_nm
    expected = {
        LoadDependentFriction(2): [np.abs(rigid[:, 2]) * sign[:, 2]],
        Stribeck(1, 0.4): [sign[:, 1] * np.exp(-np.abs(qd[:, 1]) / 0.4)],
        RootFriction(3): [sign[:, 3] * np.abs(qd[:, 3]) ** 0.5],
        SquareFriction(3): [sign[:, 3] * qd[:, 3] ** 2],
        TorqueConstantScale(4): [rigid[:, 4]],
        TorqueOffset(5): [np.ones(N)],
        TorqueRipple(0, 40.0): [np.sin(40.0 * q[:, 0]), np.cos(40.0 * q[:, 0])],
        CableSlope(4): [-q[:, 4]],
        HarmonicCable(5): [-np.sin(q[:, 5]), -np.cos(q[:, 5])],
        LinearCable(5): [-q[:, 5], -np.ones(N)],
        ThermalDrift(1, "time", "friction"): [5.0 * sign[:, 1] * motion.time_s],
        ThermalDrift(1, "temperature", "friction"): [5.0 * sign[:, 1] * (motion.temperature_c[:, 1] - 26.0)],
        HarmonicBalancer(): [-np.cos(q[:, 1]), -np.sin(q[:, 1])],
    }
    for term, columns in expected.items():
        found = term.columns(motion, modelled)
        assert found.shape == (N, 1, term.count) == (N, 1, len(columns))
        assert found[:, 0] == pytest.approx(np.column_stack(columns), abs=1e-9), term
        assert term.enters(6) == (term.joints[0] - 1,)
        assert len(term.parameters[: term.count]) == term.count, "each column has a name"


@pytest.mark.parametrize("law", ["coil", "gas"])
def test_a_balancer_pushes_as_its_mechanism_does(motion, modelled, law):
    """Lever a, anchor b: the force F(l) along the rod turns the link by F a b sin / l."""
    lever, anchor, phase = 0.2, 0.7, 0.3
    ratio, reach = 2 * lever * anchor / (lever**2 + anchor**2), np.hypot(lever, anchor)
    angle = motion.q_rad[:, 1] - phase
    length = np.sqrt(lever**2 + anchor**2 - 2 * lever * anchor * np.cos(angle))
    if law == "coil":
        stiffness, free = 9000.0, 0.35
        force = stiffness * (length - free)
        strength = stiffness * lever * anchor
        term, value = CoilBalancer(1, ratio, phase), [strength, strength * (0.5 - free / reach)]
    else:
        stroke, force_n = 0.6, 1500.0
        used = stroke * (length - (anchor - lever)) / (2 * lever)
        force = force_n * (1.0 - used) ** -1.3
        term, value = GasBalancer(1, ratio, phase, 1.0, stroke), [force_n * lever * anchor / reach]
    push = -force * lever * anchor * np.sin(angle) / length
    assert term.columns(motion, modelled)[:, 0] @ value == pytest.approx(-push, rel=1e-6)
    values, _ = term.report(term.completed(np.array(value)), np.zeros((4, 4)))
    assert values["lever_ratio"] == pytest.approx(ratio)
    assert values["phase_rad"] == pytest.approx(phase)
    if law == "coil":
        assert values["stiffness_n_m"] == pytest.approx(9000.0, rel=1e-3)
        assert values["free_length_m"] == pytest.approx(0.35, rel=1e-3)
        assert reach == pytest.approx(REACH_M, rel=1e-3)


def test_shapes_that_are_open_widen_the_stiffness_of_a_first_harmonic():
    theta = np.array([0.0, -700.0, np.log(0.53 / 0.47), 0.5])
    plain, narrow = HarmonicBalancer().report(theta, np.diag([1.0, 1.0, 0.0, 0.0]))
    _, wide = HarmonicBalancer().report(theta, np.diag([1.0, 1.0, 0.64, 0.0625]))
    assert plain["amplitude_nm"] == pytest.approx(700.0)
    assert plain["phase_rad"] == pytest.approx(0.0)
    assert plain["stiffness_n_m"] == pytest.approx(700.0 * 2 / (0.53 * REACH_M**2 * 0.5))
    # d(ln k) = -(1 - ratio) d(logit) and d(free) / (1 - free)
    assert wide["stiffness_n_m"] / plain["stiffness_n_m"] == pytest.approx(np.hypot(0.47 * 0.8, 0.25 / 0.5), rel=0.01)
    assert narrow["stiffness_n_m"] < 0.01 * wide["stiffness_n_m"]


def test_a_motor_that_turns_with_another_joint_has_friction_on_both(motion, modelled):
    i, j, c = 4, 5, 0.7
    speed = motion.qd_rad_s[:, j] + c * motion.qd_rad_s[:, i]
    own = np.column_stack([np.sign(speed), speed, motion.qdd_rad_s2[:, j] + c * motion.qdd_rad_s2[:, i]])
    found = MotorCoupling(i, j, c).columns(motion, modelled)
    fast = np.abs(speed) > 0.2
    assert MotorCoupling(i, j, c).enters(6) == (i, j)
    assert found[fast, 1] == pytest.approx(own[fast], abs=1e-3)
    assert found[:, 0] == pytest.approx(c * found[:, 1])
    mixed = TorqueMixing(i, j)
    assert mixed.enters(6) == (i,)
    assert mixed.columns(motion, modelled)[:, 0, 0] == pytest.approx(modelled.total_nm[:, j])


def test_geometry_is_the_change_of_the_torque_to_first_order(motion, body, modelled):
    small = 1e-5
    turned = motion.q_rad + small * (np.arange(6) == 2)
    change = (torque(motion, body, turned) - modelled.rigid_nm) / small
    assert JointZeroOffset(2).columns(motion, modelled)[:, :, 0] == pytest.approx(change, abs=2e-3)
    softest = 1e-8
    soft = motion.q_rad - softest * np.outer(modelled.rigid_nm[:, 1], np.arange(6) == 1)
    change = (torque(motion, body, soft) - modelled.rigid_nm) / softest
    assert JointElasticity(1).columns(motion, modelled)[:, :, 0] == pytest.approx(change, abs=1e-2, rel=1e-3)
    for direction in (0, 1):
        turn = np.zeros(3)
        turn[direction] = small
        # gravity seen from a base that is turned by `turn`
        change = (torque(motion, body, gravity=GRAVITY - np.cross(turn, GRAVITY)) - modelled.rigid_nm) / small
        assert BaseTilt().columns(motion, modelled)[:, :, direction] == pytest.approx(change, abs=1e-3)


def test_bodies_are_the_torque_of_their_parameters(motion, body, modelled):
    added = np.array([2.0, 0.3, -0.1, 0.2])
    heavier = body.copy()
    heavier[20:24] += added
    term = LinkMass(2)
    assert term.columns(motion, modelled) @ added == pytest.approx(torque(motion, heavier) - modelled.rigid_nm)
    assert term.bodies(added, 60) == pytest.approx(heavier - body)
    assert TorqueOffset(1).bodies(np.ones(1), 60) == 0.0
    shift, share = np.array([0.02, -0.01, 0.03]), motion.time_s / motion.time_s[-1]
    moved = np.zeros((N, 60))
    moved[:, 51:54] = LOAD[0] * share[:, None] * shift
    term = PayloadShift(0.0, float(motion.time_s[-1]), "tool")
    expected = np.einsum("nap,np->na", motion.rigid, moved)
    assert term.columns(motion, modelled) @ shift == pytest.approx(expected)
    assert not PayloadShift(0.0, 1.0, "other").columns(motion, modelled).any()
    jump = PayloadShift(float(motion.time_s[100]), None, "tool").columns(motion, modelled)
    assert not jump[:100].any()
    assert jump[100:].any()


@pytest.fixture
def seen(motion, modelled) -> Seen:
    return Seen(motion, modelled, modelled.rigid_nm, lambda axis, columns, value: columns @ value)


def test_what_an_arm_can_have_of_an_effect(motion, modelled, seen):
    most = float(np.abs(modelled.rigid_nm[:, 1]).max())
    both = [
        (LoadDependentFriction(1), [0.05], [-0.05]),
        (LoadDependentFriction(1), [0.59], [0.61]),
        (BaseTilt(), [0.19, -0.19], [0.0, 0.21]),
        (JointZeroOffset(1), [-0.19], [-0.21]),
        (TorqueConstantScale(1), [1.0 / 0.41 - 1.0], [1.0 / 0.39 - 1.0]),
        (TorqueConstantScale(1), [1.0 / 2.4 - 1.0], [1.0 / 2.6 - 1.0]),
        (JointElasticity(1), [0.049 / most], [0.051 / most]),
        (JointElasticity(1), [0.01 / most], [-0.01 / most]),
        (CableSlope(4), [-3.0], [3.0]),
        (TorqueMixing(1, 2), [-0.03], [0.01]),
        (TorqueMixing(1, 2), [2.4], [2.6]),
        (LinkMass(1), [2.0, 0.0, 0.0, 3.9], [2.0, 0.0, 0.0, 4.1]),
        (LinkMass(1), [2.0, 0.0, 0.0, 0.0], [-2.0, 0.0, 0.0, 0.0]),
        (Stribeck(1, 0.4), [1.0], [-1.0]),
    ]
    for term, good, bad in both:
        assert term.possible(np.array(good), np.full(len(good), 1e-9), seen), (term, good)
        assert not term.possible(np.array(bad), np.full(len(bad), 1e-9), seen), (term, bad)
    unsure = np.array([1.0, 0.1, 0.1, 0.1])
    assert LinkMass(1).possible(np.array([-2.0, 0.0, 0.0, 0.5]), unsure, seen), "its moment is seen, its mass is not"
    assert not LinkMass(1).possible(np.array([-3.1, 0.0, 0.0, 0.5]), unsure, seen)
    motor = MotorCoupling(4, 5, 1.0)
    assert motor.possible(np.array([1.0, -0.1, 0.0]), np.array([0.1, 0.1, 0.1]), seen)
    assert not motor.possible(np.array([1.0, -0.3, 0.0]), np.array([0.1, 0.1, 0.1]), seen)
    assert not motor.possible(np.array([-0.1, -0.1, 0.0]), np.array([0.1, 0.1, 0.1]), seen)


def test_a_balancer_takes_torque_off_gravity_and_not_a_trifle(motion, modelled, seen):
    still = modelled.rigid_nm[:, 1]
    columns = HarmonicBalancer().columns(motion, modelled)[:, 0]
    against = np.linalg.lstsq(columns, -still, rcond=None)[0]
    std = np.ones(2)
    assert HarmonicBalancer().possible(against, std, seen)
    assert not HarmonicBalancer().possible(-against, std, seen), "it would load the axis"
    assert not HarmonicBalancer().possible(0.1 * against, std, seen), "unrealistically weak"
    undrawn = replace(seen, drawn_nm=np.zeros_like(seen.drawn_nm))
    assert HarmonicBalancer().possible(against, std, undrawn)


def setup(motion, **measured) -> MotionSetup:
    return MotionSetup(**{"drawn": True, "loads": ("tool",), "residual_nm": np.zeros_like(motion.tau_nm), **measured})


def joints_of(terms, name):
    return sorted({term.joints for term in terms if term.name == name})


def test_what_the_rows_cannot_show_is_not_tried(motion):
    terms = terms_in_motion(motion, setup(motion))
    assert len(set(terms)) == len(terms)
    assert joints_of(terms, "load_dependent_friction") == [(axis,) for axis in range(1, 7)]
    assert joints_of(terms, "cable_torque") == [(4,), (5,), (6,)]
    assert joints_of(terms, "link_mass") == [(2,), (3,), (4,)]
    assert joints_of(terms, "joint_elasticity") == [(axis,) for axis in range(1, 7)]
    assert joints_of(terms, "axis_coupling") == [(1, 2), (2, 3), (2, 4), (3, 4), (4, 5), (4, 6), (5, 6)]
    assert joints_of(terms, "payload_shift") == [()]
    assert {term.by for term in terms if isinstance(term, ThermalDrift)} == {"temperature"}
    judged = motion.judged.copy()
    judged[:, [1, 4]] = False
    cold = replace(motion, judged=judged, temperature_c=np.full((N, 6), np.nan))
    fewer = terms_in_motion(cold, setup(motion, drawn=False, loads=()))
    names = {term.name for term in fewer}
    assert not names & {"balancer_spring", "link_mass", "payload_shift", "thermal_drift"}
    assert joints_of(fewer, "torque_offset") == [(1,), (3,), (4,), (6,)]
    assert joints_of(fewer, "axis_coupling") == [(3, 4), (4, 6)]
    long = replace(cold, time_s=motion.time_s * 6.0)
    assert joints_of(terms_in_motion(long, setup(motion)), "thermal_drift") == [(1,), (3,), (4,), (6,)]
    stiff = replace(motion, wind_up_rad=np.where(np.arange(6) == 1, 0.0, np.nan) * np.ones((N, 1)))
    assert joints_of(terms_in_motion(stiff, setup(motion)), "joint_elasticity") == [(1,), (3,), (4,), (5,), (6,)]


def test_balancers_are_tried_all_around_the_joint(motion):
    terms = terms_in_motion(motion, setup(motion))
    for law in (CoilBalancer, GasBalancer):
        phases = np.unwrap(np.sort([term.phase_rad for term in terms if type(term) is law]))
        gaps = np.diff(np.append(phases, phases[0] + 2.0 * np.pi))
        assert gaps.max() == pytest.approx(np.pi / 6)


def test_a_swing_is_read_off_the_residual(motion):
    rng = np.random.default_rng(0)
    left = 0.1 * rng.normal(size=(N, 6))
    left[:, 2] += np.sin(20.0 * motion.q_rad[:, 2] + 0.4)
    found = terms_by_residual(motion, setup(motion, residual_nm=left))
    best = next(term for term in found if term.axis == 2)
    assert best.per_revolution == pytest.approx(20.0, abs=0.5)
    assert len([term for term in found if term.axis == 2]) == 2
    assert not [term for term in terms_in_motion(motion, setup(motion)) if term.name == "torque_ripple"]


def test_the_wrist_is_the_last_axes():
    assert [wrist(axes) for axes in (2, 4, 6, 7, 8)] == [(), (3,), (3, 4, 5), (4, 5, 6), (5, 6, 7)]


def test_a_factor_of_the_root_of_two_is_a_mistake_where_it_is_known_well():
    assert is_rms_peak(1.42, 0.02)
    assert is_rms_peak(0.70, 0.02)
    assert not is_rms_peak(1.42, 1e-4), "certainly not the root of two"
    assert not is_rms_peak(1.30, 0.5), "too far, however uncertain"
    assert not is_rms_peak(1.0, 0.01)


def test_standard_deviations_are_passed_on_to_first_order():
    rng = np.random.default_rng(1)
    theta, covariance = np.array([2.0, -3.0]), np.array([[0.04, 0.01], [0.01, 0.09]])
    values, std = TorqueRipple(1, 105.0).report(theta, covariance)
    sine, cosine = rng.multivariate_normal(theta, covariance, 200_000).T
    assert values["amplitude_nm"] == pytest.approx(np.hypot(2.0, 3.0))
    assert std["amplitude_nm"] == pytest.approx(np.hypot(sine, cosine).std(), rel=0.02)
    assert TorqueOffset(1).report(theta[:1], covariance[:1, :1])[1] == {"offset_nm": pytest.approx(0.2)}


def test_the_library_says_what_each_effect_is():
    names = {"sign_reversed", "joint_reversed", "axes_swapped", "angles_coupled", "zero_convention", "current_rms_peak"}
    assert set(MISTAKES) == names
    assert {"velocity_friction", "load_dependent_friction"} == FRICTION
    assert {"balancer_spring", "link_mass", "base_tilt"} <= DRAWN
    assert not DRAWN & FRICTION
    for name, effect in LIBRARY.items():
        assert effect.name == name
        assert effect.words
        assert effect.meaning
        assert effect.parameters or effect.mistake
