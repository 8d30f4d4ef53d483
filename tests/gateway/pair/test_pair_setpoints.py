"""Setpoints of both arms along a path: at full rate, slowed down, faded in, and when the force in the part rises."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.motion.stops import StopKind
from gateway.motion.trajectory import Motion
from gateway.pair.pair_setpoints import (
    LEFT,
    RISING,
    RISING_S,
    RISING_SYNCS,
    SETTLE_S,
    Along,
    Settling,
    WatchedMotion,
    smooth,
)

ROWS, DT_S = 12, 0.004


class Pair:
    """What a path needs of the pair; torque offsets are a tenth of the setpoints."""

    def __init__(self) -> None:
        self.dt_s = DT_S
        self.cell = SimpleNamespace(config=SimpleNamespace(servo_lag_s=0.0))
        self.q_rad = (np.zeros(6), np.zeros(6))
        self.laws_s = np.full((12, 2), np.nan)
        self.seen: list[object] = []
        self.asked: list[tuple[str, StopKind]] = []

    def offsets(self, q):
        return tuple(each / 10 for each in q)

    def see(self, samples) -> None:
        self.seen.append(samples)

    def ask(self, why, kind=StopKind.ALONG_PATH) -> None:
        self.asked.append((why, kind))


class Deviation:
    """A deviation, a force and a fault, all set by the test."""

    def __init__(self) -> None:
        self.value_m, self.trouble, self.force_n, self.within_friction = 0.0, "", 0.0, False
        self.taken: list[tuple[int, float]] = []
        self.listened = 0

    def inputs(self, m):
        return self.value_m, self.value_m

    def take(self, m, samples, rate=1.0):
        self.taken.append((m, rate))
        return self.trouble

    def listen(self, samples) -> None:
        self.listened += 1

    def size_n(self, m):
        return self.force_n

    def doubtful(self, m):
        return self.within_friction


class PreparedTrajectory:
    """Commands become targets as they are: row m of arm k is m^2 + k, plus the deviation."""

    def __init__(self) -> None:
        rows = np.arange(ROWS)[:, None]
        self.path = np.zeros(ROWS)
        self.joints = (rows**2 * np.ones((1, 6)), rows**2 * np.ones((1, 6)))
        self.speed_rad_s, self.acceleration_rad_s2 = rows * np.ones((1, 12)), -rows * np.ones((1, 12))
        self.free_nm = (rows * np.ones((1, 6)), -rows * np.ones((1, 6)))

    def targets(self, m, commands):
        return commands


@pytest.fixture
def pair() -> Pair:
    return Pair()


@pytest.fixture
def deviation() -> Deviation:
    return Deviation()


def along(pair: Pair, deviation: Deviation, fading: int = 0) -> tuple[Along, list[tuple[int, object]]]:
    asked: list[tuple[int, object]] = []

    def commander(m, one, two):
        asked.append((m, one))
        more = 0.0 if one is None else one
        return np.full(6, m**2 + more), np.full(6, m**2 + 1.0 + more)

    return Along(pair, PreparedTrajectory(), commander, deviation, fading), asked  # type: ignore[arg-type]


SAMPLES = tuple(SimpleNamespace(q_rad=np.full(6, np.nan)) for _ in range(2))


def test_a_joint_that_lags_longer_than_the_others_is_sent_ahead(pair, deviation):
    """By its speed times what it lags longer than all on average, and no more at the end of the path."""
    pair.laws_s = np.tile((0.010, 0.012), (12, 1))
    pair.laws_s[6] = 0.022, 0.024
    prepared, rows = PreparedTrajectory(), 200
    evenly = 0.01 * np.arange(rows)[:, None] * np.ones((1, 6))
    prepared.path, prepared.joints = np.zeros(rows), (evenly, evenly)
    pair_path = Along(pair, prepared, lambda m, _one, _two: (evenly[m], evenly[m]), deviation, 0)  # type: ignore[arg-type]
    sent = np.array([np.concatenate(pair_path.targets(float(row), 1.0)) for row in range(rows)])
    ahead_s = (sent - np.hstack([evenly, evenly])) / (0.01 / DT_S)
    assert ahead_s[120] == pytest.approx([*6 * [-0.001], 0.011, *5 * [-0.001]], abs=1e-5)
    assert ahead_s[-1] == pytest.approx(np.zeros(12), abs=1e-12)


def test_at_full_rate_each_row_is_asked_for_once_and_sent_as_it_is(pair, deviation):
    pair_path, asked = along(pair, deviation)
    assert pair_path.count == ROWS
    for row in range(ROWS):
        deviation.value_m = 0.1 * row
        first, second = pair_path.targets(float(row), 1.0)
        assert first == pytest.approx(np.full(6, row**2 + 0.1 * row))
        assert second == pytest.approx(np.full(6, row**2 + 1.0 + 0.1 * row))
        assert pair_path.offsets()[0] == pytest.approx(first / 10)
        assert pair_path.modelled(float(row))[1] == pytest.approx(np.full(6, -row))
        assert pair_path.rates(float(row))[0] == pytest.approx(np.full(12, row))
        assert pair_path.rates(float(row))[1] == pytest.approx(np.full(12, -row))
        pair_path.take(float(row), 1.0, SAMPLES)
    assert [m for m, _ in asked] == list(range(ROWS))
    assert deviation.taken == [(row, 1.0) for row in range(ROWS)]
    assert len(pair.seen) == ROWS
    assert pair_path.ahead(1.0, 1.0) is None
    assert pair_path.spent_s > 0.0


def test_before_the_first_row_the_rates_are_those_of_the_first(pair, deviation):
    pair_path, _ = along(pair, deviation)
    assert pair_path.rates(-1.0)[0] == pytest.approx(np.zeros(12))
    assert pair_path.modelled(-1.0)[0] == pytest.approx(np.zeros(6))


def test_between_two_rows_set_points_lie_on_the_line_between_them(pair, deviation):
    pair_path, _ = along(pair, deviation)
    for row in range(5):
        pair_path.targets(float(row), 1.0)
    for at in (4.25, 4.5, 4.75, 5.0):
        first, second = pair_path.targets(at, 0.25)
        assert first == pytest.approx(np.full(6, 16 + (at - 4) * 9))
        assert second - first == pytest.approx(np.ones(6))


def test_what_the_hands_yield_between_two_rows_is_added_at_once(pair, deviation):
    pair_path, asked = along(pair, deviation)
    for row in range(5):
        pair_path.targets(float(row), 1.0)
    pair_path.targets(4.25, 0.25)
    deviation.value_m = 2.0
    assert pair_path.targets(4.5, 0.25)[0] == pytest.approx(np.full(6, 16 + 0.5 * 9 + 2.0))
    assert pair_path.targets(5.0, 0.25)[1] == pytest.approx(np.full(6, 26 + 2.0))
    assert [m for m, _ in asked] == [0, 1, 2, 3, 4, 5, 5, 5]


def test_a_place_that_misses_a_row_by_rounding_is_that_row(pair, deviation):
    pair_path, asked = along(pair, deviation)
    for row in range(4):
        pair_path.targets(float(row), 1.0)
    assert pair_path.targets(3.0 + 1e-12, 1.0)[0] == pytest.approx(np.full(6, 9.0))
    assert max(m for m, _ in asked) == 3


def test_rows_that_were_passed_over_are_computed_all_the_same(pair, deviation):
    pair_path, asked = along(pair, deviation)
    pair_path.targets(0.0, 1.0)
    pair_path.targets(3.0, 3.0)
    assert [m for m, _ in asked] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("within_friction", "rate", "sent_m"), [(True, 0.5, None), (False, 0.5, 3.0), (True, 1.0, 3.0)]
)
def test_what_may_be_friction_is_not_answered_while_time_slows_down(pair, deviation, within_friction, rate, sent_m):
    pair_path, asked = along(pair, deviation)
    for row in range(3):
        pair_path.targets(float(row), 1.0)
    deviation.value_m, deviation.within_friction = 3.0, within_friction
    pair_path.targets(2.0 + rate, rate)
    assert asked[-1] == (3, sent_m)


def test_each_arm_gives_back_its_own_lag_whatever_its_axes_are(pair, deviation):
    """Seven and six joints whose speeds are their numbers: at half the rate half of what they lag in 20 ms."""
    speed = np.arange(1.0, 14.0)
    pair.cell.config.servo_lag_s = 0.02
    pair.q_rad, pair.laws_s = (np.zeros(7), np.zeros(6)), np.full((13, 2), np.nan)
    prepared = PreparedTrajectory()
    prepared.joints = (np.zeros((ROWS, 7)), np.zeros((ROWS, 6)))
    prepared.speed_rad_s = np.tile(speed, (ROWS, 1))
    pair_path = Along(pair, prepared, lambda m, _one, _two: (np.full(7, float(m)), np.full(6, float(m))), deviation, 0)
    for row in range(3):
        pair_path.targets(float(row), 1.0)
    first, second = pair_path.targets(2.5, 0.5)
    assert first == pytest.approx(2.5 - 0.5 * 0.02 * speed[:7])
    assert second == pytest.approx(2.5 - 0.5 * 0.02 * speed[7:])


def test_a_path_begins_where_the_arms_are_and_fades_in(pair, deviation):
    pair.q_rad = (np.full(6, 5.0), np.full(6, -3.0))
    pair_path, _ = along(pair, deviation, fading=4)
    for row in range(6):
        first, second = pair_path.targets(float(row), 1.0)
        left = 1.0 - smooth(min((row + 1) / 4, 1.0))
        assert first == pytest.approx(np.full(6, row**2 + left * 5.0))
        assert second == pytest.approx(np.full(6, row**2 + 1.0 + left * (-4.0)))


def test_smooth_goes_from_0_to_1_and_is_at_rest_at_both_ends():
    assert (smooth(0.0), smooth(0.5), smooth(1.0)) == (0.0, 0.5, 1.0)
    for end in (0.0, 1.0):
        assert (smooth(end + 1e-6) - smooth(end - 1e-6)) / 2e-6 == pytest.approx(0.0, abs=1e-6)
    assert (np.diff([smooth(share) for share in np.linspace(0, 1, 50)]) > 0).all()


def forces(pair: Pair, deviation: Deviation, sizes_n: list[float]) -> list[StopKind]:
    """Request that is made while a force exceeds the limit for a stop of both arms."""
    pair_path, _ = along(pair, deviation)
    pair_path.targets(0.0, 1.0)
    for size_n in sizes_n:
        deviation.trouble, deviation.force_n = "too much force", size_n
        pair_path.take(0.0, 1.0, SAMPLES)
    return [kind for _, kind in pair.asked]


def test_a_force_stops_both_along_the_path_once(pair, deviation):
    assert forces(pair, deviation, [100.0] * 20) == [StopKind.ALONG_PATH]
    assert pair.asked[0][0] == "too much force"


@pytest.mark.parametrize(("later", "urgent"), [(RISING * 120.0 - 1.0, False), (RISING * 120.0 + 1.0, True)])
def test_a_force_that_goes_on_rising_is_a_quick_stop(pair, deviation, later, urgent):
    """It may rise while the stop begins; against the largest of these SYNCs it may not become much more."""
    begin = [100.0, 120.0, 110.0, 90.0][: RISING_SYNCS + 1]
    kinds = forces(pair, deviation, [*begin, later])
    assert kinds == [StopKind.ALONG_PATH, *([StopKind.QUICK_STOP] if urgent else [])]


def test_a_force_that_rises_while_the_stop_begins_is_no_quick_stop(pair, deviation):
    assert forces(pair, deviation, [10.0, 100.0, 1000.0, 10.0]) == [StopKind.ALONG_PATH]


def test_no_force_asks_for_nothing(pair, deviation):
    pair_path, _ = along(pair, deviation)
    for row in range(3):
        pair_path.targets(float(row), 1.0)
        pair_path.take(float(row), 1.0, SAMPLES)
    assert pair.asked == []


def test_a_gap_is_closed_at_rest_at_the_first_command(pair, deviation):
    asked = []

    def commander(m, one, two):
        asked.append((m, one, two))
        return np.ones(6), 2 * np.ones(6)

    settling = Settling(pair, PreparedTrajectory(), commander, deviation)  # type: ignore[arg-type]
    assert settling.count == round((RISING_S + SETTLE_S) / DT_S)
    deviation.value_m = 4.0
    full = round(RISING_S / DT_S)
    for at in (0.5 * full - 1.0, full - 1.0, full + 7.0):
        first, second = settling.targets(at, 1.0)
        assert (first[0], second[0]) == (1.0, 2.0)
    assert [each[1:] for each in asked] == [pytest.approx((2.0, 2.0)), (4.0, 4.0), (4.0, 4.0)]
    assert [rate.tolist() for rate in settling.rates(3.0)] == [[0.0] * 12] * 2
    assert settling.offsets()[1] == pytest.approx(np.full(6, 0.2))
    assert settling.modelled(3.0)[0] == pytest.approx(np.zeros(6))
    assert settling.ahead(3.0, 1.0) is None
    settling.take(0.0, 1.0, SAMPLES)
    assert (deviation.listened, len(pair.seen), deviation.taken) == (1, 1, [])


def test_closing_that_is_broken_off_dies_away_and_observers_receive_every_sync(pair, deviation):
    asked, received = [], []
    settling = Settling(
        pair,  # type: ignore[arg-type]
        PreparedTrajectory(),  # type: ignore[arg-type]
        lambda m, one, two: (asked.append(two), (np.ones(6), np.ones(6)))[1],
        deviation,
        received.append,
    )
    deviation.value_m = 4.0
    settling.targets(RISING_S / DT_S, 1.0)
    settling.take(0.0, 1.0, SAMPLES)
    for _ in range(2):
        settling.targets(RISING_S / DT_S, 0.0)
    assert asked == pytest.approx([4.0, 4.0 * LEFT, 4.0 * LEFT**2])
    assert received == [SAMPLES]


def test_a_prepared_motion_of_both_arms_is_watched(pair):
    rows = np.arange(1.0, 5.0)[:, None] * np.ones((1, 6))
    motions = [Motion(sign * rows, sign * np.ones((4, 6)), np.zeros((4, 6)), DT_S) for sign in (1.0, -1.0)]
    pair_path = WatchedMotion(pair, pair.q_rad, motions)  # type: ignore[arg-type]
    assert pair_path.targets(2.0, 1.0)[1] == pytest.approx(np.full(6, -3.0))
    assert pair_path.offsets()[1] == pytest.approx(np.full(6, -0.3))
    pair_path.take(2.0, 1.0, SAMPLES)
    assert pair.seen == [SAMPLES]
    received = []
    WatchedMotion(pair, pair.q_rad, motions, received.append).take(2.0, 1.0, SAMPLES)  # type: ignore[arg-type]
    assert received == [SAMPLES]
