"""Offline tables against PyBullet's inverse dynamics and the formulas of gear and friction."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pybullet
import pytest

from benchmarks.blind.drawn_arm import draw_arm
from benchmarks.blind.drawn_cell import draw_cell
from sim.blind import distance, left_over, strength
from sim.offline import PlannedVisit, Protocol, gravity_columns, half_floor, measure, statics
from sim.plant import Payload
from sim.urdf import read_chain
from tests.sim.test_effects import URDF, plant_of_links

GRAVITY = np.array([0.3, -0.2, -9.7])
QUIET = Protocol(settle=np.zeros(6))


@pytest.fixture(scope="module")
def chain():
    return read_chain(URDF.read_text(encoding="utf-8"), "large")


@pytest.fixture(scope="module")
def plant(chain):
    return plant_of_links(chain, gravity_m_s2=GRAVITY)


@pytest.fixture(scope="module")
def poses():
    return np.random.default_rng(1).uniform(-1.5, 1.5, (20, 6))


def test_statics_agree_with_pybullet(chain, plant, poses):
    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setGravity(*GRAVITY, physicsClientId=client)
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        body = pybullet.loadURDF(str(URDF), useFixedBase=True, flags=flags, physicsClientId=client)
        still = [0.0] * 6
        expected = [
            pybullet.calculateInverseDynamics(body, list(q), still, still, physicsClientId=client) for q in poses
        ]
    finally:
        pybullet.disconnect(client)
    np.testing.assert_allclose(statics(chain, plant, poses), expected, rtol=1e-4, atol=0.02)


def test_columns_are_linear_in_the_first_moments(chain, plant, poses):
    phi = np.concatenate([np.append(m, m * c) for m, c in zip(plant.link_mass_kg, plant.link_com_m, strict=True)])
    np.testing.assert_allclose(gravity_columns(chain, poses, GRAVITY) @ phi, statics(chain, plant, poses), atol=1e-8)


def rows(chain, plant, q, protocol=QUIET, load="none", loads=None, seed=0):
    visits = [PlannedVisit(0, load, 0.0, q)]
    return measure(chain, plant, visits, loads or {}, protocol, np.random.default_rng(seed))


def test_half_sum_is_gravity_and_half_difference_the_band(chain, plant, poses):
    friction = np.array([5.0, 6.0, 4.0, 1.0, 0.8, 0.5])
    rubbing = replace(plant, coulomb_nm=friction, load_friction=np.full(6, 0.05))
    out = rows(chain, rubbing, poses[0])
    tau = statics(chain, plant, poses[:1])[0]
    np.testing.assert_allclose(out["tau_nm"].mean(axis=0), tau, atol=1e-9)
    np.testing.assert_allclose((out["tau_nm"][0] - out["tau_nm"][1]) / 2, friction + 0.05 * np.abs(tau), atol=1e-9)
    np.testing.assert_array_equal(out["dir"], [[1.0] * 6, [-1.0] * 6])


def test_gear_needs_more_driving_and_less_driven_back(chain, plant, poses):
    geared = replace(plant, gear_efficiency=np.full(6, 0.8))
    up, down = rows(chain, geared, poses[0])["tau_nm"]
    tau = statics(chain, plant, poses[:1])[0]
    loaded = np.abs(tau) > 1e-6
    np.testing.assert_allclose(np.maximum(np.abs(up), np.abs(down))[loaded], np.abs(tau)[loaded] / 0.8)
    np.testing.assert_allclose(np.minimum(np.abs(up), np.abs(down))[loaded], np.abs(tau)[loaded] * 0.8)


def test_a_load_is_a_body_on_link_6(chain, plant, poses):
    tool = Payload("tool", 30.0, np.array([0.1, 0.0, 0.2]))
    out = rows(chain, plant, poses[0], load="tool", loads={"tool": tool})
    expected = statics(chain, plant.with_payload(tool), poses[:1])[0]
    np.testing.assert_allclose(out["tau_nm"].mean(axis=0), expected, atol=1e-9)


def test_swapped_drives_report_each_others_position_and_torque(chain, plant, poses):
    order = np.array([0, 2, 1, 3, 4, 5])
    out = rows(chain, replace(plant, drive_joint=order), poses[0])
    actual = poses[0][order]
    np.testing.assert_allclose(out["tau_nm"][0], statics(chain, plant, actual[None])[0][order], atol=1e-9)
    np.testing.assert_allclose(out["q_rad"][0], poses[0])


def test_asymmetry_that_is_left_has_the_stated_size(chain, plant, poses):
    protocol = Protocol(settle=np.full(6, 0.5), samples=100)
    rubbing = replace(plant, coulomb_nm=np.full(6, 10.0), reading_noise_nm=np.full(6, 5.0))
    visits = [PlannedVisit(k, "none", 0.0, poses[0]) for k in range(600)]
    out = measure(chain, rubbing, visits, {}, protocol, np.random.default_rng(3))
    half = (out["tau_nm"][::2] + out["tau_nm"][1::2]) / 2
    np.testing.assert_allclose(half.std(axis=0), half_floor(rubbing, protocol), rtol=0.1)


def test_secondary_encoder_shows_the_wind_up(chain, plant, poses):
    soft = replace(plant, compliance_rad_nm=np.array([0, 1e-5, 0, 0, 0, 0]))
    out = rows(chain, soft, poses[0], replace(QUIET, secondary_encoder=True))
    bend = out["q2nd_rad"][0] - out["q_rad"][0]
    np.testing.assert_allclose(bend, -soft.compliance_rad_nm * statics(chain, soft, out["q2nd_rad"][:1])[0], rtol=1e-4)


def test_forty_visits_take_no_time(chain, plant, poses):
    visits = [PlannedVisit(k, "none", 0.0, poses[k % 20]) for k in range(40)]
    measure(chain, plant, visits, {}, QUIET, np.random.default_rng(0))
    begin = time.process_time()
    measure(chain, plant, visits, {}, QUIET, np.random.default_rng(0))
    assert time.process_time() - begin < 0.5


def test_urdf_of_a_drawn_arm_is_wrong_by_a_few_percent():
    arm = draw_arm(np.random.default_rng(5))
    drawn = read_chain(arm.urdf, "drawn")
    off = [b.mass_kg / t.mass_kg - 1 for b, t in zip(drawn.bodies, arm.chain.bodies, strict=True) if b and t]
    assert 0.01 < np.std(off) < 0.1
    np.testing.assert_allclose(drawn.placement, arm.chain.placement, atol=1e-9)


@pytest.mark.slow
def test_a_seed_gives_the_same_cell_and_strength_scales():
    first, second = draw_cell(14), draw_cell(14)
    np.testing.assert_array_equal(first.measure(first.visits)["tau_nm"], second.measure(second.visits)["tau_nm"])
    assert first.truth == second.truth
    zero = {"name": "joint_zero_offset", "joints": [2]}
    weak, strong = (
        strength(left_over(first.arm, first.visits, zero | {"parameters": {"offset_rad": size}}))
        for size in (0.001, 0.01)
    )
    assert strong == pytest.approx(10 * weak, rel=0.05)


def test_a_uniform_offset_has_the_strength_of_its_part_off_the_base():
    cell = draw_cell(3)
    size = 10 * float(cell.arm.floor_nm[0])
    offset = {"name": "torque_offset", "joints": [1], "parameters": {"offset_nm": size}}
    # axis 1 is vertical: no link or load can take an offset over
    assert strength(left_over(cell.arm, cell.visits, offset)) == pytest.approx(10.0, rel=0.05)
    # the bias of friction can: one unknown b in n rows, of unit variance as the rows
    n, bias = len(cell.visits), 0.1 * float(cell.arm.plant.coulomb_nm[0] / cell.arm.floor_nm[0])
    expected = 10.0 * np.sqrt(n / (1.0 + n * bias**2))
    assert distance(left_over(cell.arm, cell.visits, offset, 0.03, 0.1)) == pytest.approx(expected, rel=0.02)
