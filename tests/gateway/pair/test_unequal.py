"""Two different arms, from the cell file to a taught and driven part: sizes, and numbers of axes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gateway.pair.pair_cell import load_pair
from gateway.pair.pair_motion import PairMotionOptions
from gateway.pair.pair_store import PairStore
from gateway.pair.session import embodiment_of, open_taught_path, run_pair, teach_pair
from gateway.pair.transform import correction_between
from tests.gateway.pair.together import Together

FOLDER = Path(__file__).resolve().parents[3] / "examples" / "pair-unequal"
#: Axes of master and slave.
CELLS = {"large-small": (6, 6), "seven-six": (7, 6), "seven-seven": (7, 7)}
#: How far the grasps are off [m, rad].
AWAY = np.array([9.6e-4, -6.0e-4, 7.2e-4, 1.8e-3, -1.2e-3, 9.6e-4])


@pytest.mark.parametrize("name", CELLS)
def test_a_cell_of_different_arms_is_loaded_and_its_path_planned(name: str) -> None:
    cell = load_pair(FOLDER / f"{name}.toml")
    first, second = cell.arms
    assert (first.axes, second.axes) == CELLS[name]
    path = cell.path(1.5)
    for arm, q, commands in zip(cell.arms, cell.joints(path), (path.commands, cell.nominal_slave(path)), strict=True):
        assert q.shape == (len(path), arm.axes)
        assert q[0] == pytest.approx(arm.start_rad, abs=1e-6)
        assert arm.chain.poses(q)[0] == pytest.approx(commands, abs=1e-9)
        assert arm.links.shape == (10 * arm.axes,)
        assert arm.mass_matrix(q[:1]).shape == (1, arm.axes, arm.axes)


def test_the_small_arm_is_three_quarters_of_the_large_one_and_as_heavy_as_its_cube() -> None:
    large, small = load_pair(FOLDER / "large-small.toml").arms
    assert small.robot.placement[:, :3, 3] == pytest.approx(0.75 * large.robot.placement[:, :3, 3])
    assert small.robot.mass_kg == pytest.approx(0.75**3 * large.robot.mass_kg, rel=1e-4)


@pytest.fixture(params=["seven-six"])
def pair(request: pytest.FixtureRequest) -> Iterator[Together]:
    pair = Together(AWAY, cell_file=FOLDER / f"{request.param}.toml")
    yield pair
    pair.arms.close()


@pytest.mark.slow
def test_an_unstated_relation_is_taught_and_driven(pair: Together, tmp_path: Path) -> None:
    """Taught to what 5 N and 1.5 Nm are on this part; the path and the path back under it stay far below the limit."""
    store = PairStore(pair.cell, tmp_path)
    options = PairMotionOptions(speed=1.0, force_limit_n=1e4)
    taught_path = open_taught_path(pair.cell, store, resume=False)
    function = teach_pair(pair.link, pair.cell, store, taught_path, lambda *_arguments: None, options)
    begun = np.linalg.norm(correction_between(pair.cell.nominal_relation, pair.true)[:3])
    for s_m in (0.0, float(function.s_m[-1])):
        assert np.linalg.norm(correction_between(function.at(s_m), pair.true)[:3]) < 0.3 * begun
    cycles = []
    run_pair(pair.link, pair.cell, store, embodiment_of(pair.cell, "C1i"), 2, cycles.append, options)
    for cycle in cycles:
        assert cycle.summary.complete
        assert np.linalg.norm(cycle.internal_force.wrench[:, :3], axis=1).max() < 0.5 * pair.cell.config.force_limit_n
    for arm, q in zip(pair.cell.arms, pair.part.q_rad, strict=True):
        assert q == pytest.approx(arm.start_rad, abs=5e-3)
