"""The judge of strangers' robots: sees what is wrong, and every kind of file is among the drawn ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.strangers.robots import BODIES, FILES, WRITING, WRONG, Case, draw, judge
from tests.data.arms import urdf_of


def test_every_kind_is_drawn_often():
    names = [name for seed in range(FILES) for name in draw(seed)[1]]
    for change in (*BODIES, *WRITING, *WRONG):
        assert names.count(change.__name__) >= 3, change.__name__


@pytest.mark.parametrize("seed", range(12))
def test_the_first_files_are_handled(seed: int, tmp_path: Path):
    why, error = judge(draw(seed)[0], tmp_path)
    assert not why
    assert error <= 1e-12


def test_the_judge_sees_another_torque_another_chain_and_a_wrong_answer(tmp_path: Path):
    text = urdf_of(np.random.default_rng(0))
    heavier = text.replace('<mass value="', '<mass value="9', 1)
    assert judge(Case(heavier, text, 6), tmp_path)[1] > 1e-3
    assert "read as" in judge(Case(text, text, 5), tmp_path)[0]
    assert "to be refused" in judge(Case(text, text, 6, refused=["--tip"]), tmp_path)[0]
    assert "not named" in judge(Case(text, text, 6, named=["fixed at zero"]), tmp_path)[0]
    assert "refused: " in judge(Case(text, text[:-9], 6, refused=["type this"]), tmp_path)[0]
    assert "refused: " in judge(Case(text, text[:-9], 6), tmp_path)[0]
