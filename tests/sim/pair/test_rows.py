"""Rows of an arm from its robot file: they are where the file's joints are, with the masses of its links."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim.cellfile import ArmSpec, read_cell
from sim.engine import bullet
from sim.pair.body import load_pair
from sim.pair.cell import pair_units
from sim.pair.geometry import ArmGeometry, tip
from sim.pair.pair_errors import GEAR_STIFFNESS_NM_RAD, draw
from sim.pair.rows import rows_of
from sim.pair.two_arms import STEP_S, TwoArms
from sim.urdf import SimBody, SimChain
from tests.sim.conftest import go, power, reference_arms, torques

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
UNEQUAL = EXAMPLES / "pair-unequal"
ROBOTS = {"large": "large-small.toml", "seven": "seven-six.toml"}


def world_of(file: str, seed: int | None = 0, plant: str = "bullet") -> TwoArms:
    units = pair_units(read_cell(UNEQUAL / file), seed, plant=plant)  # type: ignore[arg-type]
    return units["left"].world


@pytest.fixture
def thirteen() -> Iterator[TwoArms]:
    made = world_of("seven-six.toml")
    yield made
    made.close()


def pose(rotation: np.ndarray, xyz_m: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, xyz_m
    return out


def fingertip(arm: ArmSpec, q: np.ndarray) -> np.ndarray:
    """Fingertip (4, 4) in the world, joint after joint as the robot file places them."""
    frame = arm.base
    for placed, axis, angle in zip(arm.chain.placement, arm.chain.axis, q, strict=True):
        frame = frame @ placed @ pose(Rotation.from_rotvec(axis * angle).as_matrix(), np.zeros(3))
    return frame @ arm.fingertip


def test_the_example_s_arms_are_the_table_to_the_last_bit() -> None:
    for arm, wanted in zip(read_cell(EXAMPLES / "pair" / "cell.toml").arms, reference_arms(), strict=True):
        rows = rows_of(arm)
        for name in ArmGeometry.__slots__:  # type: ignore[attr-defined]
            assert np.array_equal(getattr(rows.geometry, name), getattr(wanted.geometry, name)), name
        for moved, body in zip(rows.bodies, arm.chain.bodies, strict=True):
            assert np.array_equal(moved.com_m, body.com_m)
            assert np.array_equal(moved.inertia_kg_m2, body.inertia_kg_m2)


def test_the_example_s_errors_are_those_of_the_reference_arms() -> None:
    world = pair_units(read_cell(EXAMPLES / "pair" / "cell.toml"), 3)["left"].world
    world.close()
    errors = draw(3, reference_arms())
    for truth, drawn in zip(world.arms, (errors.master, errors.slave), strict=True):
        assert np.array_equal(truth.geometry.alpha_rad, drawn.geometry.alpha_rad)
        assert np.array_equal(truth.geometry.base, drawn.geometry.base)
        assert np.array_equal(truth.train.stiffness_nm_rad, drawn.gear_stiffness_nm_rad)
        assert np.array_equal(truth.train.cyclic_per_rad, drawn.cyclic_per_rev)
        assert len(truth.train.rated_nm) == len(GEAR_STIFFNESS_NM_RAD)


@pytest.mark.parametrize("file", ["large-small.toml", "seven-six.toml", "seven-seven.toml"])
def test_fingertips_stand_where_the_robot_files_put_them(file: str) -> None:
    rng = np.random.default_rng(4)
    for arm in read_cell(UNEQUAL / file).arms:
        for q in rng.uniform(-2.0, 2.0, (5, len(arm.axes))):
            assert tip(rows_of(arm).geometry, q) == pytest.approx(fingertip(arm, q), abs=1e-7)


def drawn_arm(rng: np.random.Generator, like: ArmSpec, axes: int) -> ArmSpec:
    """An arm of the same drives whose joints are anywhere and turn about any axis, two parallel, two on one line."""
    placement = np.array(
        [pose(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.4, 0.4, 3)) for _ in range(axes)]
    )
    axis = rng.standard_normal((axes, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    axis[2] = placement[2, :3, :3].T @ axis[1]
    placement[4, :3, 3], axis[4] = 0.2 * axis[3], placement[4, :3, :3].T @ axis[3]
    bodies = tuple(SimBody(1.0 + i, rng.uniform(-0.1, 0.1, 3), np.diag([0.3, 0.4, 0.5])) for i in range(axes))
    open_ = np.full(axes, np.inf)
    return replace(like, chain=SimChain("drawn", placement, axis, bodies, -open_, open_, open_, open_))


@pytest.mark.parametrize("axes", [6, 7, 8])
def test_an_arm_whose_joints_stand_anywhere_has_rows_too(axes: int) -> None:
    rng = np.random.default_rng(axes)
    like = read_cell(EXAMPLES / "pair" / "cell.toml").arms[1]
    for _ in range(4):
        arm = drawn_arm(rng, like, axes)
        geometry = rows_of(arm).geometry
        for q in rng.uniform(-3.0, 3.0, (3, axes)):
            assert tip(geometry, q) == pytest.approx(fingertip(arm, q), abs=1e-6)


@pytest.mark.parametrize("robot", ROBOTS)
def test_links_weigh_in_the_rows_what_they_weigh_in_the_file(robot: str) -> None:
    """Torques that hold an arm without a part and move it: two branches from rows, and PyBullet's own reading."""
    cell = read_cell(UNEQUAL / ROBOTS[robot])
    cell = replace(cell, pair={**cell.pair, "part_mass_kg": 0.0})
    world = pair_units(cell, None, plant="bullet")["left"].world
    axes = len(cell.arms[0].axes)
    rng = np.random.default_rng(6)
    q, qd, qdd = rng.uniform(-1.5, 1.5, (3, world.joints))
    two = torques(load_pair(world.arms, STEP_S), q, qd, qdd)[:axes]
    client = bullet.connect(bullet.DIRECT)
    bullet.setGravity(0.0, 0.0, -9.80665, physicsClientId=client)
    file, own = str(UNEQUAL / f"{robot}.urdf"), bullet.URDF_USE_INERTIA_FROM_FILE
    body = bullet.loadURDF(file, useFixedBase=True, flags=own, physicsClientId=client)
    motion = [state[:axes].tolist() for state in (q, qd, qdd)]
    alone = np.array(bullet.calculateInverseDynamics(body, *motion, physicsClientId=client))
    bullet.disconnect(physicsClientId=client)
    world.close()
    assert two == pytest.approx(alone, rel=1e-5, abs=1e-3)


