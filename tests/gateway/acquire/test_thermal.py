"""Order of the loads against drift, and when an arm is warm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from gateway.acquire import thermal
from gateway.acquire.thermal import blocks_of, warm_up
from gateway.data.visit import RestPose

POSES = tuple(RestPose(number, (0.1 * number, 0.0), "fit") for number in (1, 2, 3))


def test_loads_in_both_orders_have_equal_mean_times() -> None:
    blocks = blocks_of(["a", "b"], POSES, is_thermal=True)
    assert [block.load for block in blocks] == ["a", "b", "none", "none", "b", "a"]
    for label in ("a", "b", "none"):
        assert np.mean([place for place, block in enumerate(blocks) if block.load == label]) == 2.5
    numbers = [pose.number for block in blocks for pose in block.poses if block.load == "a"]
    assert numbers == [1, 2, 3, 1001, 1002, 1003]
    assert [pose.q_rad for pose in blocks[-1].poses] == [pose.q_rad for pose in POSES]


def test_without_it_the_bare_arm_comes_first() -> None:
    assert [block.load for block in blocks_of(["a", "b"], POSES, is_thermal=False)] == ["none", "a", "b"]


@dataclass
class Measured:
    """What a warm-up reads back: friction that falls round by round."""

    bands: list[float]
    round_s: float
    rounds: int = 0

    def measure(self, poses) -> None:
        assert {pose.number // 1000 for pose in poses} == {self.rounds}
        self.rounds += 1

    def read(self, _path, rounds):
        assert rounds == self.rounds
        return np.full((rounds, 3, 2), 1.0) * np.array(self.bands[:rounds])[:, None, None], rounds * self.round_s


@pytest.mark.parametrize(
    ("bands", "longest_s", "rounds", "words"),
    [
        ([5.0, 4.0, 3.5, 3.45, 3.0], 1e4, 4, "warm: after 4.0 min"),
        ([5.0, 4.0, 3.5, 3.0, 2.5], 170.0, 3, "still changes by -12.5 %"),
    ],
)
def test_an_arm_is_warm_when_its_friction_is_constant(monkeypatch, tmp_path, bands, longest_s, rounds, words) -> None:
    measured = Measured(bands, 60.0)
    monkeypatch.setattr(thermal, "_bands", measured.read)
    said = warm_up(POSES, Path(tmp_path) / "warm-up.h5", longest_s, measured.measure)
    assert measured.rounds == rounds
    assert words in said
