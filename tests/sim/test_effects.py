"""Effects in the simulated arm against the formulas of their definitions."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from sim.effects import LIBRARY, OFF_LIBRARY, EffectError, apply_effects, effect_from_dict
from sim.offline import point_jacobian, reading, statics, transmitted
from sim.plant import Payload, nominal_plant
from sim.urdf import SimChain, read_chain

Q = np.array([0.4, -0.3, 0.5, 0.7, -0.9, 0.2])

EXAMPLES = {
    "static_friction": ([3], {"bias_nm": 2.0}),
    "load_dependent_friction": ([2], {"coefficient": 0.05}),
    "velocity_friction": ([1], {"coulomb_nm": 3.0, "viscous_nm_s_rad": 1.0}),
    "base_tilt": ([], {"tilt_x_rad": 0.02, "tilt_y_rad": -0.01}),
    "joint_zero_offset": ([2], {"offset_rad": 0.03}),
    "torque_constant_scale": ([2], {"scale": 1.1}),
    "torque_offset": ([5], {"offset_nm": 1.5}),
    "thermal_drift": ([2], {"per_s": 1e-4}),
    "balancer_spring": ([2], {"stiffness_n_m": 2e4}),
    "cable_torque": ([6], {"stiffness_nm_rad": 3.0}),
    "joint_elasticity": ([3], {"compliance_rad_nm": 1e-5}),
    "torque_ripple": ([4], {"amplitude_nm": 2.0, "per_revolution": 100.0}),
    "axis_coupling": ([5, 6], {"coefficient": 0.4}),
    "link_mass": ([3], {"mass_kg": 10.0}),
    "payload_shift": ([], {"shift_m": [0.02, 0.0, 0.0], "time_s": 5.0}),
    "sign_reversed": ([4], {}),
    "axes_swapped": ([2, 3], {}),
    "current_rms_peak": ([2], {}),
}


URDF = Path(__file__).parents[2] / "examples" / "large" / "robot.urdf"


@pytest.fixture(scope="module")
def chain() -> SimChain:
    return read_chain(URDF.read_text(encoding="utf-8"), "large")


def plant_of_links(chain: SimChain, **stated):
    bodies = [body for body in chain.bodies if body is not None]
    return nominal_plant(
        np.array([b.mass_kg for b in bodies]),
        np.array([b.com_m for b in bodies]),
        np.array([b.inertia_kg_m2 for b in bodies]),
        **stated,
    )


@pytest.fixture(scope="module")
def plant(chain: SimChain):
    return plant_of_links(chain, payload=Payload("tool", 50.0, np.array([0.05, 0.02, 0.1])))


def seen(chain: SimChain, plant, q=Q, time_s: float = 0.0):
    now = plant.at(time_s)
    tau, _ = transmitted(chain, now, q, time_s)
    return reading(now, q, tau)


def build(plant, name: str, chain: SimChain):
    joints, parameters = EXAMPLES[name]
    return effect_from_dict({"name": name, "joints": joints, "parameters": parameters}, point_jacobian(chain))(plant)


def test_every_effect_of_the_library_has_an_example():
    assert set(EXAMPLES) == set(LIBRARY)


@pytest.mark.parametrize("name", sorted(LIBRARY))
def test_effect_changes_the_plant_and_leaves_the_first_one_alone(name, plant, chain):
    before = seen(chain, plant)
    changed = build(plant, name, chain)
    assert changed is not plant
    np.testing.assert_array_equal(seen(chain, plant), before)


def test_base_tilt_turns_gravity_back(plant, chain):
    gravity = build(plant, "base_tilt", chain).gravity_m_s2
    # a base turned by (x, y) sees gravity lean by y along x and by -x along y, to first order
    np.testing.assert_allclose(gravity, 9.80665 * np.array([-0.01, -0.02, -1.0]), atol=3e-3)
    assert np.linalg.norm(gravity) == pytest.approx(9.80665)


def test_zero_offset_reads_the_torque_of_the_shifted_joint(plant, chain):
    shifted = Q + np.array([0, 0.03, 0, 0, 0, 0])
    np.testing.assert_allclose(
        seen(chain, build(plant, "joint_zero_offset", chain)), statics(chain, plant, shifted[None])[0]
    )


def test_scale_is_true_over_stored(plant, chain):
    expected = seen(chain, plant) * [1, 1 / 1.1, 1, 1, 1, 1]
    np.testing.assert_allclose(seen(chain, build(plant, "torque_constant_scale", chain)), expected, rtol=1e-12)


def test_common_scale_acts_on_all_axes(plant):
    changed = effect_from_dict({"name": "torque_constant_scale", "joints": [], "parameters": {"scale": 0.9}})(plant)
    np.testing.assert_allclose(changed.torque_constant_scale, 0.9)


def test_spring_is_the_slope_of_its_energy(plant, chain):
    changed = build(plant, "balancer_spring", chain)
    lever, anchor, free, stiffness = 0.2, 0.7, 0.4, 2e4

    def energy(q2: float) -> float:
        length = math.sqrt(lever**2 + anchor**2 - 2 * lever * anchor * math.cos(q2))
        return 0.5 * stiffness * (length - free) ** 2

    slope = (energy(Q[1] + 1e-6) - energy(Q[1] - 1e-6)) / 2e-6
    relief = seen(chain, plant) - seen(chain, changed)
    np.testing.assert_allclose(relief, [0, -slope, 0, 0, 0, 0], rtol=1e-6, atol=1e-6)


def test_gas_spring_stiffens(plant):
    gas = {"stiffness_n_m": 1e4, "gas_length_m": 0.6}
    changed = effect_from_dict({"name": "balancer_spring", "joints": [2], "parameters": gas})(plant)
    assert changed.passive_torque is not None
    torques = [changed.passive_torque(np.array([0, q, 0, 0, 0, 0]), 0.0, np.zeros(6))[1] for q in (0.0, 0.3, -0.3)]
    assert torques[0] == 0.0
    assert torques[1] == pytest.approx(-torques[2])
    assert torques[1] < 0


def test_cable_resists_winding(plant, chain):
    difference = seen(chain, build(plant, "cable_torque", chain)) - seen(chain, plant)
    np.testing.assert_allclose(difference, [0, 0, 0, 0, 0, 3.0 * Q[5]], atol=1e-9)


def test_elastic_joint_rests_at_the_wound_up_angle(plant, chain):
    changed = build(plant, "joint_elasticity", chain)
    tau, q = transmitted(chain, changed, Q, 0.0)
    np.testing.assert_allclose(q, Q - 1e-5 * tau * np.array([0, 0, 1, 0, 0, 0]), atol=1e-9)
    np.testing.assert_allclose(tau, statics(chain, changed, q[None])[0], rtol=1e-6)


def test_coupled_axis_shows_the_other_ones_torque(plant, chain):
    before = seen(chain, plant)
    np.testing.assert_allclose(seen(chain, build(plant, "axis_coupling", chain))[4], before[4] + 0.4 * before[5])


def test_link_mass_adds_a_body(plant, chain):
    changed = build(plant, "link_mass", chain)
    assert changed.link_mass_kg[2] == pytest.approx(plant.link_mass_kg[2] + 10.0)
    moment = {"mass_kg": 0.0, "first_moment_kg_m": [1.0, 0.0, 0.0]}
    shifted = effect_from_dict({"name": "link_mass", "joints": [4], "parameters": moment})(plant)
    np.testing.assert_allclose(
        shifted.link_mass_kg[3] * shifted.link_com_m[3], plant.link_mass_kg[3] * plant.link_com_m[3] + [1.0, 0, 0]
    )


def test_payload_jumps_at_its_time(plant, chain):
    changed = build(plant, "payload_shift", chain)
    np.testing.assert_allclose(changed.at(4.9).payload.com_m, plant.payload.com_m)
    np.testing.assert_allclose(changed.at(5.0).payload.com_m, plant.payload.com_m + [0.02, 0, 0])


def test_drift_grows_with_time_and_with_temperature(plant, chain):
    changed = build(plant, "thermal_drift", chain)
    assert seen(chain, changed, time_s=1000.0)[1] == pytest.approx(1.1 * seen(chain, plant)[1])
    warm = effect_from_dict({"name": "thermal_drift", "joints": [2], "parameters": {"per_k": 0.01}})(plant)
    assert warm.temperature_c is not None
    rise = warm.temperature_c(1e5)[1] - warm.temperature_c(0.0)[1]
    assert seen(chain, warm, time_s=1e5)[1] == pytest.approx((1 + 0.01 * rise) * seen(chain, plant)[1])


def test_mistakes_change_the_reading_alone(plant, chain):
    before = seen(chain, plant)
    np.testing.assert_allclose(seen(chain, build(plant, "sign_reversed", chain)), before * [1, 1, 1, -1, 1, 1])
    np.testing.assert_allclose(seen(chain, build(plant, "current_rms_peak", chain))[1], math.sqrt(2) * before[1])
    np.testing.assert_allclose(seen(chain, build(plant, "axes_swapped", chain)), before[[0, 2, 1, 3, 4, 5]])


def test_a_constant_pull_does_work_along_the_path_of_its_point(plant, chain):
    force = [10.0, -5.0, 3.0]
    hose = {"name": "world_hose", "joints": [4], "parameters": {"force_n": force, "point_m": [0.1, 0.0, 0.0]}}
    changed = effect_from_dict(hose, point_jacobian(chain))(plant)
    assert changed.passive_torque is not None
    jacobian = point_jacobian(chain)
    step = 1e-6 * np.array([1.0, -1.0, 0.5, 0.3, 0.2, 0.1])
    moved = jacobian(Q + step, 3, np.array([0.1, 0, 0]))[0] - jacobian(Q - step, 3, np.array([0.1, 0, 0]))[0]
    assert changed.passive_torque(Q, 0.0, np.zeros(6)) @ (2 * step) == pytest.approx(moved @ force, rel=1e-5)


@pytest.mark.parametrize("name", sorted(set(OFF_LIBRARY) - {"world_hose", "bungee"}))
def test_off_library_effect_acts(name, plant, chain):
    parameters = {"amplitude_nm": 5.0, "stiffness_nm_rad2": 5.0, "stiffness_nm": 5.0, "angle_rad": -2.0}
    parameters |= {"coefficient": 0.1, "reference_nm": 100.0}
    changed = effect_from_dict({"name": name, "joints": [2], "parameters": parameters})(plant)
    assert np.abs(seen(chain, changed) - seen(chain, plant)).max() > 0.01


@pytest.mark.parametrize(
    ("effect", "word"),
    [
        ({"name": "ghost"}, "unknown effect"),
        ({"name": "torque_offset", "joints": [9], "parameters": {"offset_nm": 1.0}}, "joints"),
        ({"name": "torque_offset", "joints": [], "parameters": {"offset_nm": 1.0}}, "one joint"),
        ({"name": "torque_offset", "joints": [1], "parameters": {}}, "offset_nm"),
        ({"name": "torque_constant_scale", "joints": [1], "parameters": {"scale": -1.0}}, "positive"),
        ({"name": "axis_coupling", "joints": [5], "parameters": {"coefficient": 1.0}}, "two joints"),
        ({"name": "world_hose", "joints": [4], "parameters": {}}, "geometry"),
        ({"name": "balancer_spring", "joints": [3], "parameters": {"stiffness_n_m": 1.0}}, "joint 2"),
    ],
)
def test_what_cannot_be_built_is_refused_by_name(effect, word):
    with pytest.raises(EffectError, match=word):
        effect_from_dict(effect)


def test_a_drift_scales_what_the_other_effects_left(plant, chain):
    drift = {"name": "thermal_drift", "joints": [2], "parameters": {"per_s": 1e-4}}
    scale = {"name": "torque_constant_scale", "joints": [2], "parameters": {"scale": 0.8}}
    for order in ([drift, scale], [scale, drift]):
        changed = apply_effects(plant, order)
        assert seen(chain, changed, time_s=1000.0)[1] == pytest.approx(1.1 / 0.8 * seen(chain, plant)[1])


def test_effects_add_up(plant, chain):
    both = [
        {"name": "torque_offset", "joints": [1], "parameters": {"offset_nm": 4.0}},
        {"name": "cable_torque", "joints": [6], "parameters": {"stiffness_nm_rad": 3.0}},
        {"name": "cable_torque", "joints": [5], "parameters": {"stiffness_nm_rad": 2.0, "shape": "harmonic"}},
    ]
    difference = seen(chain, apply_effects(plant, both)) - seen(chain, plant)
    np.testing.assert_allclose(difference, [4.0, 0, 0, 0, 2.0 * math.sin(Q[4]), 3.0 * Q[5]], atol=1e-9)


def test_couplings_of_one_arm_are_shares_of_what_each_axis_gives_by_itself(plant, chain):
    before = seen(chain, plant)
    driven = plant
    for joints, share in (([2, 3], -0.4), ([3, 4], 0.5), ([2, 4], -0.6)):
        driven = effect_from_dict({"name": "axis_coupling", "joints": joints, "parameters": {"coefficient": share}})(
            driven
        )
    after = seen(chain, driven)
    np.testing.assert_allclose(after[1], before[1] - 0.4 * before[2] - 0.6 * before[3])
    np.testing.assert_allclose(after[2], before[2] + 0.5 * before[3])
    np.testing.assert_allclose(np.delete(after, [1, 2]), np.delete(before, [1, 2]))