def test_a_small_arm_has_gears_as_stiff_as_their_torque_asks_for() -> None:
    """A gear of 240 Nm is between those of 120 Nm, 6e4 Nm/rad, and of 500 Nm, 2.5e5 Nm/rad."""
    world = world_of("large-small.toml", None)
    world.close()
    stiffness = world.arms[1].train.stiffness_nm_rad
    assert stiffness[0] == pytest.approx(6e4 + (2.5e5 - 6e4) * (240.0 - 120.0) / (500.0 - 120.0))
    assert stiffness[5] == pytest.approx(2.5e4 * 24.0 / 60.0)
    assert np.array_equal(world.arms[0].train.stiffness_nm_rad, GEAR_STIFFNESS_NM_RAD)


@pytest.mark.parametrize("roles", [("left", "right"), ("right", "left")], ids=["seven first", "six first"])
def test_thirteen_joints_have_a_deviation_that_differences_agree_with(roles: tuple[str, str]) -> None:
    cell = read_cell(UNEQUAL / "seven-six.toml")
    cell = replace(cell, pair={**cell.pair, "master": roles[0], "slave": roles[1]})
    world = pair_units(cell, 0, plant="light")["left"].world
    world.close()
    part, rng = world.part, np.random.default_rng(1)
    q = world.q + rng.normal(0.0, 1e-3, 13)
    closure = part.at(q)
    assert closure.jacobian.shape == (6, 13)
    for joint, unit in enumerate(np.eye(13)):
        rate = (part.at(q + 1e-6 * unit).deviation - part.at(q - 1e-6 * unit).deviation) / 2e-6
        assert np.abs(rate - closure.jacobian[:, joint]).max() < 2e-3


def test_errors_are_drawn_about_each_arm_s_own_rows() -> None:
    cell = read_cell(UNEQUAL / "seven-six.toml")
    world = world_of("seven-six.toml", 5)
    world.close()
    for arm, truth in zip(cell.arms, world.arms, strict=True):
        off = tip(truth.geometry, np.array(arm.start_rad))[:3, 3] - fingertip(arm, np.array(arm.start_rad))[:3, 3]
        assert 1e-5 < np.linalg.norm(off) < 1e-2
        assert np.abs(truth.geometry.zero_rad - rows_of(arm).geometry.zero_rad).max() < 3e-3
        assert (truth.train.backlash_rad > 0.0).tolist() == [False] * (len(arm.axes) - 3) + [True] * 3


@pytest.mark.parametrize("plant", ["bullet", "light"])
def test_a_delayed_sync_of_the_slave_keeps_its_joints_back_and_leaves_the_master_s_seventh_alone(plant: str) -> None:
    """Arms that hold no part, all joints at 0.1 rad/s: 1 ms is 0.1 mrad, from the eighth joint on."""
    places = []
    for skew_s in (0.0, 1e-3):
        cell = read_cell(UNEQUAL / "seven-six.toml")
        world = pair_units(cell, None, {"skew_s": skew_s}, plant)["left"].world  # type: ignore[arg-type]
        world.part.let_go()
        power(world)
        for axis in world.motors.axes:
            axis.servo.reference_step_rad = 1e-4
        go(world, 0.16)
        places.append(world.motors.theta.copy())
        world.close()
    behind = places[0] - places[1]
    assert np.abs(behind[:7]).max() < 2e-6
    assert behind[7:] == pytest.approx(np.full(6, 1e-4), rel=0.2)


def test_each_arm_of_thirteen_joints_reads_its_own(thirteen: TwoArms) -> None:
    """Held by its motors each drive reports what gravity asks of its own joint, but for noise."""
    power(thirteen)
    go(thirteen, 0.2)
    gravity = torques(load_pair(thirteen.arms, STEP_S), thirteen.q)
    readings = thirteen.reading_nm(0), thirteen.reading_nm(1)
    assert (len(readings[0]), len(readings[1])) == (7, 6)
    rated = thirteen.motors.train.rated_nm
    assert np.abs(np.concatenate(readings) - gravity).max() < 0.05 * rated.max()
    assert (np.abs(np.concatenate(readings) - gravity) < 0.08 * rated).all()


@pytest.mark.parametrize("file", ["large-small.toml", "seven-six.toml", "seven-seven.toml"])
def test_the_plant_for_real_time_rests_as_the_other_one_does(file: str) -> None:
    light, small = world_of(file, 2, "light"), world_of(file, 2)
    assert light.q == pytest.approx(small.q, abs=1e-9)
    light.close()
    small.close()
