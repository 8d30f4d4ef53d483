"""Open benchmark of naming: files of cells and answers, the scorer, and the baselines on a residual of known origin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.naming.answers import Answer
from benchmarks.naming.cells import read_cells, write_cells
from benchmarks.naming.methods import Columns, columns_of, greedy, residual_plot
from benchmarks.naming.score import ROWS, scores

#: A baseline: columns and seed -> names with joints.
Method = Callable[[Columns, int], tuple[tuple[str, tuple[int, ...]], ...]]


def _truth(kind: str, *effects: tuple[str, int, float]) -> dict[str, Any]:
    listed = [{"names": [name], "joints": [joint], "strength": strength} for name, joint, strength in effects]
    return {"kind": kind, "effects": listed, "load": [10.0, 0.1, 0.0, 0.2]}


def test_scorer_counts_names_errors_and_coverage_by_hand() -> None:
    truth = {
        "a": _truth("one", ("balancer_spring", 2, 5.0)),
        "b": _truth("one", ("torque_offset", 4, 2.0)),
        "c": _truth("clean"),
        "d": _truth("strange", ("none", 1, 5.0)),
    }
    std = (0.2, 0.01, 0.01, 0.01)
    answers = {
        "a": Answer("a", (("balancer_spring", (2,)),), False, (10.1, 0.1, 0.0, 0.2), std, 1.0),
        "b": Answer("b", (("torque_offset", (5,)),), False, (11.0, 0.1, 0.003, 0.204), std, 3.0),
        "c": Answer("c", (("base_tilt", ()),), False, (10.0, 0.1, 0.0, 0.2), None, 2.0),
    }
    found = scores(truth, answers)
    assert found[ROWS[0]] == "100 % of 1"  # a: strong, named exactly
    assert found[ROWS[1]] == "0 % of 1"  # b: another joint
    assert found[ROWS[4]] == "100 % of 1"  # c: a name without an effect
    assert found[ROWS[5]] == "0 % of 1"  # d: no answer
    assert found[ROWS[6]] == "50 % of 4"  # b and c
    assert found[ROWS[7]] == "1 %"  # median of 1, 10 and 0 %
    assert found[ROWS[9]] == "0 mm"
    assert found[ROWS[10]] == "88 % of 8"  # seven of eight: the mass of b is 5 standard deviations off
    assert found[ROWS[11]] == "2 s"


@pytest.fixture(scope="module")
def clean_columns(tmp_path_factory: pytest.TempPathFactory) -> Columns:
    folder = tmp_path_factory.mktemp("naming")
    write_cells(range(50_000, 50_001), folder / "cells", folder / "truth")
    (cell,) = read_cells(folder / "cells")
    return columns_of(cell)


@pytest.mark.parametrize("method", [residual_plot, greedy])
def test_baseline_names_the_effect_whose_column_is_the_residual(clean_columns: Columns, method: Method) -> None:
    data = clean_columns
    label = next(each for each in data.labels if each[0] == "balancer_spring")
    column = data.columns[:, data.of(label)[0]]
    rows = len(data.weight)
    size = np.sqrt(np.mean(column[:rows][data.problem.axis == label[1][0] - 1] ** 2))
    target = column * 20.0 / size
    made = Columns(data.problem, data.null, data.weight, data.orthogonal, target, data.labels, data.columns, data.raw)
    assert label in method(made, 0)
