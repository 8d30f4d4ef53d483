"""The arm's physics against pinocchio's inverse dynamics and closed forms; what the plant's fields do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from scipy.signal import butter, filtfilt

from sim.build_errors import with_build_errors
from sim.cellfile import read_cell
from sim.friction import STRIBECK_RAD_S
from sim.nominal import plant_of
from sim.physics import ArmWorld, physical_chain
from sim.plant import Payload
from sim.urdf import write_chain
from tests.sim.conftest import EXAMPLES
from tests.support.rigs.worlds import moved

G = 9.80665
CHAINS = {name: read_cell(EXAMPLES / name / "cell.toml").arms[0].chain for name in ("large", "small")}


def oracle(world: ArmWorld, name="small", gravity=(0.0, 0.0, -G)) -> pinocchio.Model:
    """Pinocchio's model of the nominal chain; the payload is added by pinocchio, not by the simulator."""
    plant = world.plant
    bare = physical_chain(CHAINS[name], plant.with_payload(Payload()))
    limits = np.full(6, 10.0)
    chain = replace(bare, lower_rad=-limits, upper_rad=limits, effort_nm=limits, velocity_rad_s=limits)
    model = pinocchio.buildModelFromXML(write_chain(chain))
    load = plant.payload
    if load.mass_kg:
        model.inertias[6] += pinocchio.Inertia(load.mass_kg, load.com_m, load.inertia_kg_m2)
    model.gravity.linear = np.array(gravity)
    return model


def needed(model: pinocchio.Model, q: np.ndarray) -> np.ndarray:
    return pinocchio.rnea(model, model.createData(), q, np.zeros(6), np.zeros(6))


def release(world: ArmWorld) -> None:
    for axis in world.axes:
        axis.release()


LOADS = {
    "large": Payload("l", 70.0, np.array([0.05, -0.02, 0.22]), np.diag([1.5, 1.2, 0.9])),
    "small": Payload("s", 6.0, np.array([0.02, 0.01, 0.10]), np.diag([0.02, 0.02, 0.01])),
}
POSE = np.array([0.4, 0.3, -0.5, 0.7, -0.9, 1.1])


@pytest.mark.parametrize("name", ["large", "small"])
def test_holding_torque_is_that_of_inverse_dynamics_bare_and_loaded(name, world_of):
    world = world_of(name, zero_offset_rad=np.zeros(6))
    release(world)
    shift = np.array([axis.shift_rad for axis in world.axes])
    moved(world, POSE - shift, 3.0)
    world.advance(4000)
    for payload in (Payload(), LOADS[name]):
        world.mount(payload)
        world.advance(4000)
        assert np.abs(world.qd_rad_s).max() < 1e-5
        expected = needed(oracle(world, name), world.q_rad)
        np.testing.assert_allclose(world.joint_torque_nm(), expected, atol=2e-4 * np.abs(expected).max())
        np.testing.assert_allclose(world.reading_nm(), expected, atol=2e-4 * np.abs(expected).max())
        np.testing.assert_allclose(world.q_rad, POSE, atol=2e-4)


def test_moving_torque_is_that_of_inverse_dynamics(world_of):
    """Links fall freely from rest, with small rotors: acceleration of the first steps by pinocchio."""
    world = world_of("small", rotor_inertia_kg_m2=np.full(6, 1e-3))
    model = oracle(world)
    model.armature = world.plant.rotor_inertia_kg_m2
    for axis in world.axes:
        axis.free = True
    world.advance(20)
    fall = pinocchio.aba(model, model.createData(), np.zeros(6), np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(world.qd_rad_s / 0.02, fall, rtol=0.02, atol=0.05)


def test_an_arm_in_its_brakes_rests_and_shows_no_torque(world_of):
    world = world_of("large")
    before = world.q_rad
    world.advance(500)
    world.mount(LOADS["large"])
    world.advance(500)
    np.testing.assert_allclose(world.q_rad, before, atol=1e-9)
    np.testing.assert_allclose(world.reading_nm(), 0.0)


def test_tilted_gravity_springs_and_offsets_act_as_the_plant_says(world_of):
    gravity = np.array([0.3, -0.2, -9.79])
    spring = np.array([0.0, 12.0, 0.0, 0.0, 1.5, 0.0])
    offset = np.array([0.5, 0.0, -1.0, 0.0, 0.2, 0.0])
    scale = np.array([1.0, 1.05, 0.95, 1.0, 1.0, 1.0])
    world = world_of(
        "small",
        gravity_m_s2=gravity,
        passive_torque=lambda q, time_s, tau: spring,
        reading_offset_nm=offset,
        torque_constant_scale=scale,
        torque_sign=np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0]),
        current_factor=np.array([1.0, 1.0, np.sqrt(2.0), 1.0, 1.0, 1.0]),
    )
    release(world)
    world.advance(6000)
    tau = needed(oracle(world, gravity=gravity), world.q_rad) - spring
    np.testing.assert_allclose(world.joint_torque_nm(), tau, atol=0.01)
    factor = np.array([1.0, 1.0, np.sqrt(2.0), 1.0, 1.0, 1.0])
    expected = (tau * factor / scale + offset) * [1, 1, 1, 1, -1, 1]
    np.testing.assert_allclose(world.reading_nm(), expected, atol=0.02)


