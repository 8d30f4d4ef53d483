"""The page on a result: what it shows, and no figure without its data."""

import json
import re

import pytest

from gateway.report.render import render
from gateway.result.result import from_json


def read(body):
    """The result that a file of this content holds."""
    return from_json(json.dumps(body))


@pytest.fixture(scope="module")
def page(full_result):
    return render(read(full_result))


@pytest.mark.parametrize(
    "text",
    [
        "25.03 kg",
        "The model lacked a balancer spring on J2",
        "Is the model good?",
        "What was wrong?",
        "Evidence.",
        "Centre of gravity of the load",
        "Poses measured",
        "Measured and modelled torque",
        "Residual per axis and pose",
        "Residual over posture and approach direction",
        "Load before and after.",
        "Friction band per axis",
        "What to measure next",
        "48211",
        "datasheet p. 12",
        "read from drive 0x6076",
        "warm the axis up and repeat",
        "accepted by, date",
    ],
)
def test_the_page_shows(page, text):
    assert text in page


def test_there_are_six_drawings_per_axis_and_one_per_pose(page):
    assert len(re.findall(r'aria-label="Residual of J\d for', page)) == 6
    assert len(re.findall(r'aria-label="Residual of J\d against posture', page)) == 6
    assert len(re.findall(r'aria-label="Torque of J\d', page)) == 6
    assert len(re.findall(r'aria-label="The arm in', page)) == 14
    assert page.count("balancer spring as a curve") == 1


def test_a_bare_result_of_the_contract_is_enough(full_result):
    keys = ("schema", "robot", "loads", "verdict", "effects", "before", "after", "holdout_kind", "noise_floor_nm",
            "friction_band_nm", "rejected", "next", "findings", "provenance")  # fmt: skip
    page = render(read({key: full_result[key] for key in keys}))
    assert "25.03 kg" in page
    assert "Poses measured" not in page
    assert "None" not in page


def test_a_nearly_empty_result_is_enough():
    page = render(read({"schema": 1, "robot": "r", "loads": []}))
    assert "Unloaded arm" in page
    assert "None" not in page


def test_words_from_the_data_stay_words(result):
    result["robot"] = "<b>bold</b>"
    result["loads"][0]["label"] = "<script>alert(1)</script>"
    result["rows"]["load"] = ["<i>x</i>"] * len(result["rows"]["load"])
    page = render(read(result))
    assert "<script" not in page
    assert "<b>bold" not in page
    assert "<i>x" not in page


def test_axes_without_torque_have_no_drawing(result):
    for row in result["rows"]["tau_nm"]:
        row[0] = None
    page = render(read(result))
    assert len(re.findall(r'aria-label="Residual of J\d for', page)) == 5
    assert len(re.findall(r'aria-label="Residual of J\d against posture', page)) == 5


def test_a_long_moving_run_is_drawn_as_a_line(result):
    rows = result["rows"]
    count = 4000
    short = len(rows["load"])
    for key in rows:
        rows[key] = [rows[key][index % short] for index in range(count)]
    rows["load"] = ["none"] * count
    rows["pose"] = [-1] * count
    result["data"] |= {"model_before_nm": [], "role": []}
    page = render(read(result))
    assert 'class="model-line"' in page
    assert len(page) < 6e6


def test_what_contradicts_a_statement_is_read_before_any_value(result):
    result["findings"] = [
        {"severity": "info", "where": "J6", "what": "wide friction band"},
        {"severity": "warn", "where": "J2", "what": "link masses are contradicted"},
        {"severity": "fail", "where": "J4", "what": "torque sign is reversed"},
    ]
    page = render(read(result))
    places = [
        page.index(text) for text in ("sign is reversed", "are contradicted", "Centre of gravity", "wide friction")
    ]
    assert places == sorted(places)
    assert page.count("are contradicted") == 1


def test_sources_findings_and_questions_may_say_less(result):
    result["data"]["sources"] = [{"file": "table.csv", "kind": "measured table", "visits": 3}]
    result["next"] = [{"what": "hang a known load"}]
    result["findings"] = [{"severity": "fail", "where": "J4", "what": "torque sign is reversed"}]
    page = render(read(result))
    assert all(text in page for text in ("table.csv", "hang a known load", "torque sign is reversed"))


def test_the_certificate_states_values_traceability_and_a_place_to_sign(result):
    page = render(from_json(json.dumps(result)))
    section = page[page.index('<section class="certificate">') :]
    assert "NOT TRACEABLE" in section
    # 1.96 x 0.11 kg, by two digits of the uncertainty
    assert re.search(r"mass</td>.*25\.03</td>.*0\.22</td>.*1\.96</td>", section)
    assert section.count('<div class="sign">') == page.count('<div class="sign">') == 1


def test_a_certificate_of_a_refused_load_has_no_table(result):
    result["loads"] = [{"label": "b", "mass_kg": None, "refused": "rows contradict each other"}]
    result["after"]["loads"] = result["loads"]
    page = render(from_json(json.dumps(result)))
    section = page[page.index('<section class="certificate">') : page.index('<div class="sign">')]
    assert "No value is certified: rows contradict each other" in section
    assert "<table" not in section
