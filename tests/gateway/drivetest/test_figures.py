"""Figures of the drive test from samples with a known truth."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.drivetest import estimates
from gateway.report.drive_test_page import render_drive_test
from gateway.result.drive_test import DriveTestReport, TimingFigure


@pytest.mark.parametrize("period_s", [0.002, 0.004, 0.01])
def test_the_time_and_angle_of_a_ramp_are_within_their_bounds(period_s):
    """Speed 5000 counts/s, constant deceleration from a SYNC on, then a decaying oscillation."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        speed, begin_s, ramp_s = 5000.0 * rng.choice((-1, 1)), period_s * 80, 0.02 + 0.05 * rng.random()
        at = period_s * np.arange(round(80 + 0.4 / period_s))
        left = np.clip(at - begin_s, 0.0, ramp_s)
        after = np.clip(at - begin_s - ramp_s, 0.0, None)
        count = speed * (np.minimum(at, begin_s) + left - left**2 / (2 * ramp_s))
        count += -speed * 0.001 * np.exp(-after / 0.1) * np.sin(160.0 * after) * (after > 0)
        rest = estimates.until_rest(at, np.round(count), begin_s)
        assert rest is not None
        assert rest.low_s <= ramp_s <= rest.high_s + 1e-9
        unseen_share = 2.5 / period_s / abs(speed)  # speed below one count per SYNC
        assert rest.high_s - rest.low_s <= 2.01 * period_s + unseen_share * (ramp_s + 2.0 * period_s)
        assert rest.travel - 2.0 <= abs(speed) * ramp_s / 2 <= rest.most + 2.0


def test_the_angle_of_an_elastic_axis_that_springs_back_between_two_syncs_is_within_its_bounds():
    """After up to 8 ms at 50 000 counts/s the speed falls like a cosine and turns back; the peak is a closed form."""
    rng, seen = np.random.default_rng(5), 0
    for _ in range(200):
        speed, omega, delay_s = 50_000.0 * rng.choice((-1, 1)), rng.uniform(120.0, 300.0), rng.uniform(0.0, 0.008)
        at, begin_s = 0.01 * np.arange(120), 0.8
        after = np.clip(at - begin_s - delay_s, 0.0, None)
        count = speed * (np.minimum(at, begin_s + delay_s) + np.exp(-10.0 * after) * np.sin(omega * after) / omega)
        rest = estimates.until_rest(at, np.round(count), begin_s)
        assert rest is not None
        peak_s = np.arctan(omega / 10.0) / omega
        travel = abs(speed) * (delay_s + np.exp(-10.0 * peak_s) * np.sin(omega * peak_s) / omega)
        assert rest.travel - 2.0 <= travel <= rest.most + 2.0
        seen += travel > rest.travel + 20.0
    assert seen > 100  # the largest position at a SYNC alone is too small


def test_an_axis_that_goes_on_is_not_at_rest():
    at = 0.01 * np.arange(100)
    assert estimates.until_rest(at, 5000.0 * at, 0.5) is None


def test_intervals_of_a_median_hold_their_share():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(400):
        true = rng.gamma(4.0, 0.001, 60)
        early, more = 0.0004 * rng.random(60), 0.0004 * rng.random(60)
        figure = estimates.quantile_figure("x", list(zip(true - early, true + more, strict=True)), 0.5, 0.0, "drawn")
        assert figure.interval is not None
        hits += figure.interval[0] <= 0.0036720607489 <= figure.interval[1]  # median of the distribution, by tables
    assert hits >= 376
    assert estimates.quantile_figure("x", [(0.1, 0.2)], 0.5, 0.01, "drawn").interval == pytest.approx((0.09, 0.21))
    assert estimates.quantile_figure("x_s", [], 0.5, 0.0, "drawn").value is None


def test_intervals_of_a_share_are_those_of_clopper_and_pearson():
    figure = estimates.share_figure("x", 5, 500, "counted")
    assert figure.interval == pytest.approx((0.003255, 0.023174), abs=1e-5)
    assert estimates.share_figure("x", 0, 500, "counted").interval == pytest.approx((0.0, 0.007351), abs=1e-5)
    assert estimates.share_figure("x", 0, 0, "counted").value is None


