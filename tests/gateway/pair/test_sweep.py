"""Sweep at a taught point against joint angles solved for the moved part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.pair.inverse import path_joint_angles
from gateway.pair.pair_cell import PairCell, load_pair
from gateway.pair.teach import LEVER_M, liveliest_twist, swept
from gateway.pair.transform import slave_command

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
STEP_M = 1e-4


def turned(cell: PairCell, commands: np.ndarray, at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """How far the joints of both arms turn from the first to the last command [rad]."""
    first, second = cell.arms
    slave = slave_command(first.world_from_base, commands, second.world_from_base, cell.nominal_relation)
    angles = [
        path_joint_angles(arm.chain, to, q)[0] for arm, to, q in zip(cell.arms, (commands, slave), at, strict=True)
    ]
    return np.concatenate([q[-1] - q[0] for q in angles])


@pytest.mark.parametrize(
    ("name", "tolerance", "enough"),
    [
        ("pair/cell", 0.02, 1.5e-3),
        *((f"pair-unequal/{name}", 0.03, 0.7e-3) for name in ("large-small", "seven-six", "seven-seven")),
    ],
)
def test_the_joint_that_turns_least_turns_as_far_as_said(name: str, tolerance: float, enough: float) -> None:
    cell = load_pair(EXAMPLES / f"{name}.toml")
    path = cell.path(1.0)
    joints = cell.joints(path)
    for index in path.uniform(9):
        at = (joints[0][index], joints[1][index])
        twist, least = liveliest_twist(cell, path.commands[index], at)
        assert np.linalg.norm(twist * np.repeat([1.0, LEVER_M], 3)) == pytest.approx(1.0)
        commands = swept(cell, path.commands[index], twist, np.array([0.0, STEP_M]))
        assert np.abs(turned(cell, commands, at)).min() == pytest.approx(least * STEP_M, rel=tolerance)
        assert 0.002 * least > enough
