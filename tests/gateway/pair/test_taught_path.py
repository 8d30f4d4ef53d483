"""Taught points as a file: everything comes back, nothing damaged is taken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.errors import InputError
from gateway.pair.teach import TaughtPath, read_taught_path, taught_path_from_json, taught_point


def document() -> dict[str, Any]:
    points = [taught_point(10 * k, 0.1 * k, np.eye(4), np.full(6, 1e-4), ((8.0, 2.0), (1.0, 0.2))) for k in range(3)]
    return json.loads(TaughtPath("ab", "cd", points).to_json())


def test_points_come_back(tmp_path: Path) -> None:
    path = tmp_path / "points.json"
    path.write_text(json.dumps(document()), encoding="utf-8")
    taught_path = read_taught_path(path, "ab", "cd")
    assert [point.command for point in taught_path.points] == [1, 11, 21]
    assert taught_path.points[2].correction_m == taught_path.points[2].correction_rad == (1e-4,) * 3
    assert taught_path.points[1].force_n == (8.0, 2.0)
    assert json.loads(taught_path.to_json()) == document()
    with pytest.raises(InputError, match="another path"):
        read_taught_path(path, "ab", "other")


def test_how_the_servos_follow_comes_back_and_an_older_file_says_nothing_of_it(tmp_path: Path) -> None:
    taught_path = TaughtPath("ab", "cd")
    taught_path.update_laws(np.array([[0.016, 0.08], [np.nan, np.nan]]))
    taught_path.update_laws(np.array([[np.nan, np.nan], [np.nan, np.nan]]))
    again = taught_path_from_json(taught_path.to_json(), "p.json")
    assert np.array_equal(again.laws_s, [[0.016, 0.08], [np.nan, np.nan]], equal_nan=True)
    older = document()
    del older["servo_law_s"]
    assert taught_path_from_json(json.dumps(older), "p.json").laws_s is None
    with pytest.raises(InputError, match="servo_law_s"):
        taught_path_from_json(json.dumps(document() | {"servo_law_s": [[0.016, "x"]]}), "p.json")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("command", 0),
        ("command", 1.5),
        ("command", None),
        ("s_m", None),
        ("s_m", 10**400),
        ("relation", [[1.0] * 4] * 3),
        ("relation", [[1.0] * 4] * 4),
        ("correction_m", [0.0, 0.0]),
        ("correction_rad", ["a", 0, 0]),
        ("force_n", [[1.0]]),
        ("moment_nm", 3.0),
        ("force_n", [float("inf")]),
    ],
)
def test_a_damaged_point_is_refused(key: str, value: object) -> None:
    body = document()
    body["points"][1][key] = value
    with pytest.raises(InputError, match=rf"p\.json: points\[1\]\.{key}.*teach again without --resume"):
        taught_path_from_json(json.dumps(body), "p.json")


def test_text_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "points.json").write_bytes(b"\xff")
    with pytest.raises(InputError, match="cannot be read"):
        read_taught_path(tmp_path / "points.json", "ab", "cd")
    with pytest.raises(InputError, match="a nesting that is too large"):
        taught_path_from_json("[" * 100_000, "p.json")
