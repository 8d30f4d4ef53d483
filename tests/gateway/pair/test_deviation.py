"""Deviation of both hands, from the force in the part or from distance sensors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.pair.deviation import DeviationFromDistance, DeviationFromForce
from gateway.pair.force import ForceGuard
from gateway.pair.gap import GapWatch

ROWS, DT_S = 8, 0.004


class Sample(str):
    """A sample that is known by its name."""

    sync_index, time_s = 0, 0.0


AB, CD = (Sample("a"), Sample("b")), (Sample("c"), Sample("d"))


class Arm:
    """An arm that shows what its samples are; its path begins at joint angles of 0.3 rad."""

    def __init__(self) -> None:
        self.q_rad = np.full((ROWS, 6), 0.3)
        self.calls: list[tuple] = []

    def update(self, m, sample, rate=1.0) -> str:
        self.calls.append((m, sample, rate))
        return f"seen of {sample}"


class Balance:
    """A balance that says what a test wants."""

    count = ROWS

    def __init__(self) -> None:
        self.wrench: np.ndarray | None = None
        self.fresh = True
        self.covariance = np.zeros((6, 6))
        self.taken: list[tuple] = []

    def take(self, m, seen, row) -> None:
        self.taken.append((m, seen, row))

    def inputs(self, m):
        return None if self.wrench is None else (-self.wrench, self.wrench)


def deviation(
    limit_n: float = 50.0, friction_uncertainty_n: float = 0.0
) -> tuple[DeviationFromForce, Balance, tuple[Arm, Arm]]:
    arms, balance = (Arm(), Arm()), Balance()
    guard, still = ForceGuard(limit_n, DT_S, time_s=0.008), ForceGuard(limit_n, DT_S, time_s=0.008, factor=1.0)
    return DeviationFromForce(arms, balance, guard, still, DT_S, friction_uncertainty_n), balance, arms  # type: ignore[arg-type]


def push(force_n: float) -> np.ndarray:
    return np.array([0.0, 0.6 * force_n, 0.8 * force_n, 5.0, 0.0, 0.0])


def test_force_inside_the_part_is_kept_by_the_command_and_torque_by_the_one_before():
    found, balance, (one, two) = deviation()
    assert found.take(0, AB) == ""
    assert found.inputs(0) == (None, None)
    balance.wrench = push(20.0)
    assert found.take(1, CD, 0.5) == ""
    assert found.force[1] == pytest.approx(push(20.0))
    assert (found.force[0] == 0).all()
    assert found.size_n(1) == pytest.approx(20.0)
    assert (one.calls, two.calls) == ([(0, "a", 1.0), (1, "c", 0.5)], [(0, "b", 1.0), (1, "d", 0.5)])
    assert balance.taken == [(0, ("seen of a", "seen of b"), None), (1, ("seen of c", "seen of d"), 0)]
    assert [each.tolist() for each in found.inputs(1)] == [(-push(20.0)).tolist(), push(20.0).tolist()]


def test_both_arms_are_read_before_the_path_begins():
    found, balance, (one, two) = deviation()
    found.listen(AB)
    assert (one.calls, two.calls) == ([(0, "a", 1.0)], [(0, "b", 1.0)])
    assert balance.taken == [(0, ("seen of a", "seen of b"), None)]


def test_a_force_above_twice_its_limit_for_longer_than_its_time_stops_both():
    """100 N, 8 ms: the third SYNC in a row."""
    found, balance, _ = deviation(50.0)
    balance.wrench = push(101.0)
    assert [found.take(m, AB) for m in range(2)] == ["", ""]
    why = found.take(2, AB)
    assert "above 100 N for more than 8 ms (101 N at command 3 of 8)" in why
    quiet, balance, _ = deviation(50.0)
    balance.wrench = push(99.0)
    assert [quiet.take(m, AB) for m in range(5)] == [""] * 5


def test_a_force_of_one_sync_does_not_last_because_no_sample_follows_it():
    """100 N, 8 ms: three SYNCs that show it, others between them or not."""
    found, balance, _ = deviation(50.0)
    balance.wrench = push(101.0)
    stops = []
    for m, fresh in enumerate([True, False, False, False, True, False, True]):
        balance.fresh = fresh
        stops.append(found.take(m, AB) != "")
    assert stops == [False] * 6 + [True]


@pytest.mark.parametrize(
    ("delay_s", "rows_ago", "cause"),
    [(0.0017, 4, "1.7 ms at a period of 4 ms"), (0.0015, 4, "from the start"), (0.0017, 60, "from the start")],
)
def test_a_stop_shortly_after_a_delayed_sync_names_it(delay_s, rows_ago, cause):
    """Drives take setpoints over half a period after a SYNC, give or take some; 0.2 s are 50 SYNCs."""
    found, balance, _ = deviation(50.0)
    balance.wrench = push(101.0)
    for row in range(-70, ROWS):
        sample = Sample("a")
        sample.sync_index = row + (row >= 0)  # one SYNC between standstill and the path is not reported
        sample.time_s = 10.0 + DT_S * sample.sync_index + (delay_s if row == 3 - rows_ago else 0.0)
        if row < 0:
            found.listen((sample, Sample("b")))
            continue
        why = found.take(row, (sample, Sample("b")))
        if row == 3:
            assert cause in why
            assert ("sync_period_s" in why) == ("period" in cause)


def at_rest(away_rad: float) -> tuple:
    """Samples of both arms, the second one this far from the beginning of its path."""
    second = SimpleNamespace(q_rad=np.array([0.3] * 5 + [0.3 - away_rad]))
    return SimpleNamespace(q_rad=np.full(6, 0.3), sync_index=0, time_s=0.0), second


def test_a_part_that_is_held_may_not_be_squeezed_during_the_transfer_to_the_start():
    """50 N, 8 ms: the third SYNC in a row, and only near the start, where the weights are known."""
    found, balance, (one, _) = deviation(50.0)
    assert found.rest(at_rest(0.0)) == ""
    balance.wrench = push(51.0)
    assert [found.rest(at_rest(0.006)) for _ in range(5)] == [""] * 5
    assert len(one.calls) == 1
    assert [found.rest(at_rest(0.004)) for _ in range(2)] == ["", ""]
    why = found.rest(at_rest(0.004))
    assert "51 N during the approach to the start, above 50 N" in why
    assert "check the grasp" in why


def test_a_force_within_friction_stops_no_arm_during_the_transfer_to_the_start():
    """60 N that are only known to 10 N, 95 %."""
    found, balance, _ = deviation(50.0)
    balance.wrench, balance.covariance = push(60.0), np.diag([5.1**2] * 6)
    assert [found.rest(at_rest(0.0)) for _ in range(5)] == [""] * 5
    balance.covariance = np.diag([4.9**2] * 6)
    assert found.rest(at_rest(0.0)) == found.rest(at_rest(0.0)) == ""
    assert "60 N" in found.rest(at_rest(0.0))


@pytest.mark.parametrize(("force_n", "doubtful"), [(9.9, True), (10.1, False)])
def test_a_small_force_may_be_friction(force_n, doubtful):
    found, balance, _ = deviation(friction_uncertainty_n=10.0)
    balance.wrench = push(force_n)
    found.take(1, AB)
    assert found.doubtful(1) == doubtful
    assert found.doubtful(0)


# -- distance ----------------------------------------------------------------------------------------------------------


def layout(missing: int = 3):
    channels = tuple(
        SimpleNamespace(subindex=number, gap_m=gap) for number, gap in ((1, 0.004), (2, 0.005), (4, 0.008))
    )
    config = SimpleNamespace(range_m=(0.001, 0.010), channel=channels, missing_cycles=missing, node_id=21, bus="b")
    demanded = np.array([0.004, 0.005, 0.008])
    estimator = SimpleNamespace(demanded_m=demanded, error_in_base=lambda readings, pose: (readings - demanded, pose))
    return SimpleNamespace(config=config, arm=1, estimator=estimator)


def sampled(*values: float | None) -> tuple:
    """Samples of both arms; the device is on the slave's bus."""
    reading = None if values == (None,) else SimpleNamespace(values=values)
    return SimpleNamespace(instruments=()), SimpleNamespace(instruments=(reading,))


