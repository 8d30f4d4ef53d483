"""The pair's plant for the clock: against PyBullet in small steps where it can be, else against closed forms."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from sim.cellfile import read_cell
from sim.pair.body import load_pair
from sim.pair.cell import pair_units
from sim.pair.geometry import jacobian
from sim.pair.light import LightWorld
from sim.pair.two_arms import STEP_S, TwoArms
from sim.pair.world import PairWorld
from sim.serve import obey
from sim.simulation import GripError, ServeOptions, Simulation
from sim.states import PdsState
from tests.sim.conftest import go, power, torques

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
CELL = EXAMPLES / "pair" / "cell.toml"
SYNC_S = 0.004
Worlds = Callable[..., TwoArms]


@pytest.fixture
def world_of() -> Iterator[Worlds]:
    made: list[TwoArms] = []

    def build(plant: str = "light", seed: int | None = None, **settings: object) -> TwoArms:
        made.append(pair_units(read_cell(CELL), seed, settings, plant)["left"].world)  # type: ignore[arg-type]
        return made[-1]

    yield build
    for world in made:
        world.close()


@pytest.fixture
def simulation_of() -> Iterator[Callable[..., Simulation]]:
    made: list[Simulation] = []

    def build(cell: Path, plant: str | None = None, **options: object) -> Simulation:
        name = uuid.uuid4().hex
        bus = f"virtual:{name}" if "pair" not in str(cell) else f"left=virtual:{name}l;right=virtual:{name}r"
        made.append(Simulation(cell, ServeOptions(bus=bus, **options), plant=plant))  # type: ignore[arg-type]
        return made[-1]

    yield build
    for simulation in made:
        for server in simulation.servers:
            server.bus.shutdown()
        simulation.close()


def push_apart(world: TwoArms, rest_s: float) -> float:
    """Turn the second arm away from the first; return the force inside the part a while later."""
    for step_rad, seconds in ((4e-6, 0.1), (0.0, rest_s)):
        for axis in world.motors.axes[6:]:
            axis.servo.reference_step_rad = step_rad
        go(world, seconds)
    return float(np.linalg.norm(world.wrench[:3]))


def test_at_rest_the_motors_carry_what_the_arms_weigh(world_of: Worlds) -> None:
    light, heavy = world_of("light", 3), world_of("bullet", 3)
    for world in (light, heavy):
        power(world)
        go(world, 0.4)
    assert isinstance(light, LightWorld)
    assert isinstance(heavy, PairWorld)
    assert np.abs(light.motors.gear_nm).max() > 50.0
    assert light.motors.gear_nm == pytest.approx(torques(load_pair(heavy.arms, STEP_S), heavy.q), abs=1.0)
    assert light.motors.shown_nm == pytest.approx(light.motors.gear_nm, abs=1e-6)
    assert np.abs(light.q - heavy.q).max() < 2e-4
    assert np.linalg.norm(light.wrench[:3]) < 1.0


def test_an_axis_lags_by_its_time_constant(world_of: Worlds) -> None:
    world = world_of()
    power(world)
    world.open_grippers()
    go(world, 0.1)
    axis, speed, lag_s = world.motors.axes[2], 0.3, float(world.motors.train.lag_s[2])
    axis.servo.reference_step_rad = speed * 1e-3
    for cycle in range(1, 12):
        go(world, SYNC_S)
        behind = speed * lag_s * (1.0 - math.exp(-cycle * SYNC_S / lag_s))
        assert axis.servo.error_rad == pytest.approx(behind, rel=1e-6, abs=1e-9)
    assert axis.fastest_rad_s == pytest.approx(speed, rel=0.1)


def test_a_step_of_speed_takes_as_much_torque_however_short_the_stretch_it_is_seen_in(world_of: Worlds) -> None:
    """A drive that receives a speed 20 us before the next look at the plant does not kick its arm."""
    impulse, most = [], []
    for stretches in ([4.0, 4.0], [0.02, 3.98, 4.0], [1.0] * 8):
        world = world_of(filter_s=0.0)
        power(world)
        world.open_grippers()
        go(world, 0.1)
        rest_nm = float(world.motors.u_nm[0])
        world.motors.axes[0].servo.offset_rad_s = 0.01
        seen = []
        for ticks in stretches:
            go(world, ticks * 1e-3, ticks * 1e-3)
            seen.append((float(world.motors.u_nm[0]) - rest_nm, ticks))
        impulse.append(sum(torque_nm * ticks for torque_nm, ticks in seen))
        most.append(max(abs(torque_nm) for torque_nm, _ in seen))
    assert impulse == pytest.approx([impulse[0]] * 3, rel=0.1)
    assert max(most) < 1.5 * impulse[0]


def test_dry_friction_stays_where_a_joint_has_come_to_stand(world_of: Worlds) -> None:
    """Two standstills in one place, approached from either side: the torques are twice the friction apart."""
    world = world_of()
    power(world)
    world.open_grippers()
    axis, coulomb_nm = world.motors.axes[2], float(world.motors.train.coulomb_nm[2])
    stood = []
    for step_rad in (2e-6, -2e-6):
        for offset_rad in (-step_rad, step_rad):
            axis.servo.reference_step_rad = offset_rad
            go(world, 0.4)
        axis.servo.reference_step_rad = 0.0
        go(world, 2.0)
        stood.append(float(world.motors.shown_nm[2]))
    assert abs(world.motors.omega[2]) < 1e-6
    assert stood[0] - stood[1] == pytest.approx(2.0 * coulomb_nm, rel=0.02)


def test_a_step_of_the_reference_is_not_followed_faster_than_the_drive_may(world_of: Worlds) -> None:
    world = world_of()
    power(world)
    world.open_grippers()
    axis = world.motors.axes[5]
    axis.servo.max_nm, axis.servo.max_rad_s = 1e9, 2.0
    before = axis.position_rad
    axis.servo.reference_step_rad = 0.5 / 4
    go(world, SYNC_S)
    assert axis.position_rad - before == pytest.approx(2.0 * SYNC_S)
    assert axis.fastest_rad_s == pytest.approx(2.0)


def test_a_mismatch_becomes_force_through_gears_and_part_in_series(world_of: Worlds) -> None:
    world = world_of("light", 1)
    before = world.wrench.copy()
    turned = 1e-4 * np.array([1.0, -1.0, 0.5, 1.0, 0.0, 2.0])
    go(world, SYNC_S)
    before = world.wrench.copy()
    world.motors.theta[6:] += turned
    world.motors.play[6:] += turned
    go(world, SYNC_S)
    rate = jacobian(world.arms[1].geometry, world.q[6:])
    closure = world.part.at(world.q)
    compliance = np.diag(1.0 / world.part.stiffness)
    for six in (slice(0, 6), slice(6, 12)):
        gear = np.diag(1.0 / world.motors.train.stiffness_nm_rad[six])
        compliance = compliance + closure.jacobian[:, six] @ gear @ closure.jacobian[:, six].T
    expected = -np.linalg.solve(compliance, rate @ turned)
    assert np.abs(expected[:3]).max() > 5.0
    assert np.abs(world.wrench - before - expected).max() < 0.05 * np.abs(expected).max()
    gear = world.motors.gear_nm + world.wrench @ closure.jacobian
    assert gear == pytest.approx(torques(load_pair(world.arms, STEP_S), world.q), abs=0.5)


def test_force_agrees_with_pybullet(world_of: Worlds) -> None:
    last = []
    for plant in ("light", "bullet"):
        world = world_of(plant, 0)
        power(world)
        go(world, 0.2)
        push_apart(world, 0.4)
        last.append(world.wrench[:3].copy())
    assert np.linalg.norm(last[1]) > 15.0
    assert np.linalg.norm(last[0] - last[1]) < 0.35 * np.linalg.norm(last[1])  # friction is between them


@pytest.mark.parametrize("plant", ["light", "bullet"])
def test_open_grippers_carry_no_force_and_close_free_of_it(world_of: Worlds, plant: str) -> None:
    world = world_of(plant, 0)

    power(world)
    go(world, 0.2)
    world.open_grippers()
    assert push_apart(world, 0.2) == 0.0
    world.open_grippers()
    world.close_grippers()
    go(world, 0.1)
    assert np.linalg.norm(world.wrench[:3]) < 3.0
    assert push_apart(world, 0.2) > 15.0


def test_an_axis_without_torque_falls_and_one_without_brake_sinks(world_of: Worlds) -> None:
    world = world_of()
    world.open_grippers()
    power(world)
    go(world, 0.1)
    axis, load = world.motors.axes[1], world.motors.gear_nm[1]
    before = axis.position_rad
    axis.coast()
    go(world, 0.1)
    fallen = axis.position_rad - before
    assert fallen * load < 0.0
    still, faster = (torques(load_pair(world.arms, STEP_S), world.q, 0.0, qdd) for qdd in (0.0, np.eye(12)[1]))
    inertia = (faster - still)[1] + world.motors.train.rotor_kg_m2[1]
    least = 0.5 * (abs(load) - world.motors.train.coulomb_nm[1]) / inertia * 0.01
    assert abs(fallen) == pytest.approx(least, rel=0.35)
    axis.lock()
    go(world, 0.02)
    held_rad = axis.position_rad
    go(world, 0.1)
    assert axis.position_rad == held_rad
    axis.slip_rad_s = 0.01
    go(world, 0.1)
    assert axis.position_rad - held_rad == pytest.approx(-math.copysign(0.001, load), rel=0.05)


def test_an_axis_that_has_too_little_torque_reports_it_and_drops(world_of: Worlds) -> None:
    world = world_of()
    world.open_grippers()
    power(world)
    go(world, 0.1)
    axis, load = world.motors.axes[1], float(world.motors.gear_nm[1])
    before = axis.position_rad
    axis.servo.max_nm = 0.5 * abs(load)
    go(world, 0.2)
    assert axis.servo.limited
    assert abs(axis.servo.u_nm) == pytest.approx(0.5 * abs(load))
    assert (axis.position_rad - before) * load < -1e-3
    axis.servo.max_nm = 10.0 * abs(load)
    go(world, 0.5)
    assert not axis.servo.limited
    assert axis.position_rad == pytest.approx(before, abs=1e-4)


def test_pacing_chooses_the_plant(simulation_of: Callable[..., Simulation]) -> None:
    def plant(pacing: str, stated: str | None = None) -> type:
        return type(simulation_of(CELL, stated, pacing=pacing).arms[0].world)

    assert plant("real") is LightWorld
    assert plant("lockstep") is PairWorld
    assert plant("real", "bullet") is PairWorld


def test_time_is_what_both_buses_have_seen_and_is_complete_at_a_sync(simulation_of: Callable[..., Simulation]) -> None:
    left, right = simulation_of(CELL, pacing="real").arms
    world = left.world
    left.advance(0.009)
    assert world.time_s == 0.0
    right.advance(0.006)
    assert world.time_s == pytest.approx(0.006)
    right.advance(0.002)
    assert world.time_s == pytest.approx(0.006)
    left.sync()
    assert world.time_s == pytest.approx(0.008)
    left.advance(0.5)  # the other bus was stalled, and catches up with the half of it
    right.advance(0.25)
    assert world.time_s == pytest.approx(0.509)


def test_a_quick_stop_by_the_clock_takes_its_ramp_and_ends_in_the_brake(
    simulation_of: Callable[..., Simulation],
) -> None:
    simulation = simulation_of(CELL, pacing="real", unbuffered=True)
    simulation.grip(open=True)
    left, right = simulation.arms

    def pass_(seconds: float) -> None:
        for _ in range(round(seconds / SYNC_S)):
            for unit in (left, right):
                unit.advance(SYNC_S)

    drive = left.drives[2]
    drive.motion.take_mode(8)
    for word in (0x06, 0x07, 0x0F):
        drive.take_controlword(word)
    pass_(0.1)
    start, step = drive.position_counts(), round(0.5 * SYNC_S * drive.motion.counts_per_joint_rad)
    for number in range(1, 51):
        drive.motion.take_target(start + step * number)
        pass_(SYNC_S)
    assert drive.axis.omega_rad_s == pytest.approx(0.5, rel=0.05)
    drive.store.values[0x6085, 0] = round(2.0 * abs(drive.spec.gear_ratio) * drive.units.velocity.bits_per_unit)
    drive.take_controlword(0x02)
    lasted = 0
    while drive.automaton.state is PdsState.QUICK_STOP_ACTIVE:
        pass_(SYNC_S)
        lasted += 1
    assert lasted * SYNC_S == pytest.approx(0.25 + 0.05, abs=0.06)  # the ramp, and the lag behind it
    assert drive.automaton.state is PdsState.SWITCH_ON_DISABLED
    assert not drive.axis.free
    assert drive.axis.fastest_rad_s < 0.55


def test_two_arms_leave_the_clock_its_time(simulation_of: Callable[..., Simulation]) -> None:
    """A second of both arms with 4 ms SYNCs, buses left out: about a twentieth of a core."""
    simulation = simulation_of(CELL, pacing="real")
    power(simulation.arms[0].world)  # type: ignore[arg-type]
    began_s = time.process_time()
    for _ in range(250):
        for unit in simulation.arms:
            unit.sync()
        for unit in simulation.arms:
            unit.advance(SYNC_S)
    assert time.process_time() - began_s < 0.5
    simulation.arms[0].sync()
    assert simulation.arms[0].world.time_s == pytest.approx(1.0)


def test_grippers_open_and_close_on_standard_input(simulation_of: Callable[..., Simulation]) -> None:
    simulation, said = simulation_of(CELL, pacing="real"), []
    part = simulation.arms[0].world.part  # type: ignore[attr-defined]
    lines = iter(["grip open\n", "look\n", "grip closed\n", "grip sideways\n"])

    def obeyed() -> Iterator[str]:
        for line in lines:
            if line == "look\n":
                said.append(str(part.stiffness.any()))
            else:
                yield line

    obey(simulation, obeyed(), said.append)
    assert said[:3] == ["grippers open", "False", "grippers closed"]
    assert part.stiffness.all()
    assert "grip open, grip closed" in said[3]


@pytest.mark.parametrize(("cell", "why"), [("small/cell.toml", "no pair"), ("pair/distance.toml", "keep a distance")])
def test_grippers_that_hold_nothing_are_refused_in_words(
    simulation_of: Callable[..., Simulation], cell: str, why: str
) -> None:
    simulation, said = simulation_of(EXAMPLES / cell), []
    with pytest.raises(GripError, match=why):
        simulation.grip(open=True)
    obey(simulation, ["grip open"], said.append)
    assert why in said[0]


def test_a_load_cannot_be_mounted_on_a_pair(simulation_of: Callable[..., Simulation]) -> None:
    simulation, said = simulation_of(CELL), []
    obey(simulation, ["payload none"], said.append)
    assert "holds the workpiece" in said[0]


def test_by_the_clock_encoders_are_latched_at_the_instant_of_the_sync(world_of: Worlds) -> None:
    """Not at the last whole millisecond, nor where the other arm's SYNC has brought the plant to."""
    world = world_of()
    world.follow_the_clock(1, 0.0100)
    world.follow_the_clock(0, 0.0104)
    with world.settled(0):
        assert world.time_s == pytest.approx(0.0104, abs=1e-6)
    axis = world.motors.axes[6]
    at_rad, axis.omega_rad_s = axis.position_rad, 0.5
    with world.settled(1):
        assert world.time_s == pytest.approx(0.0104, abs=1e-6)
        assert axis.position_rad == pytest.approx(at_rad - 0.5 * 0.0004, abs=1e-9)


