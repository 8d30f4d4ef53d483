"""One truth has one parameter, whichever of the two strategies finds it."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.diagnose import diagnose
from gateway.identify.knowledge import Knowledge
from tests.data.moving_arm import World, measured
from tests.data.resting_arm import Bench, effect

STIFFNESS_N_M, LEVER_M, ANCHOR_M, FREE_M = 20_000.0, 0.2, 0.7, 0.4
TWO_SIDED_95 = 1.96


def held(result, name, key, truth):
    """Whether the interval of a parameter holds the truth, and how wide it is over the truth."""
    (found,) = [entry for entry in result.effects if entry.name == name]
    half = TWO_SIDED_95 * found.std[key]
    return abs(found.parameters[key] - truth) <= half, half / truth


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4])
def test_a_spring_at_rest(seed):
    shape = {"lever_m": LEVER_M, "anchor_m": ANCHOR_M, "free_length_m": FREE_M}
    bench = Bench(seed, [effect("balancer_spring", [2], stiffness_n_m=STIFFNESS_N_M, **shape)])
    result = diagnose(bench.both(), bench.robot, bench.options, only=frozenset({"balancer_spring"}))
    inside, width = held(result, "balancer_spring", "stiffness_n_m", STIFFNESS_N_M)
    assert inside
    assert width < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1])
def test_the_same_spring_in_motion(seed):
    world = World(coil=(STIFFNESS_N_M, LEVER_M, ANCHOR_M, FREE_M))
    table, robot, _ = measured(seed, world)
    result = diagnose(table, robot, only=frozenset({"balancer_spring"}))
    inside, width = held(result, "balancer_spring", "stiffness_n_m", STIFFNESS_N_M)
    assert inside
    assert width < 3.0


@pytest.mark.slow
def test_gear_losses_at_rest_and_in_motion_are_one_coefficient():
    bench = Bench(4, [effect("load_dependent_friction", [3], coefficient=0.3)])
    table, robot, _ = measured(1, World(load_friction={2: 0.3}))
    only = frozenset({"load_dependent_friction"})
    resting = diagnose(bench.both(), bench.robot, bench.options, only=only)
    moving = diagnose(table, robot, Knowledge(link_std=np.inf), only=only)
    # at rest a joint has settled: what is left of its friction is 0.85 of it
    for result, truth in ((resting, 0.3), (moving, 0.3)):
        (found,) = [entry for entry in result.effects if entry.name == "load_dependent_friction"]
        assert found.parameters["coefficient"] == pytest.approx(truth, rel=0.3)
        assert np.isfinite(found.std["coefficient"])
