"""Sweep at a taught point against joint angles solved for the moved part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.pair.inverse import path_joint_angles
from gateway.pair.pair_cell import PairCell, load_pair
from gateway.pair.relation import slave_command
from gateway.pair.sweep import LEVER_M, liveliest_twist, swept

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
CELL = EXAMPLES / "pair" / "cell.toml"
STEP_M = 1e-4
#: Of the example's path; there a joint of the slave turns 0.02 mrad under 2 mm along the path.
POINT = 606


@pytest.fixture(scope="module")
def cell() -> PairCell:
    return load_pair(CELL)


def turned(cell: PairCell, commands: np.ndarray, at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """How far the joints of both arms turn from the first to the last command [rad]."""
    first, second = cell.arms
    slave = slave_command(first.world_from_base, commands, second.world_from_base, cell.nominal_relation)
    angles = [
        path_joint_angles(arm.chain, to, q)[0] for arm, to, q in zip(cell.arms, (commands, slave), at, strict=True)
    ]
    return np.concatenate([q[-1] - q[0] for q in angles])


def test_the_joint_that_turns_least_turns_as_far_as_said(cell: PairCell) -> None:
    path = cell.path(1.0)
    joints = cell.joints(path)
    for index in path.uniform(9):
        at = (joints[0][index], joints[1][index])
        twist, least = liveliest_twist(cell, path.commands[index], at)
        assert np.linalg.norm(twist * np.repeat([1.0, LEVER_M], 3)) == pytest.approx(1.0)
        commands = swept(cell, path.commands[index], twist, np.array([0.0, STEP_M]))
        assert np.abs(turned(cell, commands, at)).min() == pytest.approx(least * STEP_M, rel=0.02)
        assert 0.002 * least > 1.5e-3


@pytest.mark.parametrize("name", ["large-small", "seven-six", "seven-seven"])
def test_a_joint_of_an_arm_that_has_more_turns_as_far_as_said_too(name: str) -> None:
    cell = load_pair(EXAMPLES / "pair-unequal" / f"{name}.toml")
    path = cell.path(1.0)
    joints = cell.joints(path)
    for index in path.uniform(9):
        at = (joints[0][index], joints[1][index])
        twist, least = liveliest_twist(cell, path.commands[index], at)
        commands = swept(cell, path.commands[index], twist, np.array([0.0, STEP_M]))
        assert np.abs(turned(cell, commands, at)).min() == pytest.approx(least * STEP_M, rel=0.03)
        assert 0.002 * least > 0.7e-3


def test_along_the_path_a_joint_may_all_but_stand(cell: PairCell) -> None:
    path = cell.path(1.0)
    joints = cell.joints(path)
    at = (joints[0][POINT], joints[1][POINT])
    ahead = POINT + int(np.searchsorted(path.s_m[POINT:] - path.s_m[POINT], 0.002))
    assert np.abs(turned(cell, path.commands[[POINT, ahead]], at)).min() < 1e-4
