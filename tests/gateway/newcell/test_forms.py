"""What a typed line and a value of an answer file may look like."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from gateway.newcell import questions
from gateway.newcell.forms import SHARE, node_ids, number_or_none, pairs, per_axis, place, typed, typed_answer, words


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("101", 101),
        ("0.8", 0.8),
        ("[1, 2]", [1, 2]),
        ("1, -1, 1", [1, -1, 1]),
        ("[[-1, 1], [0, 2.5]]", [[-1, 1], [0, 2.5]]),
        ("floor", "floor"),
        ("socketcan:can0", "socketcan:can0"),
        ("a.toml, b.toml", ["a.toml", "b.toml"]),
        ("true", True),
        ("0x0B, 12", [11, 12]),
        ("1:160, 1:101", ["1:160", "1:101"]),
        ("-170, 170 deg", ["-170 deg", "170 deg"]),
        ("[-170, 170] deg", ["-170 deg", "170 deg"]),
        ("85 %, 80 %", ["85 %", "80 %"]),
    ],
)
def test_a_typed_line_is_what_toml_makes_of_it_or_text(line, value):
    assert typed(line) == value


def test_one_value_counts_for_all_axes():
    assert per_axis()(101, 3) == (101.0, 101.0, 101.0)
    assert per_axis()([101], 2) == (101.0, 101.0)
    assert pairs()([-1, 2], 2) == ((-1.0, 2.0), (-1.0, 2.0))
    assert words("a", 2) == ("a", "a")


def test_one_value_for_each_axis():
    assert per_axis()([1, 2, 3], 3) == (1.0, 2.0, 3.0)
    assert pairs()([[-1, 2], [0, 1]], 2) == ((-1.0, 2.0), (0.0, 1.0))
    assert [type(part) for part in node_ids([11, 12], 2)] == [int, int]
    assert place(floor=(0, 0, -9.8))("floor", 2) == (0, 0, -9.8)
    assert number_or_none()("none", 2) is None


@pytest.mark.parametrize(
    ("form", "value", "words"),
    [
        (per_axis(), [1, 2], "has 2 values but the arm has 3 axes"),
        (per_axis(), "many", "holds 'many', which is not a number"),
        (per_axis(), math.nan, "which is not a number"),
        (per_axis(SHARE), 80, "holds 80, which is not in 0 to 1"),
        (per_axis(), True, "which is not a number"),
        (node_ids, 5, "has 1 values but the arm has 3 axes"),
        (node_ids, [1, 2, 128], "holds 128, which is not a node id"),
        (node_ids, [1, 2, 2.5], "holds 2.5, which is not a node id"),
        (pairs(), [[-1, 1]], "neither a pair"),
        (pairs(), [2, 1], "whose first value is not below the second"),
        (place(floor=(0, 0, -9.8)), "wall", "not a list of three numbers or no `floor`"),
        (words, 3, "neither a text nor a list of texts"),
    ],
)
def test_a_form_that_is_not_kept_is_said_in_words(form, value, words):
    with pytest.raises(ValueError, match=words):
        form(value, 3)


def test_every_question_has_a_key_of_its_own():
    assert len(set(questions.KEYS)) == len(questions.KEYS)


def read(question, line, axes=1):
    return question.form(typed(line), axes)


@pytest.mark.parametrize(
    ("question", "line", "value"),
    [
        (questions.GEAR_RATIO, "1:160", (160.0,)),
        (questions.GEAR_RATIO, "160:1", (160.0,)),
        (questions.GEAR_RATIO, "-1:101", (-101.0,)),
        (questions.GEAR_EFFICIENCY, "85 %", (0.85,)),
        (questions.TORQUE_CONSTANT, "210 mNm/A", (0.21,)),
        (questions.TORQUE_CONSTANT, "0.21 Nm/A", (0.21,)),
        (questions.SPEED_LIMIT, "90 deg/s", (math.pi / 2,)),
        (questions.TORQUE_LIMIT, "1.5 kNm", (1500.0,)),
        (questions.POSITION_LIMIT, "-90, 180 deg", ((-math.pi / 2, math.pi),)),
        (questions.FLANGE, "0, 0, 60 mm", (0.0, 0.0, 0.06)),
        (questions.FLANGE_TURN, "0, 90, 0 deg", (0.0, math.pi / 2, 0.0)),
        (questions.RATED_LOAD, "5000 g", 5.0),
        (questions.RATED_LOAD, "none", None),
    ],
)
def test_a_number_may_be_written_as_on_the_data_sheet(question, line, value):
    found = read(question, line)
    assert question.form(line, 1) == found, "an answer file takes the same line as a text"
    np.testing.assert_allclose(np.array(found, dtype=float), np.array(value, dtype=float), rtol=1e-9)


@pytest.mark.parametrize(("line", "ids"), [("1-6", (1, 2, 3, 4, 5, 6)), ("11 - 14, 1, 2", (11, 12, 13, 14, 1, 2))])
def test_node_ids_may_be_a_range(line, ids):
    assert read(questions.NODES, line, 6) == questions.NODES.form(line, 6) == ids


@pytest.mark.parametrize(
    ("question", "line", "says"),
    [
        (questions.GEAR_RATIO, "0:160", "1:160"),
        (questions.TORQUE_CONSTANT, "210 Nm", "for example 1 Nm/A, 1 mNm/A"),
        (questions.GEAR_EFFICIENCY, "850 %", "holds 8.5, which is not in 0 to 1"),
        (questions.GEAR_EFFICIENCY, "85 Nm", "1 %"),
        (questions.NODES, "1-", "example: 1-6"),
        (questions.NODES, "100-140", "give one per axis; example: 1-6"),
    ],
)
def test_what_is_refused_comes_with_an_example(question, line, says):
    with pytest.raises(ValueError, match=re.escape(says)):
        read(question, line, 1)


def test_a_typed_answer_may_name_its_source():
    assert typed_answer("101, 160; data sheet p. 4") == {"value": [101, 160], "source": "data sheet p. 4"}
