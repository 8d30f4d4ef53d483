"""Option codes and ramps of a drive, written down by hand: what lets the arm coast refuses motion."""

from __future__ import annotations

import math

import pytest

from drives.objects import OBJECTS
from drives.profile_file import load_profile, parse_profile
from gateway.cell.config import AxisConfig
from gateway.preflight.coasting import judge_coasting
from gateway.preflight.rules import Axis
from tests.data.axes import axis_table

PROFILE = load_profile("generic-cia402")
CONFIG = AxisConfig.model_validate(axis_table(4, -100))
#: 0.5 rad/s over a ratio of 100 is 50 rad/s, 477.46 rpm; the profile's velocity is in 0.01 rpm.
FULL_SPEED = 50 * 60 / (2 * math.pi) / 0.01
GOOD = {
    "quick_stop_option": 2,
    "shutdown_option": 1,
    "disable_operation_option": 1,
    "halt_option": 1,
    "fault_reaction_option": 2,
    "profile_deceleration": round(FULL_SPEED / 2.0),
    "quick_stop_deceleration": round(FULL_SPEED / 0.1),
}


def items(profile=PROFILE, **changes):
    values = {OBJECTS[name].address: value for name, value in (GOOD | changes).items()}
    return judge_coasting(Axis(4, CONFIG, profile), values)


def severities(name, **changes):
    return [item.severity for item in items(**changes) if f"({name})" in item.where]


def test_a_drive_that_stops_by_ramps_passes():
    assert not [item for item in items() if item.severity in ("warn", "fail")]


def test_a_drive_that_cuts_the_power_in_a_fault_is_refused():
    (found,) = [item for item in items(fault_reaction_option=0) if item.severity == "fail"]
    assert "coasts" in found.what
    assert found.advice
    assert found.where.startswith("J4 node 4")


@pytest.mark.parametrize("option", [0, 4, 5, 6, 7, 8, -2, 12])
@pytest.mark.parametrize("may_be_written", [True, False])
def test_a_quick_stop_option_that_does_not_end_disabled_is_written_for_the_run_or_refused(option, may_be_written):
    profile = PROFILE if may_be_written else parse_profile(PROFILE.text.replace("0x605A, ", ""), "p.toml")
    (found,) = [item for item in items(profile, quick_stop_option=option) if "605A" in item.where]
    assert found.severity == ("info" if may_be_written else "fail")
    assert found.what.startswith(f"{option}: ")
    assert ("written for each run" in found.what) == may_be_written


@pytest.mark.parametrize("option", [1, 2, 3])
def test_a_quick_stop_option_that_ends_disabled_passes(option):
    assert severities("quick_stop_option", quick_stop_option=option, profile_deceleration=10**9) == ["ok"]


@pytest.mark.parametrize("name", ["shutdown_option", "disable_operation_option"])
def test_power_cut_on_disabling_is_reported_since_standstill_comes_before_it(name):
    (found,) = [item for item in items(**{name: 0}) if f"({name})" in item.where]
    assert found.severity == "info"
    assert "standstill" in found.what


@pytest.mark.parametrize(
    ("ramp_s", "severity"), [(0.1, "ok"), (0.49, "ok"), (0.6, "warn"), (0.99, "warn"), (1.1, "fail")]
)
def test_time_of_the_quick_stop_ramp_from_full_speed(ramp_s, severity):
    assert severities("quick_stop_deceleration", quick_stop_deceleration=round(FULL_SPEED / ramp_s)) == [severity]


def test_a_ramp_of_zero_is_none():
    assert severities("quick_stop_deceleration", quick_stop_deceleration=0) == ["fail"]


def test_the_ramp_that_the_quick_stop_option_names_is_judged():
    """Option 1 stops by the profile's own deceleration 0x6084, which is 2 s here; 3 by none; 2 is written for 5."""
    assert severities("profile_deceleration", quick_stop_option=1) == ["fail"]
    assert severities("quick_stop_deceleration", quick_stop_option=5) == ["ok"]
    assert severities("quick_stop_deceleration", quick_stop_option=2, quick_stop_deceleration=None) == ["fail"]
    assert severities("quick_stop_deceleration", quick_stop_option=1) == []
    assert severities("quick_stop_deceleration", quick_stop_option=3, quick_stop_deceleration=1) == []


def test_a_ramp_in_an_unknown_unit_is_refused():
    start, end = PROFILE.text.index("[velocity]"), PROFILE.text.index("[position]")
    text = PROFILE.text[:start] + PROFILE.text[end:]
    text = text[: text.index("[feedforward]")] + text[text.index("[state_machine]") :]
    profile = parse_profile(text, "p.toml")
    (found,) = [item for item in items(profile) if "deceleration" in item.where]
    assert found.severity == "fail"
    assert "no [velocity]" in found.what
    assert not [item for item in items(profile, quick_stop_option=3) if item.severity == "fail"]


def test_what_a_drive_does_not_have_is_one_line():
    warning, found = items(**dict.fromkeys(GOOD))
    assert (warning.severity, found.severity) == ("warn", "info")
    assert "proof" in warning.advice
    assert "605A:00 (quick_stop_option)" in found.what
