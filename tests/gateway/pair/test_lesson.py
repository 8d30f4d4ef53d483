"""Taught points as a file: everything comes back, nothing damaged is taken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.errors import InputError
from gateway.pair.lesson import Lesson, TaughtPoint, lesson_from_json, read_lesson
from gateway.pair.stored_run import check_run


def document() -> dict[str, Any]:
    points = [TaughtPoint(10 * k, 0.1 * k, np.eye(4), np.full(6, 1e-4), (8.0, 2.0), (1.0, 0.2)) for k in range(3)]
    return json.loads(Lesson("ab", "cd", points).to_json())


def test_points_come_back(tmp_path: Path) -> None:
    path = tmp_path / "points.json"
    path.write_text(json.dumps(document()), encoding="utf-8")
    lesson = read_lesson(path, "ab", "cd")
    assert [point.index for point in lesson.points] == [0, 10, 20]
    assert lesson.points[2].correction.tolist() == [1e-4] * 6
    assert lesson.points[1].forces_n == (8.0, 2.0)
    assert json.loads(lesson.to_json()) == document()
    with pytest.raises(InputError, match="another path"):
        read_lesson(path, "ab", "other")


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
    with pytest.raises(InputError, match=r"p\.json: is no file of taught points"):
        lesson_from_json(json.dumps(body), "p.json")


def test_text_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "points.json").write_bytes(b"\xff")
    with pytest.raises(InputError, match="cannot be read"):
        read_lesson(tmp_path / "points.json", "ab", "cd")
    with pytest.raises(InputError, match="no file of taught points"):
        lesson_from_json("[" * 100_000, "p.json")


def run(**changes: object) -> dict[str, object]:
    body = {
        "name": "C8",
        "text": "learned",
        "speed": 1.0,
        "s_m": [0.0, 0.1],
        "x_m": [0.9, 1.0],
        "first_n": [1.0, float("nan")],
        "last_n": [0.5, 0.2],
        "knots_s_m": [0.0],
        "cycles": [{"force_n": 1.0, "moment_nm": None, "knots": 3, "more": 1}],
    }
    return body | changes


def test_a_run_whose_force_is_not_known_everywhere_is_taken() -> None:
    check_run(run(), "run.json")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("speed", "1"),
        ("speed", 1e300),
        ("s_m", [0.0]),
        ("x_m", []),
        ("last_n", [0.5]),
        ("first_n", [1.0, float("inf")]),
        ("cycles", [{"force_n": "much"}]),
        ("cycles", [3]),
        ("name", 5),
        ("text", "\ud800"),
    ],
)
def test_a_run_that_cannot_be_drawn_is_refused(key: str, value: object) -> None:
    with pytest.raises(InputError, match=r"run\.json: "):
        check_run(run(**{key: value}), "run.json")
