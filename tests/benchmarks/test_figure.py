"""Goals of figures, and the exit code of a program that misses one."""

from __future__ import annotations

import json

import pytest

from benchmarks.figure import clopper_pearson, conclude, figure, middle, reached, share


@pytest.mark.parametrize(
    ("value", "goal", "met"),
    [
        (2.0, "<= 2", True),
        (2.1, "<= 2", False),
        (float("nan"), ">= 1", False),
        (0.0, "== 0", True),
        (0.92, "0.93 .. 0.97", False),
        (9.0, "printed", None),
    ],
)
def test_a_goal_is_met_or_missed(value, goal, met):
    assert reached(value, goal) is met


def test_a_missed_goal_ends_with_1_and_nothing_to_count_misses_none(tmp_path):
    assert clopper_pearson(0, 100) == pytest.approx([0.0, 1 - 0.025 ** (1 / 100)])
    empty = {"share": share([], ">= 1"), "median": middle([], "<= 1")}
    assert conclude(empty, tmp_path) == 0
    assert conclude(empty | {"missed": figure(3.0, "<= 2")}, tmp_path, beside=1) == 1
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["figures"]["missed"]["met"] is False
    assert summary["beside"] == 1
