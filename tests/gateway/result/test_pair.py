"""Runs of two arms as files: what can be drawn is taken, anything else is refused by name."""

from __future__ import annotations

import dataclasses
import json
import math

import jsonschema
import pytest

from gateway.errors import InputError
from gateway.result.pair import CycleSummary, LinkStatistics, PairRunResult, Skew
from gateway.result.values import decoded, plain_values, schema_of


def example() -> PairRunResult:
    return PairRunResult(
        name="C8",
        text="learned on the run",
        speed=1.5,
        s_m=(0.0, 0.1),
        x_m=(0.9, 1.0),
        first_n=(1.0, math.nan),
        last_n=(0.5, 0.2),
        knots_s_m=(0.0,),
        cycles=(CycleSummary(cycle=1, learned=True, function="first", knots=9, force_n=12.5, at_command=1),),
        statistics=LinkStatistics("real", (900, 900), (0, 1), (0, 0), Skew(1e-5, 2e-5, 3e-5)),
        learning_s=0.01,
        evaluation_s=5e-5,
    )


def read(**changes: object) -> PairRunResult:
    return decoded(PairRunResult, plain_values(example()) | changes, "run.json")


def test_a_run_comes_back() -> None:
    assert plain_values(read()) == plain_values(example())
    assert math.isnan(read().first_n[1])
    assert read().statistics == example().statistics


def test_the_schema_takes_what_is_written_and_what_an_older_writer_left_out() -> None:
    schema, body = schema_of(PairRunResult), plain_values(example())
    jsonschema.validate(body, schema)
    del body["statistics"], body["learning_s"], body["evaluation_s"], body["cycles"][0]["gap_m"]
    jsonschema.validate(body, schema)
    assert decoded(PairRunResult, body, "run.json").statistics is None


def test_a_key_of_a_quantity_that_was_not_measured_is_absent() -> None:
    assert "last_m" not in plain_values(example())
    gap = dataclasses.replace(example(), first_n=(), last_n=(), first_m=(0.0, 1e-4), last_m=(0.0, 1e-5))
    assert "last_n" not in plain_values(gap)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("speed", "1", "speed: expected a number"),
        ("speed", 1e300, "speed: "),
        ("s_m", [0.0], "s_m: "),
        ("x_m", [], "x_m: 2 numbers are needed"),
        ("last_n", [0.5], "lists of one length"),
        ("last_n", [], "either last_n or last_m"),
        ("first_n", [1.0, 1e999], "first_n[1]: "),
        ("cycles", [{"force_n": "much"}], "cycles[0].force_n: expected a number"),
        ("cycles", [{"knots": -1}], "cycles[0].knots: "),
        ("cycles", [3], "cycles[0]: expected an object"),
        ("name", 5, "name: expected text"),
        ("text", "\x07", "text: holds a character"),
        ("statistics", {"pacing": "slow"}, "statistics.pacing: 'slow' is not"),
    ],
)
def test_a_run_that_cannot_be_drawn_is_refused(key: str, value: object, says: str) -> None:
    with pytest.raises(InputError) as caught:
        read(**{key: value})
    assert str(caught.value).startswith("run.json: ")
    assert says in str(caught.value)


def test_text_that_no_file_can_hold_is_refused() -> None:
    with pytest.raises(InputError):
        read(text="\ud800")


def test_unknown_keys_are_passed_over() -> None:
    assert json.dumps(plain_values(read(more=1))) == json.dumps(plain_values(example()))
