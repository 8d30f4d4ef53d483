"""Numbers as text: digits by the uncertainty, no exponents where a person reads, counts as counts."""

import math

import pytest

from gateway.result.numerals import plus_minus, significant, with_degrees, with_interval


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (131072.0, 6, "131072"),
        (131072.0, 3, "131000"),
        (0.00123, 2, "0.0012"),
        (-84210.0, 4, "\N{MINUS SIGN}84210"),
        (1.0, 3, "1"),
        (0.0, 3, "0"),
        (9.996, 3, "10"),
        (3e-14, 2, "3\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}10\u207b\u00b9\u2074"),
        (4.2e9, 2, "4.2\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}10\u2079"),
        (math.nan, 3, "\N{EN DASH}"),
    ],
)
def test_a_number_is_written_out_with_its_significant_digits(value, digits, text):
    assert significant(value, digits) == text


@pytest.mark.parametrize(
    ("value", "half", "texts"),
    [
        (71697.0, 45195.0, ("72000", "45000")),
        (84210.0, 99.4, ("84210", "99")),
        (6.04, 0.1, ("6.04", "0.10")),
        (6.0, 0.0, ("6.00", "0.00")),
        (6.0412, math.nan, ("6.041", "")),
        (math.nan, 1.0, ("unknown", "")),
    ],
)
def test_a_half_width_has_two_digits_and_the_value_as_many_places(value, half, texts):
    assert plus_minus(value, half) == texts


def test_an_interval_is_196_hundredths_of_the_standard_deviation():
    assert with_interval(0.012, 0.02, 100.0) == "1.2 \N{PLUS-MINUS SIGN} 3.9"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("joint 2 stands at 0.500 rad, outside", "joint 2 stands at 0.500 rad (28.6 deg), outside"),
        ("limits -1 to 1 rad", "limits -1 to 1 rad (-57.3 to 57.3 deg)"),
        ("at [0.0000, 1.000] rad; ", "at [0.0000, 1.000] rad ([0, 57.3] deg); "),
        ("its limit is 0.5 rad/s", "its limit is 0.5 rad/s (28.6 deg/s)"),
        ("3.6 mrad away", "3.6 mrad (0.206 deg) away"),
        ("tilt \u22120.01 rad", "tilt \u22120.01 rad (-0.573 deg)"),
        ("write zero_offset_rad = 0.5", "write zero_offset_rad = 0.5"),
        ("90 rad is beyond 6.283, these are degrees", "90 rad is beyond 6.283, these are degrees"),
        ("0.3 rad (17.2 deg)", "0.3 rad (17.2 deg)"),
        ("5 Nm/rad and 3 radians", "5 Nm/rad and 3 radians"),
    ],
)
def test_degrees_stand_beside_radians(text, shown):
    assert with_degrees(text) == shown