def sent(count, period_s=0.004):
    begin_s = period_s * np.arange(count)
    return np.column_stack([begin_s, begin_s + 0.0001])


def test_missing_and_delayed_answers_differ_from_disturbed_syncs():
    after_s = sent(100)[:, 1]
    answers = [list(after_s + 0.001) for _ in range(3)]
    answers[1][9] = after_s[9] + 0.0038
    for times in answers:
        times[50] = None  # the computer, not the drives
    answers[0][7] = None
    answers = [[at_s for at_s in times if at_s is not None] for times in answers]
    first, second, third = estimates.count_answers(sent(100), answers, 0.004)
    assert (first.missed, first.delayed) == (1, 0)
    assert (second.missed, second.delayed) == (0, 1)
    assert (third.missed, third.delayed, third.counted) == (0, 0, 99)
    assert len(third.delays_s) == 99
    assert third.delays_s[0] == pytest.approx((0.001, 0.0011))


def test_an_answer_after_the_next_sync_is_delayed_and_not_missed():
    after_s = sent(100)[:, 1]
    answers = [*after_s[:7], after_s[7] + 0.0042, *after_s[8:] + 0.001]
    (seen,) = estimates.count_answers(sent(100), [sorted(answers)], 0.004)
    assert (seen.missed, seen.delayed) == (0, 1)


def test_syncs_that_this_computer_sent_with_a_delay_are_not_counted():
    syncs = sent(100)
    syncs[60:] += 0.002
    (seen,) = estimates.count_answers(syncs, [np.delete(syncs[:, 1] + 0.001, 59)], 0.004)
    assert (seen.missed, seen.counted) == (0, 99)


def test_drives_that_are_all_delayed_often_are_not_excused():
    delays_s = np.where(np.arange(100) % 4 == 0, 0.0038, 0.001)
    answers = [sent(100)[:, 1] + delays_s] * 3
    assert [each.delayed for each in estimates.count_answers(sent(100), answers, 0.004)] == [25, 25, 25]


def test_what_other_drives_lose_as_well_is_permitted():
    assert estimates.permitted_share((0.0, 0.03, 0.0), 0) == pytest.approx(0.015)
    assert estimates.permitted_share((0.0, 0.03, 0.0), 1) == 0.005
    assert estimates.permitted_share((0.03, 0.03, 0.03), 0) == 0.03
    assert estimates.permitted_share((0.03, 0.03), 0) == 0.005


@pytest.mark.parametrize(
    ("name", "low", "high", "limit", "text"),
    [
        ("controlword_to_reaction_s", 0.025, 0.035, 0.02, "Controlword to reaction: 30 [25, 35] ms; at most 20 ms"),
        ("missed_pdo_10ms", 0.014, 0.046, 0.005, "Missed TPDOs at 10 ms: 3 [1.4, 4.6] %; at most 0.5 %"),
        ("controlword_to_reaction_s", 0.015, 0.045, 0.02, None),  # the interval contains the limit
        ("missed_pdo_4ms", 0.26, 0.34, None, None),
    ],
)
def test_only_a_figure_whose_whole_interval_is_beyond_a_limit_is_a_finding(name, low, high, limit, text):
    report = DriveTestReport("J2", 2, {})
    figure = TimingFigure(name, "drawn", (low + high) / 2, (low, high), 10)
    estimates.add_figure(report, figure, limit, "repair it")
    assert report.figures == [figure]
    assert report.findings == ([] if text is None else [f"{text} is allowed; repair it"])


def test_the_page_shows_what_was_not_measured_and_what_failed():
    stop = TimingFigure("quick_stop_time_s", "ramp", 0.02, (0.01, 0.03), 1)
    age = TimingFigure("torque_age_s", "not moved")
    report = DriveTestReport("J2", 2, {"vendor": 1}, [stop, age], ["EMCY: no <message>"])
    html = render_drive_test("cell", "2026", [report])
    assert "1 of 1 drives with findings: J2" in html
    assert "no &lt;message&gt;" in html
    assert "20 [10, 30]" in html
    assert "not moved" in html
    ended_early = render_drive_test("cell", "2026", [DriveTestReport("J1", 1, {}, [], [])])
    assert 'class="verdict open"' in ended_early
