"""Change of an arm between two times at the same poses: against changes that were put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.identify.drift import AGAIN, drift_findings, drift_of
from gateway.model.visits import Visits, pair_visits
from tests.support.rigs.tables import make_table


def twice(gain: float, friction: float, noise: float = 0.0) -> Visits:
    """Eight poses of six bare axes, from both sides, measured twice; the second time torque and friction are others."""
    draw = np.random.default_rng(4)
    q, gravity, band = draw.uniform(-2, 2, (8, 6)), draw.normal(size=(8, 6)) * 20.0, np.full(6, 5.0)
    rows = [
        (pose + AGAIN * again, side, (1 + gain * again) * gravity[pose] + side * (1 + friction * again) * band)
        for again in (0, 1)
        for pose in range(8)
        for side in (-1, 1)
    ]
    poses = np.array([pose for pose, _, _ in rows])
    tau = np.array([torque for _, _, torque in rows])
    table = make_table(["none"] * len(rows), poses, q[poses % AGAIN], tau + noise * draw.normal(size=tau.shape))
    facing = np.array([[side] * 6 for _, side, _ in rows], dtype=np.int8)
    return pair_visits(replace(table, direction=facing))


def test_changes_that_were_put_in_are_found() -> None:
    drifts = drift_of(twice(0.02, -0.15, 0.05))
    assert [one.joint for one in drifts] == [1, 2, 3, 4, 5, 6]
    for one in drifts:
        assert one.gain == pytest.approx(0.02, abs=4 * one.gain_std)
        assert one.band == pytest.approx(-0.15, abs=4 * one.band_std)
        assert one.shows
    assert all("%" in finding.what for finding in drift_findings(drifts))


def test_an_arm_that_stays_as_it_is_shows_none() -> None:
    shown = [one.shows for one in drift_of(twice(0.0, 0.0, 0.05))]
    assert sum(shown) <= 2, "one in ten by chance"


def test_another_posture_under_a_number_that_fits_is_no_second_time() -> None:
    visits = twice(0.02, 0.0)
    moved = visits.q_rad + np.where(visits.pose >= AGAIN, 0.5, 0.0)[:, None]
    assert drift_of(replace(visits, q_rad=moved)) == ()
    assert drift_findings(()) == ()
