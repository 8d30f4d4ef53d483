"""The result file: round trip, null for unknown, typed errors."""

import contextlib
import dataclasses
import json
import math

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.errors import InputError
from gateway.result.result import (
    Bare,
    EffectResult,
    Evidence,
    Finding,
    FitSummary,
    LoadResult,
    NextMeasurement,
    Parameter,
    Rejected,
    Result,
    Rows,
    from_json,
    json_schema,
    to_dict,
    to_json,
)

NAN = math.nan


def example() -> Result:
    load = LoadResult(
        "a", 21.0, 0.2, (0.01, 0.0, 0.18), (0.004, 0.004, 0.006), com_flange_m=(0.01, 0.0, 0.08),
        correlation=((1.0, 0.0), (0.0, 1.0)), per_pose_mass_kg={"1": 21.2},
    )  # fmt: skip
    summary = FitSummary((1.0, NAN, 2.0, 3.0, 4.0, 5.0), (NAN,) * 6, (load,))
    return Result(
        robot="kr300",
        loads=(load, LoadResult("b", refused="five rows exceed the rated torque")),
        verdict="explained",
        effects=(EffectResult("balancer_spring", (2,), {"stiffness_n_m": 1.0}, {}, Evidence(0.47, 1e-9, "x", 1e4)),),
        before=summary,
        after=summary,
        holdout_kind="fresh",
        rejected=(Rejected("base_tilt", (), 1.0),),
        next=(NextMeasurement("measure", ((0.0,) * 6,), ("base_tilt", "joint_zero_offset")),),
        findings=(Finding("fail", "J4", "torque sign is reversed", "swap"),),
        provenance={"gear_ratio": [210, "datasheet"]},
        parameters=(Parameter("friction", 1.0, 0.1, "Nm"),),
        rows=Rows(run=("r",), load=("a",), pose=(1,), q_rad=((0.0,) * 6,)),
        bare=Bare("kr300", (0.0, 0.0, -9.80665), (0,), ("m1",), (1.0,), ((0.1,),), ((1.0, *[0.0] * 23),)),
    )


def bare(**changes):
    body = {
        "robot": "r",
        "gravity_m_s2": [0.0, 0.0, -9.8],
        "columns": [0, 1],
        "names": ["m1", "hx1"],
        "value": [1.0, 0.1],
        "covariance": [[1.0, 0.0], [0.0, 1.0]],
        "combination": [[0.0] * 24, [0.0] * 24],
    }
    return body | changes


def test_a_bare_identification_of_one_rank_is_taken():
    data = json.loads(to_json(example())) | {"bare": bare()}
    found = from_json(json.dumps(data)).bare
    assert found is not None
    assert found.value == (1.0, 0.1)


def test_round_trip_keeps_every_value():
    text = to_json(example())
    again = from_json(text)
    assert to_json(again) == text
    assert again.effects == example().effects
    assert again.loads[1].refused == "five rows exceed the rated torque"
    assert again.failed


def test_unknown_is_null_and_reads_back_as_nan():
    data = json.loads(to_json(example()))
    assert data["loads"][1]["mass_kg"] is None
    assert data["loads"][1]["com_m"] is None
    assert data["before"]["rms_nm"][1] is None
    assert math.isnan(from_json(to_json(example())).loads[1].mass_kg)


def test_keys_that_say_nothing_are_absent():
    first, second = to_dict(example())["loads"]
    assert "refused" not in first
    assert "com_flange_m" not in second
    assert "rows" not in to_dict(Result(robot="r"))


