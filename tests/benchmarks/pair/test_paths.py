"""A path that a seed has drawn begins where the arms are, without a step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.pair.bus_paths import MOST, drawn_cell
from benchmarks.pair.bus_rig import CELL
from gateway.pair.pair_cell import load_pair, read_path

MM = 1e-3


@pytest.mark.parametrize("seed", [0, 27, 46])
def test_a_drawn_path_goes_elsewhere_from_the_same_start_as_smoothly(tmp_path: Path, seed: int) -> None:
    drawn = load_pair(drawn_cell(tmp_path, seed))
    stated, step_s = read_path(CELL.parent / "path.csv")
    poses = drawn.program.poses
    np.testing.assert_allclose(poses[0], load_pair(CELL).program.poses[0], atol=1e-9)
    off_m = np.linalg.norm(read_path(tmp_path / "path.csv")[0][:, :3, 3] - stated[:, :3, 3], axis=1)
    assert 10.0 * MM < off_m.max() < 2.5 * np.linalg.norm(MOST[:3])
    for path in (poses, stated):
        speed = np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1) / step_s
        rise = np.abs(np.diff(speed)).max() / step_s
        assert speed[[0, -1]].max() < 1.0 * MM
        assert rise < 1.0
