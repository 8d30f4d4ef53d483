"""Scales, ticks and marks."""

import math
import xml.etree.ElementTree as ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.report.svg import Panel, Scale, limits, tick_text, ticks


def test_scale_is_linear_and_may_run_backwards():
    scale = Scale(0.0, 10.0, 200.0, 100.0)
    assert [scale(value) for value in (0.0, 5.0, 10.0)] == [200.0, 150.0, 100.0]


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]), (-120.0, 95.0, [-100.0, -50.0, 0.0, 50.0]), (3.0, 3.0, [3.0])],
)
def test_ticks_are_round(low, high, expected):
    assert ticks(low, high) == pytest.approx(expected)


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e6))
def test_ticks_stay_inside_and_are_neither_few_nor_many(low, span):
    values = ticks(low, low + span)
    assert all(low - 1e-6 * span <= value <= low + span * (1 + 1e-6) for value in values)
    assert 3 <= len(values) <= 11


def test_tick_text_has_the_decimals_of_its_step_and_a_minus_sign():
    assert [tick_text(value, 0.25) for value in (-0.25, 0.0, -0.0)] == ["\N{MINUS SIGN}0.2", "0.0", "0.0"]
    assert tick_text(1500.0, 500.0) == "1500"


def test_limits_ignore_what_is_not_finite():
    low, high = limits([1.0, math.nan, 3.0, math.inf], pad=0.5)
    assert (low, high) == (0.0, 4.0)
    assert limits([]) == (-1.0, 1.0)
    assert limits([2.0])[0] < 2.0 < limits([2.0])[1]


def test_a_panel_is_well_formed_and_its_text_cannot_leave_its_place():
    panel = Panel(200.0, 100.0, (0.0, 1.0), (-1.0, 1.0), left=60.0)
    panel.x_axis("q2 [rad]")
    panel.y_axis("torque [Nm]")
    panel.dot(0.5, 0.0, "dot", "<script>alert(1)</script>")
    panel.text(0, 0, "a & b", "label")
    root = ElementTree.fromstring(str(panel.svg('a "quoted" title')))
    assert root.get("viewBox") == "0 0 200 100"
    assert not [node for node in root.iter() if node.tag == "script"]
    circle = next(node for node in root.iter() if node.tag == "circle")
    assert (float(circle.get("cx")), float(circle.get("cy"))) == (124.0, 36.0)
