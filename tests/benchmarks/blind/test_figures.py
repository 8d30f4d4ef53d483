"""How blind cells are scored."""

from __future__ import annotations

import pytest

from benchmarks.blind.figures import (
    confusion,
    credit,
    figures,
    places,
)


def cell(kind: str, truth: list, found: list, verdict: str, strength: float = 5.0) -> dict:
    return {
        "seed": 0,
        "kind": kind,
        "truth": truth,
        "strengths": [strength] * len(truth),
        "found": found,
        "verdict": verdict,
        "holdout_over_floor": 1.0,
        "load_errors": [0.01, 0.002],
        "errors_with_effects": [0.01, 0.002],
        "inside": [True] * 19 + [False],
        "first_s": 1.0,
    }


TILT, SHIFTED = ["base_tilt", []], ["joint_zero_offset", [2]]


def test_credit_for_a_name_a_pair_and_a_wrong_axis():
    assert credit(cell("one", [TILT], [TILT], "explained")) == 1.0
    assert credit(cell("one", [TILT], [TILT, SHIFTED], "undecided")) == 0.5
    assert credit(cell("one", [TILT], [TILT, SHIFTED], "explained")) == 0.0
    wrong_axis = cell("one", [SHIFTED], [["joint_zero_offset", [3]]], "explained")
    assert credit(wrong_axis) == 1.0
    assert credit(wrong_axis, places) == 0.0


def test_figures_say_what_is_met():
    cells = [cell("one", [TILT], [TILT], "explained"), cell("clean", [], [TILT], "explained")]
    cells += [cell("off", [["bungee", [3]]], [], "unexplained"), cell("two", [TILT, SHIFTED], [TILT], "explained")]
    out = figures(cells)
    assert out["right effect, strength >= 3"]["met"]
    assert out["right effect, strength 1.5 to 3"]["met"] is None
    assert not out["false alarm on clean cells"]["met"]
    assert out["off-library effect called by a library name"]["value"] == 0.0
    assert out["both named, two effects of strength >= 3"]["value"] == 0.0
    assert out["95 % intervals hold the truth"]["value"] == pytest.approx(0.95)
    assert ("two effects", "one of them", 1) in confusion(cells)
