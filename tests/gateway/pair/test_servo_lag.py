"""Lag of joints is estimated in motion and given back as time slows down, against servos of a known law."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.data.visit import ArmSample
from gateway.pair.servo_lag import (
    LONGEST_CATCHING_UP_S,
    MAX_LAG_DIFFERENCE_S,
    LagLaw,
    ServoLag,
    equalised_targets,
    lag_differences,
)

DT_S, ROWS = 0.004, 600


def driven(lag_s: float, tau_s: float, lost: frozenset[int] = frozenset(), rows: int = ROWS) -> ServoLag:
    """Twelve servos of the law e + tau e' = T u', stepped finely, from rest; a SYNC shows what was sent before it."""
    lag = ServoLag(DT_S, 0.016, 12)
    phase = np.linspace(0.0, 1.5, 12)

    def asked(t: float) -> np.ndarray:
        return t**2 / (t**2 + 0.1) * (0.3 * np.sin(2.0 * t + phase) + 0.1 * np.sin(7.0 * t + 2 * phase))

    behind = np.zeros(12)
    for row in range(rows):
        t = row * DT_S
        if row:
            for part in range(100):
                at = t - DT_S + (part + 0.5) * DT_S / 100
                speed = (asked(at + 1e-6) - asked(at - 1e-6)) / 2e-6
                behind = behind + (lag_s * speed - behind) / tau_s * DT_S / 100
        seen = asked(t) - behind
        if row in lost:
            seen = np.where(np.arange(12) == 3, np.nan, seen)
        samples = tuple(ArmSample(row, t, seen[half], np.zeros(6), ()) for half in (slice(6), slice(6, 12)))
        sent = asked(t + DT_S)
        lag.slow_down(1.0)
        lag.take((sent[:6], sent[6:]), samples, np.zeros(12))
    return lag


@pytest.mark.parametrize(
    ("lag_s", "tau_s", "expected_s"),
    [(0.01, 0.03, 0.02), (0.02, 0.1, 0.08), (0.03, 0.01, 0.0), (0.01, 0.8, LONGEST_CATCHING_UP_S)],
)
def test_how_fast_servos_catch_up_is_estimated_in_motion(lag_s, tau_s, expected_s):
    assert driven(lag_s, tau_s).catching_up_s == pytest.approx(expected_s, abs=0.1 * expected_s + 5e-4)


def test_a_sample_with_a_gap_is_left_out():
    assert driven(0.01, 0.03, frozenset({50, 51, 200})).catching_up_s == pytest.approx(0.02, abs=0.003)


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_a_path_without_information_is_given_back_at_once(rows):
    assert driven(0.01, 0.03, rows=rows).catching_up_s == 0.0


def steady(speed_rad_s: np.ndarray, lag_s: float = 0.02) -> ServoLag:
    """Joints that go evenly and lag by their speed times a time."""
    lag = ServoLag(DT_S, lag_s, 12)
    for row in range(50):
        lag.slow_down(1.0)
        place = speed_rad_s * DT_S * row
        seen = place - DT_S * speed_rad_s - lag_s * speed_rad_s
        samples = tuple(ArmSample(row, row * DT_S, seen[half], np.zeros(6), ()) for half in (slice(6), slice(6, 12)))
        lag.take((place[:6], place[6:]), samples, speed_rad_s)
    return lag


SPEED = np.linspace(-0.5, 0.6, 12)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5])
def test_as_much_is_given_back_as_time_has_slowed_down(share):
    """Half the rate: half the lag."""
    lag = steady(SPEED)
    assert not lag.slower
    assert lag.given_back(SPEED) == pytest.approx(np.zeros(12), abs=1e-12)
    lag.slow_down(share)
    assert lag.slower
    for _ in range(200):
        back = lag.given_back(SPEED)
    assert back == pytest.approx((1.0 - share) * 0.02 * SPEED, abs=1e-9)


def test_a_path_that_goes_faster_further_on_lags_more_there():
    lag = steady(SPEED)
    lag.slow_down(0.0)
    for _ in range(200):
        back = lag.given_back(SPEED + 0.1)
    assert back == pytest.approx(0.02 * (SPEED + 0.1), abs=1e-9)


@pytest.mark.slow
def test_it_is_given_back_as_fast_as_the_servos_catch_up():
    """A first-order approach with their time constant: after one SYNC dt / (dt + tau - T) of it."""
    lag = driven(0.02, 0.06)
    tau_s = lag.catching_up_s
    goal = driven(0.02, 0.06)
    lag.slow_down(0.0)
    goal.slow_down(0.0)
    first = lag.given_back(np.zeros(12))
    for _ in range(2000):
        complete = goal.given_back(np.zeros(12))
    assert np.abs(complete).max() > 1e-3
    assert first == pytest.approx(complete * DT_S / (DT_S + tau_s), rel=1e-6, abs=1e-12)


def test_while_time_slows_down_nothing_more_is_learned():
    lag = driven(0.01, 0.03)
    before = lag.catching_up_s
    lag.slow_down(0.5)
    for row in range(5):
        samples = tuple(ArmSample(row, 0.0, np.full(6, 9.0 * row), np.zeros(6), ()) for _ in range(2))
        lag.take((np.zeros(6), np.zeros(6)), samples, SPEED)
    assert lag.catching_up_s == before


LAGS, TAUS = np.linspace(0.012, 0.018, 12), np.linspace(0.09, 0.05, 12)


def behind(sent: np.ndarray, lag_s: np.ndarray, tau_s: np.ndarray) -> np.ndarray:
    """What servos (n,) of the law e + tau e' = T u' lag at each SYNC, setpoints (M, n) interpolated between SYNCs."""
    parts, out = 50, [np.zeros(sent.shape[1])]
    for before, now in zip(sent, sent[1:], strict=False):
        lag = out[-1]
        for _ in range(parts):
            lag = lag + (lag_s * (now - before) / DT_S - lag) / tau_s * DT_S / parts
        out.append(lag)
    return np.array(out)


def swinging(seed: int = 0) -> np.ndarray:
    """Twelve joints to and fro for 4 s, from rest, each at its own pace [rad]."""
    time, paces = np.arange(1000)[:, None] * DT_S, np.random.default_rng(seed).uniform(1.0, 3.0, 12)
    return 0.2 * (1.0 - np.cos(paces * time))


def encoders(noise_rad: float = 0.0) -> np.ndarray:
    """Return the lag estimated from noisy encoders."""
    sent = swinging()
    law = LagLaw(DT_S, 12, rows=100)
    shown = sent - behind(sent, LAGS, TAUS) + noise_rad * np.random.default_rng(1).standard_normal(sent.shape)
    for row in range(len(sent) - 1):
        law.take(sent[row + 1], shown[row])
    return law.each_s


@pytest.mark.parametrize(("noise_rad", "share"), [(0.0, 0.02), (2e-5, 0.05)])
def test_each_joints_law_is_estimated_from_targets_and_encoders(noise_rad, share):
    read = encoders(noise_rad)
    assert read[:, 0] == pytest.approx(LAGS, rel=share)
    assert read[:, 1] == pytest.approx(TAUS, rel=2 * share)


def test_a_joint_that_has_not_moved_or_is_too_noisy_is_not_known():
    law = LagLaw(DT_S, 12, rows=100)
    sent, random = swinging(), np.random.default_rng(2)
    sent[:, 3] = 0.0
    shown = sent - behind(sent, LAGS, TAUS)
    shown[:, 5] += 0.02 * random.standard_normal(len(sent))
    for row in range(len(sent) - 1):
        law.take(sent[row + 1], shown[row])
    assert np.flatnonzero(np.isnan(law.each_s).any(axis=1)).tolist() == [3, 5]


def test_targets_with_equal_lag_leave_the_joints_together():
    """All go the same way; what they lag unlike each other is a twentieth of what it was."""
    share = np.linspace(0.0, 1.0, 500)[:, None]
    path_rad = np.tile(0.6 * share**3 * (10.0 - 15.0 * share + 6.0 * share**2), (1, 12))
    laws = np.stack([LAGS, TAUS], axis=1)
    plain = path_rad - behind(path_rad, LAGS, TAUS)
    sent = path_rad + equalised_targets(path_rad, laws, DT_S)
    equal = sent - behind(sent, LAGS, TAUS)
    assert np.ptp(plain, axis=1).max() > 2e-3
    assert np.ptp(equal, axis=1).max() < 0.05 * np.ptp(plain, axis=1).max()
    assert sent[-1] == pytest.approx(path_rad[-1], abs=1e-12)


def test_a_rejected_estimate_changes_nothing():
    laws = np.stack([LAGS, TAUS], axis=1)
    laws[1] = np.nan
    laws[4] = (0.02, 0.01)
    laws[7, 0] = laws[:, 0][6] + MAX_LAG_DIFFERENCE_S + 0.01
    known, more = lag_differences(laws)
    assert np.flatnonzero(~known).tolist() == [1, 4, 7]
    assert more[~known] == pytest.approx(np.zeros(3))
    assert more[known].sum() == pytest.approx(0.0, abs=1e-12)
    assert equalised_targets(swinging(), laws, DT_S)[:, ~known] == pytest.approx(0.0)
    assert not equalised_targets(swinging(), np.full((12, 2), np.nan), DT_S).any()