def test_the_schema_takes_what_is_written_and_refuses_what_is_not_read():
    schema = json_schema()
    jsonschema.validate(to_dict(example()), schema)
    for change in ({"robot": 3}, {"loads": {}}, {"verdict": "perhaps"}, {"loads": [{"mass_kg": 1.0}]}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(to_dict(example()) | change, schema)


def test_keys_of_a_newer_writer_survive():
    data = json.loads(to_json(example())) | {"truth": {"loads": [1]}}
    assert json.loads(to_json(from_json(json.dumps(data))))["truth"] == {"loads": [1]}


def test_numpy_values_are_written_as_numbers():
    result = dataclasses.replace(example(), quality={"sigma_nm": np.array([1.0, np.nan]), "rank": np.int64(4)})
    assert json.loads(to_json(result))["quality"] == {"sigma_nm": [1.0, None], "rank": 4}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": 2}, "schema"),
        ({"robot": 3}, "robot: expected text"),
        ({"loads": {}}, "loads: expected a list"),
        ({"loads": [{"mass_kg": 1.0}]}, "loads[0].label: the key is missing"),
        ({"loads": [{"label": "a", "mass_kg": "heavy"}]}, "loads[0].mass_kg: expected a number"),
        ({"loads": [{"label": "a", "mass_kg": True}]}, "loads[0].mass_kg: expected a number"),
        ({"verdict": "perhaps"}, "verdict: 'perhaps'"),
        ({"holdout_kind": "none"}, "holdout_kind: 'none' is not"),
        ({"findings": [{"severity": "bad", "where": "J1", "what": "x"}]}, "findings[0].severity: 'bad' is not"),
        ({"loads": [{"label": "a", "com_m": [0.0, 0.1]}]}, "loads[0].com_m: three numbers"),
        ({"loads": [{"label": "a", "mass_kg": 10**400}]}, "too large to hold"),
        ({"loads": [{"label": "a", "mass_kg": 1e300}]}, "loads[0]: a mass or a place"),
        ({"bare": bare(combination=[[0.0] * 24])}, "bare.combination: 2 x 24"),
        ({"bare": bare(combination=[[0.0] * 24, [0.0] * 23])}, "bare.combination: 2 x 24"),
        ({"bare": bare(covariance=[[1.0, 0.0], []])}, "bare.covariance: 2 x 2"),
        ({"bare": bare(gravity_m_s2=[0.0, 0.0])}, "bare.gravity_m_s2"),
        ({"bare": bare(value=[1e300, 0.0])}, "bare.value: a number beyond"),
        ({"before": {"loads": [{"label": "a", "com_m": [0.0]}]}}, "before.loads[0].com_m: three numbers"),
        ({"rows": {"load": ["a", "b"], "tau_nm": [[1.0]]}}, "rows: lists of one length"),
        ({"rows": {"load": ["a", "b"], "tau_nm": [[1.0], [1.0, 2.0]]}}, "rows: one number per axis"),
        (
            {"data": {"curves": [{"name": "x", "x": [1.0], "y": []}, {"x": []}]}},
            "data.curves[1].name: the key is missing",
        ),
        ({"data": {"curves": [{"name": "x", "x": [1.0], "y": [1.0, 2.0]}]}}, "data.curves[0]: lists of one length"),
        ({"data": {"poses": [{"pose": 1, "load": "a", "points_m": [[0.0]]}]}}, "data.poses[0].points_m[0]: three"),
        ({"data": {"flange": {"a": {"com_std_m": [0.1, 0.1, 0.1]}}}}, "data.flange.a.correlation: the key is missing"),
        ({"effects": [{"name": "x", "joints": [1.5]}]}, "effects[0].joints[0]: expected an integer"),
    ],
)
def test_a_wrong_file_is_refused_with_its_path(change, says):
    data = json.loads(to_json(example())) | change
    with pytest.raises(InputError) as caught:
        from_json(json.dumps(data), "out.json")
    assert says in str(caught.value)
    assert str(caught.value).startswith("out.json")


@pytest.mark.parametrize("text", ["", "[1]", "{", '{"schema": 1}', "null"])
def test_text_that_is_no_result_is_refused(text):
    with pytest.raises(InputError):
        from_json(text)


KEYS = st.sampled_from(["loads", "label", "effects", "before", "rows", "robot"])
ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(), lambda x: st.lists(x) | st.dictionaries(KEYS, x)
)


@given(ANY_JSON)
def test_any_content_of_the_file_raises_input_error_only(value):
    data = {"schema": 1, "robot": "r", "loads": value, "before": value, "rows": value}
    with contextlib.suppress(InputError):
        from_json(json.dumps(data))
