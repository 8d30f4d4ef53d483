"""Blended and filtered commands."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from gateway.errors import ConfigError
from gateway.pair.path import PairPath
from gateway.pair.streaming import inverse_low_pass, low_pass, pass_near
from gateway.pair.transform import correction_between


def test_low_pass_of_positions_is_the_first_order_filter(path: PairPath) -> None:
    share = 1.0 - np.exp(-0.004 / 0.02)
    place = path.commands[:, :3, 3]
    expected = place[0] + lfilter([share], [1.0, share - 1.0], place - place[0], axis=0)
    filtered = low_pass(path.commands, 0.02, 0.004)
    assert np.allclose(filtered[:, :3, 3], expected, atol=1e-14)
    assert np.allclose(np.linalg.det(filtered[:, :3, :3]), 1.0)


def test_inverse_filter_gives_commands_whose_filtered_version_is_wanted(path: PairPath) -> None:
    commands = inverse_low_pass(path.commands, 0.02, 0.004)
    assert np.abs(correction_between(commands, path.commands)).max() > 1e-3
    assert np.abs(correction_between(low_pass(commands, 0.02, 0.004), path.commands)).max() < 1e-9
    with pytest.raises(ConfigError, match="filter"):
        low_pass(path.commands, -1.0, 0.004)


def test_blended_path_misses_its_corner_and_keeps_its_ends() -> None:
    poses = np.tile(np.eye(4), (41, 1, 1))
    poses[:, 0, 3] = np.minimum(np.arange(41), 20) * 1e-3
    poses[:, 1, 3] = np.maximum(np.arange(41) - 20, 0) * 1e-3
    blended = pass_near(poses, 5)
    corner = np.linalg.norm(blended[20, :3, 3] - poses[20, :3, 3])
    assert corner == pytest.approx(np.hypot(15.0, 15.0) / 11.0 * 1e-3)
    assert np.array_equal(blended[[0, -1]], poses[[0, -1]])
    assert np.allclose(blended[:10], poses[:10])
