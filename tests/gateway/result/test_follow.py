"""What `follow` hands over as a file: it comes back whole, and a broken one is refused by name."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import jsonschema
import pytest

from gateway.errors import InputError
from gateway.result.follow import ComputingTime, FollowResult, PeakRatio, follow_from_json
from gateway.result.result import Finding
from gateway.result.values import json_text, plain_values, schema_of
from tests.support.pages.other import comparison


def example() -> FollowResult:
    """Every part of the file, and values that are not known."""
    return replace(
        comparison(),
        ratio=PeakRatio({"maximum": (0.5,) * 6, "identified": (0.1,) * 6}, (0.2,) * 6),
        computing_s=ComputingTime(4e-5, 6e-5, 1e-4, 1200),
        left_out_syncs=2,
        findings=(Finding("info", "bus", "2 of 1200 SYNCs are left out"),),
    )


def test_everything_comes_back() -> None:
    text = json_text(example())
    assert json_text(follow_from_json(text, "f.json")) == text
    assert math.isnan(follow_from_json(text, "f.json").series.error["off"].error_rad[0][1])
    assert list(json.loads(text))[:2] == ["schema", "kind"]
    jsonschema.validate(json.loads(text), schema_of(FollowResult))


def without(*keys: str) -> dict[str, Any]:
    body = plain_values(example())
    part = body
    for key in keys[:-1]:
        part = part[key]
    del part[keys[-1]]
    return body


def changed(**changes: object) -> dict[str, Any]:
    return plain_values(example()) | changes


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (without("robot"), "robot: the key is missing"),
        (without("path", "duration_s"), "path.duration_s: the key is missing"),
        (without("kind"), "is not a file of kind 'follow'"),
        (changed(schema=2), "this version reads schema 1"),
        (changed(left_out_syncs="two"), "left_out_syncs: expected an integer"),
        (
            plain_values(example()) | {"series": {"error": {"off": {"time_s": [0], "error_rad": [[1, 2]]}}}},
            "one length",
        ),
        (
            plain_values(example()) | {"findings": [{"severity": "bad", "where": "", "what": ""}]},
            "findings[0].severity",
        ),
    ],
)
def test_a_broken_file_is_refused_with_its_path(body: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        follow_from_json(json.dumps(body), "f.json")
    assert str(caught.value).startswith("f.json: ")
    assert says in str(caught.value)
