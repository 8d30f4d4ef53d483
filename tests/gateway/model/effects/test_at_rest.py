"""Each effect of the model against the simulated arm, where the same effect is built from its mechanism."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.drawn_arm import draw_arm
from gateway.model.effect import RestSetup
from gateway.model.effects import LIBRARY, terms_at_rest
from gateway.model.effects.axis_coupling import TorqueMixing
from gateway.model.effects.balancer_spring import USUAL_FREE, CoilBalancer, GasBalancer
from gateway.model.effects.base_tilt import BaseTilt
from gateway.model.effects.cable_torque import HarmonicCable, LinearCable
from gateway.model.effects.joint_elasticity import JointElasticity
from gateway.model.effects.joint_zero_offset import JointZeroOffset
from gateway.model.effects.link_mass import LinkMass
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.payload_shift import PayloadShift
from gateway.model.effects.thermal_drift import ThermalDrift
from gateway.model.effects.torque_constant_scale import TorqueConstantScale
from gateway.model.effects.torque_offset import TorqueOffset
from gateway.model.effects.torque_ripple import TorqueRipple
from gateway.model.regressor import gravity_regressor
from gateway.model.rest import Model, neutral
from gateway.model.robot import Robot, robot_from_urdf
from gateway.model.unnamed import unnamed_terms
from gateway.model.visits import Gears, Visits
from sim.draw import DrawnArm, choose_poses
from sim.effects import effect_from_dict
from sim.offline import PlannedVisit, Protocol, measure, point_jacobian
from sim.urdf import write_chain

STEP_S = 30.0


@pytest.fixture(scope="module")
def arm() -> DrawnArm:
    arm = draw_arm(np.random.default_rng(21))
    return replace(arm, plant=replace(arm.plant, gear_efficiency=np.full(6, 0.85), temperature_c=None))


@pytest.fixture(scope="module")
def robot(arm: DrawnArm) -> Robot:
    return robot_from_urdf(write_chain(arm.chain), "true")


@pytest.fixture(scope="module")
def visits(arm: DrawnArm) -> list[PlannedVisit]:
    poses = choose_poses(arm.chain, arm.floor_nm, arm.prior_std, 6, np.random.default_rng(2))
    bare = [PlannedVisit(k, "none", STEP_S * k, q) for k, q in enumerate(poses)]
    return bare + [PlannedVisit(k, "tool", 500.0 + STEP_S * k, q) for k, q in enumerate(poses)]


def halves(arm: DrawnArm, plant, visits: list[PlannedVisit]) -> tuple[np.ndarray, np.ndarray]:
    """Half sums and differences of a quiet measurement, each side through the gear by its own direction."""
    protocol = Protocol(settle=np.zeros(6), side_time_s=0.0)
    still = replace(plant, reading_noise_nm=np.zeros(6))
    columns = measure(arm.chain, still, visits, arm.loads, protocol, np.random.default_rng(0))
    eta = plant.gear_efficiency
    sides = []
    for side, direction in ((slice(0, None, 2), 1.0), (slice(1, None, 2), -1.0)):
        motor = columns["tau_nm"][side]
        sides.append(np.where(motor * direction > 0, motor * eta, motor / eta))
    return (sides[0] + sides[1]) / 2, (sides[0] - sides[1]) / 2


@pytest.fixture(scope="module")
def rows(arm: DrawnArm, visits: list[PlannedVisit]) -> Visits:
    half_sum, difference = halves(arm, arm.plant, visits)
    n = len(visits)
    return Visits(
        load=np.array([visit.load for visit in visits]),
        pose=np.array([visit.pose for visit in visits]),
        run=np.full(n, "r"),
        time_s=np.array([visit.time_s for visit in visits]),
        q_rad=np.array([visit.q_rad for visit in visits]),
        sum_nm=half_sum,
        difference_nm=difference,
        side=np.zeros((n, 6)),
        two_sided=np.ones(n, dtype=bool),
        sample_std_nm=np.full((n, 6), np.nan),
        temperature_c=np.full((n, 6), np.nan),
        wind_up_rad=np.full((n, 6), np.nan),
        gear_nm=np.zeros((n, 6)),
        where=np.full(n, "r"),
        rows=np.zeros((n, 2), dtype=int),
        gears=Gears(arm.plant.gear_efficiency),
    )


@pytest.fixture(scope="module")
def model(robot: Robot, rows: Visits) -> Model:
    return Model(robot, rows, np.array([0.0, 0.0, -9.80665]))


@pytest.fixture(scope="module")
def bodies(arm: DrawnArm, rows: Visits) -> tuple[np.ndarray, np.ndarray]:
    """True link parameters (24,) and loads (n, 4)."""
    links = np.concatenate(
        [np.append(m, m * c) for m, c in zip(arm.plant.link_mass_kg, arm.plant.link_com_m, strict=True)]
    )
    tool = arm.loads["tool"]
    return links, (rows.load == "tool")[:, None] * tool.mass_kg * np.append(1.0, tool.com_m)


def test_without_effects_model_and_simulated_arm_agree(arm, model, rows, bodies):
    said = model.predict(neutral(len(rows), 6), *bodies, arm.plant.coulomb_nm)
    np.testing.assert_allclose(said.sum_nm, rows.sum_nm, atol=1e-6)
    np.testing.assert_allclose(said.difference_nm, rows.difference_nm, atol=1e-6)


KAB, RHO, L0 = 2.0e4 * 0.2 * 0.7, 2 * 0.2 * 0.7 / (0.2**2 + 0.7**2), 0.4 / np.hypot(0.2, 0.7)
CASES = [
    (LoadDependentFriction(2), [0.06], "load_dependent_friction", [3], {"coefficient": 0.06}),
    (BaseTilt(), [0.03, -0.02], "base_tilt", [], {"tilt_x_rad": 0.03, "tilt_y_rad": -0.02}),
    (JointZeroOffset(4), [0.05], "joint_zero_offset", [5], {"offset_rad": 0.05}),
    (TorqueConstantScale(1), [0.25], "torque_constant_scale", [2], {"scale": 0.8}),
    (TorqueConstantScale(None), [0.25], "torque_constant_scale", [], {"scale": 0.8}),
    (TorqueOffset(3), [2.0], "torque_offset", [4], {"offset_nm": 2.0}),
    (ThermalDrift(2), [2e-4], "thermal_drift", [3], {"per_s": 2e-4}),
    (ThermalDrift(2, on="friction"), [2e-4], "thermal_drift", [3], {"per_s": 2e-4, "on": "friction"}),
    (
        CoilBalancer(),
        [KAB, KAB * (USUAL_FREE - L0), 0.0, np.log(RHO / (1 - RHO))],
        "balancer_spring",
        [2],
        {"stiffness_n_m": 2e4, "lever_m": 0.2, "anchor_m": 0.7, "free_length_m": 0.4},
    ),
    (
        GasBalancer(),
        [1e4 * 0.6 / 1.3 * 0.2 * 0.7 / np.hypot(0.2, 0.7), 0.0, np.log(RHO / (1 - RHO)), np.log(2.0)],
        "balancer_spring",
        [2],
        {"stiffness_n_m": 1e4, "lever_m": 0.2, "anchor_m": 0.7, "gas_length_m": 0.6},
    ),
    (LinearCable(5), [-3.0, 0.6], "cable_torque", [6], {"stiffness_nm_rad": 3.0, "neutral_rad": 0.2}),
    (
        HarmonicCable(4),
        [-2.0, 0.0],
        "cable_torque",
        [5],
        {"stiffness_nm_rad": 2.0, "shape": "harmonic"},
    ),
    (JointElasticity(1), [2e-5], "joint_elasticity", [2], {"compliance_rad_nm": 2e-5}),
    (TorqueRipple(3, 160.0), [1.5, 0.0], "torque_ripple", [4], {"amplitude_nm": 1.5, "per_revolution": 160.0}),
    (TorqueMixing(1, 3), [-0.7], "axis_coupling", [2, 4], {"coefficient": -0.7}),
    (TorqueMixing(2, 3), [0.9], "axis_coupling", [3, 4], {"coefficient": 0.9}),
    (TorqueMixing(4, 5), [0.5], "axis_coupling", [5, 6], {"coefficient": 0.5}),
    (LinkMass(2), [8.0, 1.0, 0.5, -2.0], "link_mass", [3], {"mass_kg": 8.0, "first_moment_kg_m": [1.0, 0.5, -2.0]}),
    (PayloadShift(590.0), [0.02, 0.0, -0.01], "payload_shift", [], {"shift_m": [0.02, 0.0, -0.01], "time_s": 590.0}),
]


@pytest.mark.parametrize(
    ("term", "theta", "name", "joints", "parameters"), CASES, ids=lambda v: getattr(v, "name", None)
)
def test_term_says_what_the_simulated_arm_does(arm, model, rows, visits, bodies, term, theta, name, joints, parameters):
    effect = {"name": name, "joints": joints, "parameters": parameters}
    plant = effect_from_dict(effect, point_jacobian(arm.chain))(arm.plant)
    half_sum, difference = halves(arm, plant, visits)
    setting = term.apply(neutral(len(rows), 6), np.array(theta), rows)
    said = model.predict(setting, *bodies, arm.plant.coulomb_nm)
    size = np.abs(half_sum - rows.sum_nm).max() + np.abs(difference - rows.difference_nm).max()
    assert size > 0.05
    np.testing.assert_allclose(said.sum_nm, half_sum, atol=2e-3 * size)
    np.testing.assert_allclose(said.difference_nm, difference, atol=2e-3 * size)
    assert term.plausible(np.array(theta), rows)


@pytest.mark.parametrize(
    ("term", "theta", "name", "joints", "parameters"), CASES, ids=lambda v: getattr(v, "name", None)
)
def test_term_reports_the_parameters_it_was_built_with(term, theta, name, joints, parameters):
    values, errors = term.report(np.array(theta), np.eye(len(theta)))
    assert term.name == name
    assert list(term.joints) == joints
    shared = [key for key in parameters if key in values and not isinstance(parameters[key], list)]
    assert shared or name in ("payload_shift", "link_mass")
    for key in shared:
        assert values[key] == pytest.approx(parameters[key], rel=2e-3 if name == "balancer_spring" else 1e-6)
    assert set(errors) <= set(values)


def test_stiffness_refers_to_the_stated_reach():
    values, _ = CASES[8][0].report(np.array(CASES[8][1]), np.eye(4))
    # torque gives k a b: with a, b of the stated ratio and reach the product is the same
    product = values["stiffness_n_m"] * values["lever_ratio"] * values["reach_m"] ** 2 / 2
    assert product == pytest.approx(KAB)


def test_gas_stiffness_is_the_slope_of_the_force_at_the_shortest_length(rows):
    """With levers of the stated reach, a torque of `F(l) a b sin / l` at the length l of the rod."""
    theta = np.array([300.0, 0.1, np.log(0.6 / 0.4), np.log(1.5)])
    term = GasBalancer()
    values, _ = term.report(theta, np.eye(4))
    ratio, reach = values["lever_ratio"], values["reach_m"]

    def force(angle: float) -> tuple[float, float]:
        q = rows.q_rad.copy()
        q[:, 1] = angle + values["phase_rad"]
        torque = term.apply(neutral(len(rows), 6), theta, replace(rows, q_rad=q)).passive_nm[0, 1]
        length = reach * np.sqrt(1.0 - ratio * np.cos(angle))
        return length, -torque * length / (ratio / 2.0 * reach**2 * np.sin(angle))

    (near, first), (far, second) = force(1e-3), force(2e-2)
    assert values["stiffness_n_m"] == pytest.approx((second - first) / (far - near), rel=1e-3)
    assert values["gas_stroke"] == pytest.approx(0.6)


def test_payload_shift_reports_its_length():
    values, errors = PayloadShift(5.0).report(np.array([0.03, 0.0, 0.04]), 1e-6 * np.eye(3))
    assert values["shift_m"] == pytest.approx(0.05)
    assert errors["shift_m"] == pytest.approx(1e-3)


def test_every_candidate_is_complete(rows, model, bodies):
    torque, _ = model.joint_torque(neutral(len(rows), 6), model.bodies(neutral(len(rows), 6), *bodies))
    setup = RestSetup((120.0,) * 6, True, torque)
    terms = terms_at_rest(rows, setup) + unnamed_terms(rows, setup)
    assert len(set(terms)) == len(terms)
    for term in terms:
        count = len(term.linear)
        assert len(term.start) == len(term.spread) == count
        values, std = term.report(np.array(term.start) + 0.5, np.eye(count)) if term.name in LIBRARY else ({}, {})
        assert set(std) <= set(values) <= set(LIBRARY[term.name].parameters if term.name in LIBRARY else ())
        assert all(v == 0.0 for v, linear in zip(term.start, term.linear, strict=True) if linear)


def test_ripple_needs_the_gear_ratio(rows, model, bodies):
    setup = RestSetup((np.nan,) * 6, False, np.ones((len(rows), 6)))
    assert not [term for term in terms_at_rest(rows, setup) if term.name == "torque_ripple"]


def test_couplings_of_a_linkage_add_up_in_any_order(arm, model, rows, visits, bodies):
    """From axis 2 to 3, on to 4, and past it: each is a share of what the other axis shows by itself."""
    shares = [((1, 2), -0.4), ((2, 3), 0.5), ((1, 3), -0.6)]
    plant = arm.plant
    for (inner, outer), share in shares:
        entry = {"name": "axis_coupling", "joints": [inner + 1, outer + 1], "parameters": {"coefficient": share}}
        plant = effect_from_dict(entry, point_jacobian(arm.chain))(plant)
    half_sum, difference = halves(arm, plant, visits)
    for order in itertools.permutations(shares):
        setting = neutral(len(rows), 6)
        for pair, share in order:
            setting = TorqueMixing(*pair).apply(setting, np.array([share]), rows)
        said = model.predict(setting, *bodies, arm.plant.coulomb_nm)
        np.testing.assert_allclose(said.sum_nm, half_sum, atol=1e-6)
        np.testing.assert_allclose(said.difference_nm, difference, atol=1e-6)


@pytest.mark.parametrize(
    ("axes", "pairs"),
    [
        (2, []),
        (3, [(2, 3)]),
        (4, [(2, 3), (2, 4), (3, 4)]),
        (6, [(2, 3), (2, 4), (3, 4), (4, 5), (4, 6), (5, 6)]),
    ],
)
def test_axes_that_one_train_may_join(axes, pairs):
    rows = Visits(**{name: np.zeros((3, axes)) for name in Visits.__slots__ if name != "__weakref__"})
    found = LIBRARY["axis_coupling"].at_rest(rows, RestSetup((np.nan,) * axes, False, np.ones((3, axes))))
    assert [term.joints for term in found] == pairs


def test_an_elastic_arm_is_in_equilibrium(robot, model, rows, bodies):
    setting = JointElasticity(1).apply(neutral(len(rows), 6), np.array([5e-5]), rows)
    torque, _ = model.joint_torque(setting, model.bodies(setting, *bodies))
    bent = rows.q_rad - setting.compliance_rad_nm * torque
    everything = model.bodies(setting, *bodies)
    expected = np.einsum("nak,nk->na", gravity_regressor(robot, bent), everything)
    np.testing.assert_allclose(torque, expected, rtol=1e-4, atol=1e-3)


def test_a_one_sided_visit_reads_its_own_side(robot, rows, bodies):
    single = replace(
        rows, two_sided=np.zeros(len(rows), dtype=bool), side=np.ones((len(rows), 6)), gears=Gears(np.ones(6))
    )
    model = Model(robot, single, np.array([0.0, 0.0, -9.80665]))
    plain = model.predict(neutral(len(rows), 6), *bodies, np.zeros(6)).sum_nm
    rubbing = model.predict(neutral(len(rows), 6), *bodies, np.array([0, 0, 4.0, 0, 0, 0])).sum_nm
    np.testing.assert_allclose(rubbing - plain, np.tile([0, 0, 4.0, 0, 0, 0], (len(rows), 1)), atol=1e-9)
