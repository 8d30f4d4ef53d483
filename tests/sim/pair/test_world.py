"""Two arms and a workpiece in PyBullet against the simulator's own Denavit-Hartenberg table and closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from sim.cellfile import read_cell
from sim.engine import bullet
from sim.pair.body import load_pair
from sim.pair.cell import pair_units
from sim.pair.geometry import frames, jacobian, tip
from sim.pair.two_arms import STEP_S
from sim.pair.workpiece import Stiffness, Workpiece
from sim.pair.world import PairWorld
from tests.sim.conftest import go, power

CELL = Path(__file__).resolve().parents[3] / "examples" / "pair" / "cell.toml"


def world_of(seed: int | None = 0, **settings: object) -> PairWorld:
    units = pair_units(read_cell(CELL), seed, settings, "bullet")
    return units["left"].world


@pytest.fixture
def world() -> Iterator[PairWorld]:
    made = world_of()
    yield made
    made.close()


def test_every_link_is_where_the_table_has_it(world: PairWorld) -> None:
    with load_pair(world.arms, STEP_S) as engine:
        engine.place(world.q, np.zeros(12))
        for arm, truth in enumerate(world.arms):
            q = world.q[6 * arm : 6 * arm + 6]
            wanted = truth.geometry.base @ frames(truth.geometry, q)
            for link in range(1, 6):
                state = bullet.getLinkState(engine.body, 6 * arm + link, 0, 1, engine.client)
                assert np.abs(np.array(state[4]) - wanted[link - 1, :3, 3]).max() < 1e-6


def test_deviation_and_its_jacobian_agree_with_differences(world: PairWorld) -> None:
    part, rng = world.part, np.random.default_rng(1)
    q = world.q + rng.normal(0.0, 1e-3, 12)
    closure = part.at(q)
    for joint in range(12):
        step = np.zeros(12)
        step[joint] = 1e-6
        rate = (part.at(q + step).deviation - part.at(q - step).deviation) / 2e-6
        assert np.abs(rate - closure.jacobian[:, joint]).max() < 2e-3


def test_the_grippers_close_free_of_force(world: PairWorld) -> None:
    assert np.abs(world.part.at(world.q).deviation).max() < 1e-12
    go(world, 0.05, 0.05)
    assert np.linalg.norm(world.wrench[:3]) < 1.0


def test_a_push_on_gripper_2_is_answered_by_the_part(world: PairWorld) -> None:
    """Brakes on: gears and part share 10 N along x by their stiffness (springs in series, closed form)."""
    six = slice(6, 12)
    arm = world.arms[1].geometry
    rate = jacobian(arm, world.q[six])
    push = np.zeros(12)
    push[six] = rate[0] * 10.0
    world.push = push
    go(world, 1.0, 0.025)
    gear = [np.diag(1.0 / world.arms[i].train.stiffness_nm_rad) for i in (0, 1)]
    closure = world.part.at(world.q)
    first, second = closure.jacobian[:, :6], closure.jacobian[:, 6:]
    held = first @ gear[0] @ first.T + np.diag(1.0 / world.part.stiffness)
    alone = second @ gear[1] @ second.T
    force = np.zeros(6)
    force[0] = 10.0
    expected = -np.linalg.solve(held + alone, alone @ force)
    assert np.abs(world.wrench - expected).max() < 0.02 * np.abs(expected).max() + 0.05


def test_a_step_too_long_for_the_part_is_refused() -> None:
    with pytest.raises(ValueError, match="too long"):
        world_of(stiffness=Stiffness(4e9, 4e7))


def test_a_rigid_part_is_stable_at_the_usual_step() -> None:
    made = world_of(stiffness=Stiffness(2e6, 2e4))
    assert made.radius <= 1.0 + 1e-6
    made.close()


def test_one_arm_alone_goes_on_when_the_other_bus_does_not_respond(world: PairWorld) -> None:
    power(world)
    go(world, 0.012)
    together_s = world.time_s
    world.ask(0, 0.004)
    world.ask(0, 0.004)
    assert world.time_s == pytest.approx(together_s + 0.004)
    world.catch_up(0)
    assert world.time_s == pytest.approx(together_s + 0.008)
    # the SYNC that was delayed finds its time gone; from then on both buses are in step again
    world.ask(1, 0.004)
    assert world.time_s == pytest.approx(together_s + 0.008)
    world.ask(0, 0.004)
    assert world.time_s == pytest.approx(together_s + 0.008)
    world.ask(1, 0.004)
    assert world.time_s == pytest.approx(together_s + 0.012)


def test_a_slave_that_is_one_sync_ahead_is_brought_into_step(world: PairWorld) -> None:
    """Bring-up sends the slave one SYNC more; afterwards both answers of a cycle are of the same instant."""
    power(world)
    go(world, 0.004)
    world.ask(1, 0.004)
    for _ in range(3):
        times = []
        for arm in (0, 1):
            world.catch_up(arm)
            world.arrive(arm)
            times.append(world.time_s)
            world.ask(arm, 0.004)
        assert times[0] == times[1]
        assert world.time_s == pytest.approx(times[1] + 0.004)


def test_workpiece_turns_like_a_rigid_lever() -> None:
    """A turn of arm 1 about its first axis moves the place where gripper 2 belongs on a circle."""
    made = world_of(None)
    part = Workpiece((made.arms[0].geometry, made.arms[1].geometry), Stiffness())
    part.grip(made.q)
    q = made.q.copy()
    q[0] += 1e-3
    place = tip(made.arms[1].geometry, made.q[6:])[:3, 3]
    moved = np.array([-np.sin(1e-3) * place[1] + (np.cos(1e-3) - 1) * place[0], np.sin(1e-3) * place[0], 0.0])
    moved[1] += (np.cos(1e-3) - 1) * place[1]
    deviation = part.at(q).deviation
    assert np.abs(deviation[:3] + moved).max() < 1e-12
    assert deviation[5] == pytest.approx(-1e-3, abs=1e-9)
    made.close()