def watch(missing: int = 3) -> GapWatch:
    return GapWatch(layout(missing))  # type: ignore[arg-type]


def test_distances_of_the_last_sync_alone_are_known():
    seen = watch()
    assert seen.readings_m is None
    assert seen.take(sampled(0.004, 0.006, 0.008)) is None
    assert seen.readings_m == pytest.approx([0.004, 0.006, 0.008])
    assert seen.take(sampled(None)) is None
    assert seen.readings_m is None


@pytest.mark.parametrize("value", [0.0009, 0.0101])
def test_a_distance_outside_the_range_of_its_sensor_stops_at_once_and_names_it(value):
    trouble = watch().take(sampled(0.004, 0.006, value))
    assert trouble is not None
    assert trouble.urgent
    assert f"sensor 4 measures {1e3 * value:.2f} mm, its range is 1 to 10 mm" in trouble.why
    assert watch().take(sampled(0.001, 0.010, 0.005)) is None


@pytest.mark.parametrize("values", [(None,), (0.004, None, 0.008)])
def test_distances_that_stay_away_stop_along_the_path(values):
    seen = watch(missing=3)
    assert [seen.take(sampled(*values)) for _ in range(2)] == [None, None]
    seen.take(sampled(0.004, 0.005, 0.008))
    assert [seen.take(sampled(*values)) for _ in range(2)] == [None, None]
    trouble = seen.take(sampled(*values))
    assert trouble is not None
    assert not trouble.urgent
    says = "sensor 2 reports no valid value" if len(values) == 3 else "its frames are missing or delayed"
    assert f"node 21 on bus 'b': no distances for 3 cycles, {says}" in trouble.why


def test_a_sensor_out_of_range_counts_even_if_another_one_does_not_respond():
    trouble = watch().take(sampled(None, 0.02, 0.005))
    assert trouble is not None
    assert trouble.urgent


def test_the_deviation_from_distances_is_expressed_in_the_slaves_base_and_kept_by_the_command():
    slave = np.arange(ROWS * 16.0).reshape(ROWS, 4, 4)
    seen = watch()
    found = DeviationFromDistance(seen, slave)
    assert found.inputs(3) == (None, None)
    assert found.gaps_m.shape == (ROWS, 3)
    samples = sampled(0.004, 0.006, 0.007)
    seen.take(samples)
    found.listen(samples)
    nothing, (error, pose) = found.inputs(3)
    assert nothing is None
    assert error == pytest.approx([0.0, 0.001, -0.001])
    assert np.array_equal(pose, slave[3])
    assert found.take(3, samples) == ""
    assert found.gaps_m[3] == pytest.approx([0.0, 0.001, -0.001])
    assert np.isnan(np.delete(found.gaps_m, 3, axis=0)).all()
    assert (found.size_n(3), found.doubtful(3)) == (0.0, False)
    seen.take(sampled(None))
    found.take(4, samples)
    assert np.isnan(found.gaps_m[4]).all()
