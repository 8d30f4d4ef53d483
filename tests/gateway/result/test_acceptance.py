"""Pass, fail or cannot tell: by numbers on either side of each limit; and the same as JUnit."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from xml.etree import ElementTree

import pytest

from gateway.errors import InputError
from gateway.result.acceptance import (
    Expected,
    Rating,
    accepted,
    check_expected,
    no_body,
    not_hung,
    outcome_of,
    parse_expected,
)
from gateway.result.drawn import Drawn, Spread
from gateway.result.junit import junit
from gateway.result.result import Finding, LoadResult, Result, from_json, to_json

#: 0.1 / 1.96: half of the 95 % interval is 0.1 kg.
STD_KG = 0.1 / 1.96
LOAD = LoadResult("tool", 6.05, STD_KG, (0.0, 0.03, 0.04), (0.001,) * 3, com_flange_m=(0.0, 0.03, 0.04))
NO_CORRELATION = tuple(tuple(float(row == column) for column in range(4)) for row in range(4))
RESULT = Result("r", (LOAD,), data=Drawn(flange={"tool": Spread((0.001,) * 3, NO_CORRELATION)}))


@pytest.mark.parametrize(
    ("off", "half", "allowed", "outcome"),
    [
        (0.0, 0.1, 0.1, "pass"),
        (0.05, 0.1, 0.2, "pass"),
        (0.05, 0.1, 0.14, "cannot tell"),
        (0.25, 0.1, 0.15, "cannot tell"),
        (0.25, 0.1, 0.14, "fail"),
        (math.nan, 0.1, 0.1, "cannot tell"),
        (0.0, math.nan, 0.1, "cannot tell"),
    ],
)
def test_the_whole_interval_has_to_lie_on_one_side(off, half, allowed, outcome):
    assert outcome_of(off, half, allowed) == outcome


@pytest.mark.parametrize(
    ("mass_kg", "tolerance_kg", "outcome", "says"),
    [
        (6.0, 0.16, "pass", ""),
        (
            6.0,
            0.14,
            "cannot tell",
            "mass 6.05 ± 0.10 kg (95 %), allowed: 6 kg, tolerance 0.14 kg: cannot tell",
        ),
        (6.3, 0.14, "fail", "mass 6.05 ± 0.10 kg (95 %), allowed: 6.3 kg, tolerance 0.14 kg: fail"),
        (5.8, 0.14, "fail", "fail"),
    ],
)
def test_a_mass_is_held_against_what_was_expected(mass_kg, tolerance_kg, outcome, says):
    judged = accepted(RESULT, [Expected("tool", mass_kg, tolerance_kg)], ())
    (row,) = judged.acceptance
    assert (row.outcome, row.expected, row.tolerance) == (outcome, mass_kg, tolerance_kg)
    assert row.half_width == pytest.approx(0.1)
    assert judged.failed == (outcome != "pass")
    assert all(says in finding.what for finding in judged.findings)
    assert from_json(to_json(judged)).acceptance[0].outcome == outcome


@pytest.mark.parametrize(("mass_kg", "refused"), [(math.nan, None), (math.nan, "rows 9 and 10")])
def test_a_load_without_a_mass_is_never_accepted(mass_kg, refused):
    judged = accepted(
        replace(RESULT, loads=(replace(LOAD, mass_kg=mass_kg, refused=refused),)), [Expected("tool", 6.0, 1.0)], ()
    )
    assert [row.outcome for row in judged.acceptance] == ["cannot tell"]
    assert "mass unknown (95 %)" in judged.findings[0].what


@pytest.mark.parametrize(("most", "outcome"), [(6.16, "pass"), (6.0, "cannot tell"), (5.94, "fail")])
def test_a_mass_above_the_rating_fails(most, outcome):
    judged = accepted(RESULT, (), [Rating("mass", most, "rated load, datasheet p. 1")])
    assert [(row.what, row.outcome, row.most) for row in judged.acceptance] == [("rated mass", outcome, most)]
    assert "at most" in judged.findings[0].what if judged.failed else outcome == "pass"


def test_reach_and_moment_count_from_the_flange():
    """The centre is 0.05 m off; 6.05 kg there weigh 6.05 * 9.80665 * 0.05 Nm. Errors add up in squares."""
    judged = accepted(RESULT, (), [Rating("reach", 0.06, "p. 1"), Rating("moment", 2.0, "p. 1")])
    reach, moment = judged.acceptance
    assert (reach.value, reach.unit, reach.outcome) == (pytest.approx(0.05), "m", "pass")
    assert reach.half_width == pytest.approx(1.96 * 0.001)
    assert (moment.value, moment.unit, moment.outcome) == (pytest.approx(2.96651, rel=1e-5), "Nm", "fail")
    parts = (9.80665 * 0.05 * STD_KG, 9.80665 * 6.05 * 0.001)
    assert moment.half_width == pytest.approx(1.96 * math.hypot(*parts))


def test_reach_cannot_be_judged_without_the_flange():
    judged = accepted(replace(RESULT, data=None), (), [Rating("reach", 0.06, "p. 1"), Rating("mass", 10.0, "p. 1")])
    assert [row.outcome for row in judged.acceptance] == ["cannot tell", "pass"]


@pytest.mark.parametrize(
    ("mass_kg", "asked"), [(0.0, True), (-0.09, True), (0.099, True), (0.101, False), (-0.2, False)]
)
def test_an_interval_that_includes_zero_asks_whether_the_load_was_mounted(mass_kg, asked):
    found = not_hung([replace(LOAD, mass_kg=mass_kg)])
    assert [finding.severity for finding in found] == ["fail"] * asked
    assert all(
        re.fullmatch("\N{MINUS SIGN}?0[.][01][0-9] ± 0[.]10 kg: no load detected[.] Is it mounted[?]", each.what)
        for each in found
    )


@pytest.mark.parametrize(("mass_kg", "wrong"), [(-0.101, True), (-0.099, False), (0.2, False), (math.nan, False)])
def test_a_mass_below_zero_beyond_its_interval_is_no_body(mass_kg, wrong):
    found = no_body([replace(LOAD, mass_kg=mass_kg)])
    assert ["which no body has" in finding.what for finding in found] == [True] * wrong


@pytest.mark.parametrize("std_kg", [0.0, math.nan])
def test_a_load_that_is_known_or_unknown_is_not_asked_for(std_kg):
    assert not_hung([replace(LOAD, mass_kg=0.0, mass_std_kg=std_kg)]) == ()


@pytest.mark.parametrize(
    "text", ["", "tool", "tool=6", "tool=6,0", "tool=0,1", "tool=6,-1", "=6,1", "tool=6,1,2", "tool=a,b", "tool=nan,1"]
)
def test_an_expectation_is_label_mass_and_tolerance(text):
    with pytest.raises(InputError, match="LABEL=MASS,TOLERANCE"):
        parse_expected(text)


def test_an_expectation_is_of_a_load_that_is_there_and_given_once():
    assert parse_expected("a=b=12.5,0.2") == Expected("a=b", 12.5, 0.2)
    with pytest.raises(InputError, match="--expect toll: .*they hold: tool, other"):
        check_expected([Expected("toll", 1.0, 1.0)], ["tool", "other"])
    with pytest.raises(InputError, match="given twice"):
        check_expected([Expected("tool", 1.0, 1.0)] * 2, ["tool"])


ATTRIBUTES = {
    "testsuite": {"name", "timestamp", "hostname", "tests", "failures", "errors", "time", "id", "package"},
    "testcase": {"name", "classname", "time"},
    "failure": {"type", "message"},
}


def test_junit_has_what_build_servers_ask_for():
    """What the schemas of Ant and Jenkins want: these attributes, children in this order, numbers that add up."""
    judged = accepted(
        replace(
            RESULT,
            loads=(LOAD, replace(LOAD, label="b\x01<", mass_kg=0.0)),
            findings=(Finding("fail", "J2", "swap", "do"),),
        ),
        [Expected("tool", 6.0, 0.01), Expected("b\x01<", 9.0, 0.01)],
        (),
    )
    judged = replace(judged, findings=(*judged.findings, *not_hung(judged.loads)))
    text = junit(judged, datetime(2026, 3, 2, 14, 5, 6, tzinfo=UTC))
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>\n<testsuites')
    root = ElementTree.fromstring(text.encode())
    (suite,) = root
    assert [child.tag for child in suite] == ["properties", *["testcase"] * 5, "system-out", "system-err"]
    for element in suite.iter():
        assert ATTRIBUTES.get(element.tag, set()) <= set(element.attrib)
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("5", "4", "0")
    assert suite.get("timestamp") == "2026-03-02T14:05:06"
    kinds = [(case.get("classname"), [failure.get("type") for failure in case]) for case in suite.iter("testcase")]
    assert kinds == [
        ("load tool", []),
        ("load b <", ["not hung"]),
        ("load tool", ["cannot tell"]),
        ("load b <", ["fail"]),
        ("J2", ["finding"]),
    ]