def test_encoders_see_neither_zero_offset_nor_wind_up(world_of):
    zero, compliance = np.array([0, 0.01, -0.02, 0, 0.03, 0]), np.full(6, 2e-5)
    world = world_of("small", zero_offset_rad=zero, compliance_rad_nm=compliance)
    release(world)
    world.advance(6000)
    reported = np.array([axis.position_rad for axis in world.axes])
    cell_zero = np.array([0, 0.02, 0, 0, -0.015, 0])
    tau = world.joint_torque_nm()
    np.testing.assert_allclose(world.q_rad, reported + cell_zero + zero - compliance * tau, atol=1e-7)
    assert np.abs(compliance * tau).max() > 5e-4


def test_a_coupled_wrist_carries_the_torque_of_its_transpose(arm_of, world_of):
    coupling = np.eye(6)
    coupling[5, 4] = 0.3
    arm = replace(arm_of("small"), coupling=coupling)
    world = world_of("small", arm)
    release(world)
    goal = np.zeros(6)
    goal[[1, 2, 4]] = 0.2, -0.4, 0.9
    moved(world, coupling @ goal, 2.0)
    world.advance(5000)
    tau = needed(oracle(world), world.q_rad)
    motors = np.array([axis.torque_nm for axis in world.axes])
    np.testing.assert_allclose(coupling.T @ motors, tau, atol=0.01)
    np.testing.assert_allclose(world.reading_nm(), np.linalg.solve(coupling.T, tau), atol=0.02)


def test_a_payload_that_moves_is_followed(world_of):
    world = world_of("small", payload_shift=lambda time_s: np.array([0.0, 0.0, 0.1 if time_s > 1.0 else 0.0]))
    world.mount(LOADS["small"])
    release(world)
    world.advance(6000)
    shifted = replace(LOADS["small"], com_m=LOADS["small"].com_m + [0.0, 0.0, 0.1])
    model = oracle(world)
    model.inertias[6] -= pinocchio.Inertia(6.0, LOADS["small"].com_m, LOADS["small"].inertia_kg_m2)
    model.inertias[6] += pinocchio.Inertia(6.0, shifted.com_m, shifted.inertia_kg_m2)
    np.testing.assert_allclose(world.joint_torque_nm(), needed(model, world.q_rad), atol=0.05)


@pytest.mark.parametrize("name", ["large", "small"])
def test_after_a_slow_approach_the_torque_is_near_the_edge_of_its_side(name, arm_of, world_of):
    """Both sides: the edge is eta u = tau + F or u = eta (tau - F); half the sum is gravity, some asymmetry is left."""
    from sim.nominal import plant_of

    plant = plant_of(arm_of(name))
    world = world_of(
        name, **{field: getattr(plant, field) for field in plant.__slots__ if not field.startswith(("link", "reading"))}
    )
    release(world)
    world.advance(500)
    shift = np.array([axis.shift_rad for axis in world.axes])
    efficiency, edges, converted, gravity = plant.gear_efficiency, [], [], []
    for direction in (1.0, -1.0):
        moved(world, POSE - shift - 0.03 * direction, 2.0)
        moved(world, POSE - shift, 1.5)
        world.advance(3000)
        u, tau = np.array([axis.servo.u_nm for axis in world.axes]), world.joint_torque_nm()
        behind = np.where(u * direction > 0, u * efficiency, u / efficiency)
        edges.append((behind - tau) * direction / plant.coulomb_nm)
        converted.append(behind)
        gravity.append(tau)
    assert np.median(edges) == pytest.approx(1.0, abs=0.2)
    assert not np.allclose(edges, 1.0, atol=1e-3)
    left = (np.sum(converted, axis=0) - np.sum(gravity, axis=0)) / 2.0 / plant.coulomb_nm
    assert np.sqrt(np.mean(left**2)) < 0.3


def test_time_is_that_of_the_steps(world_of):
    world = world_of("small")
    world.advance(37)
    assert world.time_s == pytest.approx(0.037)


