"""Lines through checks: against dense least squares, what a drift is weighed by, and what is said."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest
from scipy.linalg import null_space

from gateway.fleet.correlated_noise import SHAPES, FittedLines, detectable, lines, needed_sigmas, sigmas, sums
from gateway.fleet.history import CheckSeries
from gateway.fleet.trends import NoiseShapes, active_columns, looks_of, noise_shapes_of, seen_likelihoods, trends_of
from gateway.result.fleet import GAIN

FIRST = datetime(2026, 1, 1)


def series(
    value: np.ndarray, temperature_c: np.ndarray | None = None, load_kg: np.ndarray | None = None
) -> CheckSeries:
    """Gains of one check a day."""
    count, axes = value.shape
    blank = np.zeros((count, axes))
    return CheckSeries(
        quantities=(GAIN,) * axes,
        joints=tuple(range(1, axes + 1)),
        programs=("",) * axes,
        time_a=np.arange(count) / 365.25,
        value=value,
        std=np.full((count, axes), np.nan),
        temperature_c=blank if temperature_c is None else temperature_c - temperature_c.mean(axis=0),
        load_kg=blank if load_kg is None else load_kg - load_kg.mean(axis=0),
        set_aside=np.zeros(axes),
    )


def dense(time_a: np.ndarray, design: np.ndarray, value: np.ndarray, noise: np.ndarray, ratio: float, time: float):
    """Generalised least squares with the whole covariance matrix: value, covariance with the noise as read."""
    covariance = ratio * np.exp(-np.abs(time_a[:, None] - time_a) / time) + np.diag(noise**2)
    inverse = np.linalg.inv(covariance)
    normal = np.linalg.inv(design.T @ inverse @ design)
    found = normal @ design.T @ inverse @ value
    left = value - design @ found
    return found, normal * (left @ inverse @ left) / (len(value) - design.shape[1])


def test_filter_gives_what_dense_least_squares_gives() -> None:
    rng = np.random.default_rng(1)
    count = 40
    time_a = np.sort(rng.uniform(0, 0.5, count))
    design = np.column_stack([np.ones(count), time_a, rng.normal(size=count), rng.normal(size=count)])
    value = design @ [0.3, 2.0, -0.5, 0.1] + rng.normal(size=count)
    noise = rng.uniform(0.5, 2.0, count)
    hole = rng.choice(count, 6, replace=False)
    seen = np.setdiff1d(np.arange(count), hole)
    columns = np.column_stack([design, value])[:, None, :].copy()
    columns[hole] = np.nan
    (summed,) = sums(time_a, columns, noise[:, None], np.array([count]))
    fitted = lines(summed, np.ones((1, 4), dtype=bool))
    assert fitted.freedom.tolist() == [len(seen) - 4]
    for index, shape in enumerate(SHAPES):
        found, covariance = dense(time_a[seen], design[seen], value[seen], noise[seen], shape.ratio, shape.time_a)
        assert fitted.value[index, 0] == pytest.approx(found, rel=1e-6, abs=1e-9)
        assert fitted.covariance[index, 0] == pytest.approx(covariance, rel=1e-6, abs=1e-12)


def test_a_look_sees_nothing_of_later_checks() -> None:
    value = np.random.default_rng(2).normal(size=(80, 1))
    before = looks_of(series(value))[2]
    value[before.checks :] += 100.0
    after = looks_of(series(value))[2]
    assert np.array_equal(before.sums.products, after.sums.products)


def test_likelihoods_are_those_of_the_checks_without_what_is_not_known() -> None:
    """Against the density of what is left when level, temperature and load are projected away, and integrated noise."""
    rng = np.random.default_rng(6)
    count, tolerance = 40, 2.0
    time_a = np.sort(rng.uniform(0, 0.5, count))
    design = np.column_stack([np.ones(count), time_a, rng.normal(size=count), rng.normal(size=count)])
    value = design @ [0.3, 1.5, -0.5, 0.1] + 0.3 * rng.normal(size=count)
    columns = np.column_stack([design, value])[:, None, :]
    (summed,) = sums(time_a, columns, np.ones((count, 1)), np.array([count]))
    fitted = lines(summed, np.ones((1, 4), dtype=bool))
    rest = null_space(design[:, [0, 2, 3]].T)
    for index in (0, 4):
        shape = SHAPES[index]
        covariance = shape.ratio * np.exp(-np.abs(time_a[:, None] - time_a) / shape.time_a) + np.eye(count)
        inverse = np.linalg.inv(rest.T @ covariance @ rest)

        def density(drift: float, inverse: np.ndarray = inverse) -> float:
            left = rest.T @ (value - drift * time_a)
            return float(left @ inverse @ left) ** (-(count - 3) / 2)

        sizes = [(2.0**power, 0.8 if power == 0 else 0.2 / 7.0) for power in range(-4, 4)]
        some = sum(0.5 * share * density(sign * tolerance * size) for size, share in sizes for sign in (-1, 1))
        only = np.where(np.arange(len(SHAPES)) == index, 0.0, -1e9)[:, None]
        found = sigmas(fitted, only, np.array([tolerance]))
        assert found[0] == pytest.approx(np.sqrt(2.0 * np.log(some / density(0.0))), rel=1e-6)


@pytest.mark.slow
def test_no_drift_is_reported_by_chance_more_often_than_promised() -> None:
    """Series of noise that are looked at every three days of a year, with a threshold for one in ten."""
    rng = np.random.default_rng(7)
    summed = 0
    for _ in range(5):
        noise = series(rng.normal(0, 0.003, (365, 60)))
        looks, active = looks_of(noise), active_columns(noise)
        prior = noise_shapes_of([seen_likelihoods(noise)]).of(noise)
        most = np.zeros(60)
        for look in looks:
            most = np.fmax(most, np.abs(sigmas(lines(look.sums, active), prior, np.full(60, GAIN.tolerance))))
        summed += int((most > np.sqrt(2.0 * np.log(1.0 / 0.1))).sum())
    assert 3 <= summed <= 0.1 * 300 + 2.0 * np.sqrt(0.1 * 0.9 * 300)


def test_threshold_is_shared_by_all_that_is_looked_at() -> None:
    assert np.exp(0.5 * needed_sigmas(1) ** 2) == pytest.approx(100.0)
    assert np.exp(0.5 * needed_sigmas(36) ** 2) == pytest.approx(3600.0)


@pytest.mark.parametrize("tolerance", [0.02, 0.3])
def test_a_drift_that_is_called_detectable_is_detected_in_95_of_100(tolerance: float) -> None:
    std, needed = 0.003, needed_sigmas(27)
    (drift,) = detectable(np.array([std]), np.array([tolerance]), needed)
    found = np.random.default_rng(8).normal(drift, std, 4000)
    freedom = np.full(4000, 1e6)
    fitted = FittedLines(
        value=np.stack([np.zeros(4000), found], axis=1)[None],
        covariance=np.broadcast_to(np.diag([1.0, std**2]), (1, 4000, 2, 2)),
        square=np.ones((1, 4000)),
        freedom=freedom,
        log_likelihood=np.zeros((1, 4000)),
    )
    share = (sigmas(fitted, np.zeros((1, 4000)), np.full(4000, tolerance)) > needed).mean()
    assert share == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / 4000))


def test_drift_is_detected_under_temperature_and_load_and_its_day_with_it() -> None:
    rng = np.random.default_rng(4)
    day = np.arange(300)[:, None]
    warm = 25 + 8 * np.sin(2 * np.pi * day / 365) + rng.normal(0, 2, (300, 2))
    load = rng.choice([0.0, 5.0, 12.0], (300, 1)) * np.ones(2)
    value = 0.01 + 0.0005 * warm + 0.0001 * load + rng.normal(0, 0.001, (300, 2))
    value[:, 1] += 0.02 * day[:, 0] / 365.25
    summed = series(value, warm, load)
    quiet, drifting = trends_of(summed, noise_shapes_of([seen_likelihoods(summed)] * 20), FIRST)[0]
    assert quiet.found_on is None
    assert abs(quiet.drift_per_year) < 3 * quiet.drift_std_per_year
    assert drifting.drift_per_year == pytest.approx(0.02, abs=3 * drifting.drift_std_per_year)
    assert drifting.per_k == pytest.approx(0.0005, rel=0.2)
    assert drifting.per_kg == pytest.approx(0.0001, rel=0.2)
    assert drifting.found_on is not None
    assert "2026-02" < drifting.found_on < "2026-09"
    assert drifting.sigmas > drifting.needed_sigmas > 3.0


def test_what_does_not_change_is_no_column() -> None:
    warm = np.column_stack([np.full(30, 20.0), np.arange(30.0)])
    assert active_columns(series(np.ones((30, 2)), warm)).tolist() == [
        [True, True, False, False],
        [True, True, True, False],
    ]


@pytest.mark.parametrize("count", [10, 25])
def test_nothing_is_reported_from_few_checks(count: int) -> None:
    value = 0.1 * np.arange(count)[:, None]
    (trend,), _ = trends_of(series(value), NoiseShapes(), FIRST)
    assert np.isnan(trend.sigmas)
    assert np.isnan(trend.detectable_per_year)
    assert trend.found_on is None


def test_random_walk_of_the_fleet_is_estimated() -> None:
    rng = np.random.default_rng(5)
    calm = noise_shapes_of([seen_likelihoods(series(rng.normal(size=(200, 6)))) for _ in range(4)])
    kept, moved = np.exp(-1 / 30), []
    for _ in range(4):
        steps = rng.normal(size=(200, 6))
        random_walk = np.zeros((200, 6))
        for row in range(1, 200):
            random_walk[row] = kept * random_walk[row - 1] + np.sqrt(1 - kept**2) * steps[row]
        moved.append(seen_likelihoods(series(2.0 * random_walk + rng.normal(size=(200, 6)))))
    ratio = np.array([shape.ratio for shape in SHAPES])
    shares = [np.exp(each.log_share["gain"]) @ ratio for each in (calm, noise_shapes_of(moved))]
    assert shares[0] < 0.2
    assert shares[1] > 1.0
