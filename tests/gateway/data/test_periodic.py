"""Position, speed and acceleration of one period: against the motion that the positions were taken from."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.data.periods import by_harmonics, by_low_pass

PERIOD_S, RATE_HZ = 8.0, 250.0
N = int(PERIOD_S * RATE_HZ)
COUNT_RAD = 2 * np.pi / (131072 * 100)


def series(time_s: np.ndarray, harmonics: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, qd, qdd (n, 6) of a sum of harmonics with speeds up to about 1 rad/s."""
    rng = np.random.default_rng(4)
    order = np.arange(1, harmonics + 1)
    rate = 2 * np.pi * order / PERIOD_S
    a, b = rng.normal(size=(2, harmonics, 6)) / (4 * order[:, None])
    angle = time_s[:, None] * rate
    cosine, sine = np.cos(angle), np.sin(angle)
    return (
        cosine @ a + sine @ b,
        -(sine * rate) @ a + (cosine * rate) @ b,
        -(cosine * rate**2) @ a - (sine * rate**2) @ b,
    )


TIME_S = np.arange(N) / RATE_HZ


def test_a_series_comes_back_with_speed_and_acceleration():
    q, qd, qdd = series(TIME_S)
    found = by_harmonics(q, PERIOD_S)
    assert np.allclose(found.q_rad, q, atol=1e-5)
    assert np.allclose(found.qd_rad_s, qd, atol=1e-5)
    assert np.allclose(found.qdd_rad_s2, qdd, atol=1e-3)


def test_what_is_asked_for_is_that_of_so_much_earlier():
    offset_s = 0.0053
    q, qd, qdd = series(TIME_S - offset_s)
    found = by_harmonics(series(TIME_S)[0], PERIOD_S, delay_s=offset_s)
    assert np.allclose(found.q_rad, q, atol=1e-5)
    assert np.allclose(found.qd_rad_s, qd, atol=1e-5)
    assert np.allclose(found.qdd_rad_s2, qdd, atol=1e-3)


def test_positions_in_counts_give_the_acceleration_within_a_thousandth():
    q, qd, qdd = series(TIME_S)
    found = by_harmonics(np.round(q / COUNT_RAD) * COUNT_RAD, PERIOD_S)
    size = np.sqrt(np.mean(qdd**2, axis=0))
    assert (np.sqrt(np.mean((found.qdd_rad_s2 - qdd) ** 2, axis=0)) < 1e-3 * size).all()
    assert np.abs(found.qd_rad_s - qd).max() < 1e-4


def test_a_first_period_whose_end_is_not_its_beginning_does_not_ring():
    """The servo still lags at the end; the arm began at rest where it was commanded to."""
    q, _, qdd = series(TIME_S)
    tail = 1e-4 * (TIME_S / PERIOD_S - 0.5)[:, None]
    found = by_harmonics(q + tail, PERIOD_S)
    assert np.abs(found.qdd_rad_s2 - qdd).max() < 0.01


def test_what_was_sent_is_kept_however_fast_it_is():
    """From rest to rest, harmonics 28 to 32 of a period of 2 s."""
    time_s = np.arange(200) / 100.0
    q = (np.sin(2 * np.pi * 15.0 * time_s) * (1 - np.cos(np.pi * time_s)) ** 2 / 4)[:, None]
    assert np.abs(by_harmonics(q, 2.0).q_rad).max() < 1e-3
    assert np.allclose(by_harmonics(q, 2.0, least=32).q_rad, q, atol=1e-3)


def test_the_low_pass_of_a_sweep_is_in_phase_and_does_not_ring():
    """Steady speeds with ramps between them: the speed never passes the steady one by more than a hundredth."""
    speed = np.interp(TIME_S, [0, 1, 3, 5, 7, 8], [0, 0.5, 0.5, -0.5, -0.5, 0])
    q = np.cumsum(speed)[:, None] / RATE_HZ
    found = by_low_pass(q, PERIOD_S)
    steady = (TIME_S > 1.3) & (TIME_S < 2.7)
    assert found.qd_rad_s[steady, 0] == pytest.approx(0.5, abs=1e-3)
    assert np.abs(found.qd_rad_s).max() < 0.505
    reversal = np.argmin(np.abs(found.qd_rad_s[:, 0]) + 10 * (np.abs(TIME_S - 4.0) > 0.5))
    assert TIME_S[reversal] == pytest.approx(4.0, abs=0.01)
