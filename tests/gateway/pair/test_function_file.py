"""Functions as files: everything comes back, nothing foreign is taken."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gateway.errors import InputError
from gateway.pair.transform_function import (
    TransformFunction,
    from_json,
    read_stored,
    refuse_foreign,
    stored_function,
    transform_of,
)
from gateway.result.pair import StoredFunction
from gateway.result.values import json_text


def example() -> StoredFunction:
    rng = np.random.default_rng(3)
    turn = Rotation.from_rotvec(0.1 * rng.normal(size=(4, 3))).as_matrix()
    function = TransformFunction(np.cumsum(rng.uniform(0.1, 0.2, 4)), rng.normal(size=(4, 3)), turn)
    return stored_function(
        function, path_hash="ab" * 32, cell_hash="cd" * 32, stage="second", learn_source="command", speed=1.5,
        date="2026-01-31T12:00:00Z", embodiment="C8", cycles=12,
    )  # fmt: skip


def test_everything_comes_back_to_the_last_bit() -> None:
    stored = example()
    again = from_json(json_text(stored), "f.json")
    assert again == stored
    assert np.array_equal(transform_of(again).knots, transform_of(stored).knots)


def test_file_states_units_frames_and_origin() -> None:
    document = json.loads(json_text(example()))
    assert document["units"] == {"s_m": "m", "position_m": "m", "rotation": "1"}
    assert set(document["frames"]) == {"from", "to"}
    assert document["learn_source"] == "command"
    assert document["speed"] == 1.5


def test_other_path_and_other_cell_are_refused_with_the_reason() -> None:
    stored = example()
    refuse_foreign(stored, "ab" * 32, "cd" * 32, "f.json")
    with pytest.raises(InputError, match=r"f\.json: is valid for another path"):
        refuse_foreign(stored, "00" * 32, "cd" * 32, "f.json")
    with pytest.raises(InputError, match=r"f\.json: was made in another cell"):
        refuse_foreign(stored, "ab" * 32, "00" * 32, "f.json")


def damaged(change: dict[str, object]) -> str:
    return json.dumps(json.loads(json_text(example())) | change)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "one JSON object is expected"),
        (damaged({"kind": "x"}), "is not a file of kind 'servo-gateway transform function'"),
        (damaged({"schema": 2}), "schema: this version reads schema 1, the file says 2"),
        (damaged({"units": {"s_m": "mm"}}), "units"),
        (damaged({"stage": "third"}), "stage"),
        (damaged({"path_hash": 3}), "path_hash"),
        (damaged({"speed": "fast"}), "speed"),
        (damaged({"speed": -1}), "speed"),
        (damaged({"knots": []}), "knots"),
        (damaged({"knots": [{"s_m": 0.0}]}), r"knots\[0\]\.position_m: the key is missing"),
        (
            damaged({"knots": [{"s_m": 0.0, "position_m": [0, 0], "rotation": [[1, 0, 0]]}]}),
            r"knots\[0\]\.position_m: three",
        ),
        (damaged({"knots": [{"s_m": 0.0, "position_m": [0, 0, 0], "rotation": [[1, 0, 0]]}]}), "needs N arc lengths"),
        (damaged({"knots": [{"s_m": "a", "position_m": [0, 0, 0], "rotation": [[1, 0, 0]] * 3}]}), "f.json"),
    ],
)
def test_damaged_files_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        from_json(text, "f.json")


@pytest.mark.parametrize("value", [1e300, 10**400, "1e999"])
@pytest.mark.parametrize("key", ["s_m", "position_m", "rotation"])
def test_numbers_beyond_any_robot_are_refused(key: str, value: object) -> None:
    document = json.loads(json_text(example()))
    knot = document["knots"][-1]
    knot[key] = {"s_m": value, "position_m": [0.0, value, 0.0], "rotation": [[1, 0, 0], [0, value, 0], [0, 0, 1]]}[key]
    with pytest.raises(InputError, match=r"f\.json"):
        from_json(json.dumps(document).replace('"1e999"', "1e999"), "f.json")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "first.json").write_bytes(b"\x80{}")
    with pytest.raises(InputError, match="cannot be read"):
        read_stored(tmp_path / "first.json")


def test_knots_out_of_order_are_refused() -> None:
    document = json.loads(json_text(example()))
    document["knots"].reverse()
    with pytest.raises(InputError, match="out of order"):
        from_json(json.dumps(document), "f.json")


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5), lambda inner: st.lists(inner, max_size=4)
    )
)
def test_any_knots_either_load_or_are_refused(value: object) -> None:
    document = json.loads(json_text(example()))
    document["knots"][1]["position_m"] = value
    try:
        loaded = from_json(json.dumps(document), "f.json")
    except InputError:
        return
    assert np.isfinite(transform_of(loaded).position_m).all()