def test_an_arm_whose_inertia_bullet_rounds_badly_is_built_all_the_same(arm_of, capfd):
    arm = arm_of("large")
    world = ArmWorld(arm, with_build_errors(plant_of(arm), arm.chain, 5), 5)
    try:
        assert np.isfinite(world.joint_torque_nm()).all()
    finally:
        world.close()
    assert "b3Error" not in capfd.readouterr().out


@pytest.mark.parametrize("name", ["large", "small"])
def test_motor_torque_in_motion_is_dynamics_rotor_friction_and_gear(name, arm_of, world_of):
    """A swing of all axes from rest to rest, streamed every 4 ms: rigid body by pinocchio, the rest in closed form."""
    nominal = plant_of(arm_of(name))
    lossy = ("coulomb_nm", "stiction_nm", "viscous_nm_s_rad", "gear_efficiency", "rotor_inertia_kg_m2")
    world = world_of(name, load_friction=np.full(6, 0.05), **{field: getattr(nominal, field) for field in lossy})
    world.mount(LOADS[name])
    plant, period_s = world.plant, 3.0
    speed = np.array([axis.servo.max_rad_s for axis in world.axes]) / 3.0
    start = np.array([axis.position_rad for axis in world.axes])
    release(world)
    rows = []
    for tick in range(0, round(1000 * period_s), 4):
        turn = 2.0 * np.pi * (tick + 4) / 1000.0 / period_s
        goal = start + 0.4 * speed * period_s / (2.0 * np.pi) * (1.0 - np.cos(turn))
        for axis, target in zip(world.axes, goal.tolist(), strict=True):
            axis.servo.reference_step_rad = (target - axis.servo.reference_rad) / 4
        for _ in range(4):
            world.advance(1)
            rows.append([world.q_rad, [axis.servo.u_nm for axis in world.axes]])
    smooth = butter(3, 15.0, fs=1000.0)
    q, motor = (filtfilt(*smooth, part, axis=0) for part in np.array(rows).transpose(1, 0, 2))
    qd = np.gradient(q, 0.001, axis=0)
    qdd = filtfilt(*smooth, np.gradient(qd, 0.001, axis=0), axis=0)
    model = oracle(world, name)
    data = model.createData()
    away = np.abs(np.arange(len(q)) - 1500) > 200  # the swing turns back there
    away[:300] = away[-300:] = False
    rigid = np.array(
        [pinocchio.rnea(model, data, *row).copy() for row in zip(q[away], qd[away], qdd[away], strict=True)]
    )
    qd, qdd, motor = qd[away], qdd[away], motor[away]
    excess_nm = (plant.stiction_nm - plant.coulomb_nm) * STRIBECK_RAD_S / (STRIBECK_RAD_S + np.abs(qd))
    band = plant.coulomb_nm + excess_nm + plant.load_friction * np.abs(rigid)
    behind = rigid + np.sign(qd) * band + plant.viscous_nm_s_rad * qd + plant.rotor_inertia_kg_m2 * qdd
    expected = np.where(behind * qd > 0, behind / plant.gear_efficiency, behind * plant.gear_efficiency)
    scale = np.sqrt((expected**2).mean(axis=0))
    assert (np.sqrt(((motor - expected) ** 2).mean(axis=0)) < 0.01 * scale).all()
    assert (np.abs(plant.rotor_inertia_kg_m2 * qdd).max(axis=0) > 0.02 * scale).all()


def test_a_torque_that_is_read_at_every_set_point_holds_what_rotors_take(world_of):
    """Speed is fed forward in steps: the torque swings in step with the setpoints, its reading does not."""
    by_milliseconds, at_once = swung(world_of("small"), 1), swung(world_of("small"), 10)
    accelerates = np.cos(2.0 * np.pi * np.arange(10, 2010, 10) / 2000.0)[20:]
    rotor = world_of("small").plant.rotor_inertia_kg_m2 * 0.15 * np.pi**2
    off = (at_once - by_milliseconds)[20:].T @ accelerates / (accelerates @ accelerates)
    assert (np.abs(off) < 0.05 * rotor).all()


def swung(world: ArmWorld, ticks: int) -> np.ndarray:
    """Mean reading between setpoints 10 ms apart of a swing of 2 s, read every so many milliseconds."""
    release(world)
    start, read = np.array([axis.position_rad for axis in world.axes]), []
    for tick in range(0, 2000, 10):
        goal = start + 0.15 * (1.0 - np.cos(2.0 * np.pi * (tick + 10) / 2000.0))
        for axis, target in zip(world.axes, goal.tolist(), strict=True):
            axis.servo.reference_step_rad = (target - axis.servo.reference_rad) / 10
        torques = []
        for _ in range(10 // ticks):
            world.advance(ticks)
            torques.append(world.reading_nm())
        read.append(np.mean(torques, axis=0))
    return np.array(read)