def test_the_sync_of_the_other_bus_right_after_is_no_stretch_of_its_own(world_of: Worlds) -> None:
    """A stretch takes as long to compute however short it is; rotors that turn evenly go on for so long."""
    world = world_of()
    world.follow_the_clock(0, 0.0100)
    world.follow_the_clock(1, 0.0100)
    with world.settled(0):
        assert world.time_s == pytest.approx(0.0100, abs=1e-6)
    for arm in (0, 1):
        world.follow_the_clock(arm, 0.0002)
    axis = world.motors.axes[6]
    at_rad, axis.omega_rad_s = axis.position_rad, 0.5
    with world.settled(1):
        assert world.time_s == pytest.approx(0.0100, abs=1e-6)
        assert axis.position_rad == pytest.approx(at_rad + 0.5 * 0.0002, abs=1e-9)
    for arm in (0, 1):
        world.follow_the_clock(arm, 0.0002)
    with world.settled(0):
        assert world.time_s == pytest.approx(0.0104, abs=1e-6)


def test_a_bus_that_is_held_up_holds_the_plant(world_of: Worlds) -> None:
    world = world_of()
    world.follow_the_clock(1, 0.0040)
    world.follow_the_clock(0, 0.0100)
    with world.settled(0):
        assert world.time_s == pytest.approx(0.0040, abs=1e-6)


def test_a_bus_without_traffic_lets_no_more_time_pass_than_it_was_quiet(
    simulation_of: Callable[..., Simulation],
) -> None:
    """A frame that comes while a thread waits for its turn is still answered at the instant at which it came."""
    server = simulation_of(CELL, pacing="real").servers[0]
    asked_s: list[float] = []

    def recv(_timeout: float) -> None:
        asked_s.extend([server.real_at_s, time.monotonic()])
        server.stop()
        time.sleep(0.05)

    server.bus.recv = recv
    server.run()
    assert asked_s[0] < server.real_at_s <= asked_s[1] + server.step_s
