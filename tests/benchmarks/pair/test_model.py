"""Numpy tier of the pair, short: one seed, the main rows, bounds of the pilot's orders of magnitude."""

from __future__ import annotations

import json
from dataclasses import astuple

import numpy as np
import pytest

from gateway.pair.impedance import stability_margin
from tests.support.pair.model import BETWEEN, FAST, QUASI_STATIC, USUAL, Scope, figures
from tests.support.pair.model_gap import gaps
from tests.support.pair.model_rig import LIMIT_N, LOOP_TIME_S, STIFFNESS
from tests.support.pair.model_tune import FILE, MARGIN, stored
from tests.support.pair.model_verdicts import Figures, Verdict, verdicts

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

SEEDS = (0,)
SKIP = ("C8r", "C6", "C7", "C8 no lead", "C2c no lead", "C2m no lag", "C3 nearest")
SHORT = Scope(
    frozen_cycles=2,
    updates=2,
    each_cycles=4,
    static_sync_s=0.04,
    crossed=(BETWEEN,),
    stages=("static", "usual", "speeds", "fast"),
    skip=SKIP,
)


@pytest.fixture(scope="module")
def rows() -> list[dict[str, object]]:
    return figures(SEEDS, SHORT)


@pytest.fixture(scope="module")
def given(rows: list[dict[str, object]]) -> Figures:
    return Figures(rows)


@pytest.fixture(scope="module")
def judged(rows: list[dict[str, object]]) -> dict[str, Verdict]:
    return {verdict.name: verdict for verdict in verdicts(rows)}


@pytest.mark.xdist_group("pair-model")
@pytest.mark.parametrize(
    ("name", "speed", "least", "most"),
    [
        ("A", QUASI_STATIC, 80.0, 450.0),
        ("C1", QUASI_STATIC, 7.0, 50.0),
        ("C1 N=17", QUASI_STATIC, 5.0, 20.0),
        ("O", QUASI_STATIC, 2.0, 15.0),
        ("A", USUAL, 200.0, 450.0),
        ("B", USUAL, 15.0, 80.0),
        ("C1", USUAL, 90.0, 300.0),
        ("C1i", USUAL, 15.0, 66.0),
        ("C2c", USUAL, 10.0, 45.0),
        ("C8", USUAL, 10.0, 40.0),
        ("B", FAST, 40.0, 150.0),
        ("C1i", FAST, 40.0, 120.0),
        ("C8", FAST, 15.0, 76.0),
        ("floor", USUAL, 5.0, 30.0),
    ],
)
def test_orders_of_magnitude(given: Figures, name: str, speed: float, least: float, most: float) -> None:
    force = given.last(name, speed)
    assert len(force) == len(SEEDS)
    assert np.all((force >= least) & (force <= most)), force


@pytest.mark.xdist_group("pair-model")
@pytest.mark.parametrize("name", ["P1", "P2", "P3 points", "P4", "P5 bare", "P7"])
def test_conditions_that_hold(judged: dict[str, Verdict], name: str) -> None:
    assert judged[name].passed, judged[name]


@pytest.mark.xdist_group("pair-model")
def test_taught_function_at_rest(given: Figures) -> None:
    """P3: the share of A holds in every seed; twice the points help until the estimate's bias is all that is left."""
    a, nine, more = (given.last(name, QUASI_STATIC) for name in ("A", "C1", "C1 N=17"))
    assert np.all(nine <= 0.2 * a)
    assert np.median(more / nine) <= 0.75
    assert np.all(more < nine)


@pytest.mark.xdist_group("pair-model")
def test_impedance_alone_does_not_suffice_at_speed_and_learning_helps_there(given: Figures) -> None:
    assert np.all(given.last("B", FAST) > LIMIT_N)
    assert np.median(given.last("C8", FAST) / given.last("B", FAST)) < 0.6
    assert np.all(given.last("C8", FAST) < given.last("C1i", FAST))


@pytest.mark.xdist_group("pair-model")
def test_measured_positions_learn_the_lag_with_the_wrong_sign(given: Figures) -> None:
    cycles = given.cycles("C2m", FAST)
    assert all(each[-1] > 1.1 * each[0] for each in cycles)


@pytest.mark.xdist_group("pair-model")
def test_stored_speeds_serve_one_in_between(given: Figures) -> None:
    """Seen bare: with the tuned impedance on top both stand at the floor of the force estimate."""
    ratio = given.last("C3, no impedance", BETWEEN) / given.last("C1i, no impedance", BETWEEN)
    assert np.all(ratio < 0.5)
    assert np.all(given.last("C3", BETWEEN) < LIMIT_N)


@pytest.mark.xdist_group("pair-model")
def test_no_result_lies_below_what_the_truth_allows(given: Figures) -> None:
    """A force below the floor of the estimate's bias would mean that the controller was told the truth."""
    for name in ("B", "C1i", "C2c", "C8"):
        assert np.all(given.last(name, USUAL) > 0.7 * given.last("floor", USUAL)), name


@pytest.mark.xdist_group("pair-model")
def test_part_is_not_moved_to_buy_a_low_force(given: Figures) -> None:
    for name in ("B", "C2c", "C8"):
        assert np.all(given.last(name, USUAL, "part_off_m") < 1e-3)


@pytest.mark.xdist_group("pair-model")
def test_gap_is_kept_by_distance_sensors() -> None:
    verdict = verdicts([], gaps(SEEDS))[0]
    assert verdict.passed, verdict


def test_three_sensors_keep_the_gap_in_three_components() -> None:
    for gap in gaps(SEEDS, ("z", "rx", "ry")):
        assert gap.sensors == 3
        assert gap.without_m >= 1e-3
        assert gap.cycles_m[-1] <= 0.1e-3


def test_stored_gains_keep_their_distance_to_what_was_seen_to_oscillate() -> None:
    values = json.loads(FILE.read_text())
    assert set(values["seeds"]).isdisjoint(SEEDS)
    assert stored().damping[0] >= MARGIN * values["oscillates_below"] * (1.0 - 1e-9)
    best = min(values["grid"], key=lambda place: place["force_n"])
    assert (best["damping"], best["stiffness"]) == (stored().damping[0], stored().stiffness[0])
    assert stability_margin(stored(), STIFFNESS, LOOP_TIME_S) >= 1.0
    assert len(astuple(stored())) == 3
