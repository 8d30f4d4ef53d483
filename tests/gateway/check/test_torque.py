"""Provenance of a torque, on words written down by hand."""

import math

import numpy as np
import pytest

from drives.profile_file import load_profile
from drives.torque_signals import TorqueSignals
from gateway.cell.config import AxisConfig
from gateway.check.moves import judge_torque
from gateway.preflight.rules import Axis
from tests.data.axes import axis_table

KT = axis_table()["torque_constant_nm_per_a"]["value"]
RATED_NM, RATED_A = 1.27, 1.27 / KT
TORQUE_NM, CURRENT_A = RATED_NM / 1000.0, RATED_A / 1000.0
STEPS = np.arange(600)
#: A demand that goes in both directions, in per mille, and what a current loop makes of it.
DEMAND = np.rint(180.0 * np.sin(STEPS / 40.0)).astype(int)
NOISE = np.rint(np.random.default_rng(1).normal(0.0, 3.0, len(STEPS))).astype(int)
MEASURED = DEMAND + NOISE


AXIS = Axis(1, AxisConfig.model_validate(axis_table()), load_profile("generic-cia402"))


def judge(torque, demand=DEMAND, current=MEASURED, torque_nm=TORQUE_NM):
    words = TorqueSignals(1, list(torque), list(demand), list(current))
    return [judge_torque(AXIS, words, torque_nm, CURRENT_A)]


def only(items):
    (item,) = items
    return item.severity, item.what


def test_a_measured_torque_is_fine():
    severity, what = only(judge(MEASURED))
    assert severity == "ok"
    assert "measured" in what


@pytest.mark.parametrize("factor", [1, 4])
def test_a_demand_is_known_by_its_bits_in_any_unit(factor):
    severity, what = only(judge(factor * DEMAND))
    assert severity == "fail"
    assert "it is a demand" in what


def test_a_lost_sign_shows_against_the_demand_or_the_current():
    assert "magnitude only" in only(judge(abs(MEASURED)))[1]
    assert "while the current" in only(judge(abs(MEASURED), demand=()))[1]


def test_a_one_sided_torque_leaves_the_sign_open():
    severity, what = only(judge(MEASURED + 400, demand=DEMAND + 400, current=MEASURED + 400))
    assert severity == "info"
    assert "lost sign would not be detected" in what


def test_an_opposite_sign():
    severity, what = only(judge(-MEASURED, current=-MEASURED))
    assert severity == "fail"
    assert "opposite sign" in what


@pytest.mark.parametrize(
    ("factor", "severity", "says"),
    [
        (math.sqrt(2.0), "fail", "rms value is taken for a peak"),
        (math.sqrt(0.5), "fail", "peak value is taken for an rms"),
        (1000.0, "fail", "mNm taken for uNm"),
        (0.001, "fail", "uNm taken for mNm"),
        (1.25, "warn", "1.25 times current"),
    ],
)
def test_a_factor_between_torque_and_current_is_named(factor, severity, says):
    got, what = only(judge(MEASURED, torque_nm=TORQUE_NM * factor))
    assert got == severity
    assert says in what


def test_a_constant_torque_word_is_not_a_measurement():
    severity, what = only(judge(np.full(len(STEPS), 12)))
    assert severity == "fail"
    assert "1 different values" in what


def test_what_cannot_be_compared_is_said():
    assert only(judge(MEASURED[:20], DEMAND[:20], MEASURED[:20]))[0] == "warn"
    assert only(judge(MEASURED, demand=(), current=()))[0] == "warn"
