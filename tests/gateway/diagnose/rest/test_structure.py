"""Is what is left more than noise: false alarms and power by draws, closed forms, and cogging of a simulated arm."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from gateway.diagnose import diagnose
from gateway.diagnose.rest.holdout import fresh_misfit, fresh_seen
from gateway.diagnose.rest.residual_structure import (
    Power,
    StructureTest,
    misfit,
    pooled,
    structure_seen_nm,
)
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.start_noise import first_noise
from sim.effects import apply_effects
from sim.offline import half_floor
from tests.data.resting_arm import Bench, basis_of, effect, problem_of

AXES, POSES, LOADS, TAKEN = 6, 12, 2, 24
DRAWS = 4000


class Rows:
    """Half sums and half differences of six axes at twelve poses under two loads, and a linear fit to them."""

    def __init__(self, seed: int, loads: int = LOADS) -> None:
        rng = np.random.default_rng(seed)
        visits = POSES * loads
        axis = np.tile(np.arange(AXES), visits)
        visit = np.repeat(np.arange(visits), AXES)
        self.group = np.concatenate([axis, axis + AXES])
        self.visit = np.concatenate([visit, visit])
        self.pose = np.tile(np.arange(POSES), loads)[self.visit]
        sums = self.group < AXES
        # gravity in the half sums, a band of each axis in the half differences
        gravity = np.where(sums[:, None], rng.normal(size=(len(sums), TAKEN)), 0.0)
        bands = (self.group[:, None] == AXES + np.arange(AXES)).astype(float)
        self.basis, _ = np.linalg.qr(np.hstack([gravity, bands]))
        self.problem = SimpleNamespace(
            group=self.group,
            axis=self.group % AXES,
            axes=AXES,
            visit=self.visit,
            place=np.tile(np.arange(POSES), loads),
            by_group=lambda values=None: np.bincount(self.group, values, 3 * AXES),
        )
        noise = SimpleNamespace(std=np.ones(3 * AXES), least=np.full(3 * AXES, 1e-9))
        residual = np.zeros(len(self.group))
        self.fit = SimpleNamespace(
            basis=basis_of(self.basis), taken=self.taken_by(self.basis), noise=noise, residual=residual
        )
        self.test = StructureTest.of(self.problem, self.fit)

    def taken_by(self, basis: np.ndarray) -> np.ndarray:
        return np.bincount(self.group, (basis**2).sum(axis=1), 3 * AXES)

    def left(self, rows: np.ndarray) -> np.ndarray:
        return rows - self.basis @ (self.basis.T @ rows)

    def structure(self, rng: np.random.Generator, axes: list[int], draws: int) -> np.ndarray:
        """A torque of unit RMS by pose, on the half sums of some axes."""
        torque = rng.standard_normal((AXES, POSES, draws))
        torque /= np.sqrt((torque**2).mean(axis=1, keepdims=True))
        here = np.isin(self.group, axes)
        return np.where(here[:, None], torque[self.group % AXES, self.pose], 0.0)


@pytest.fixture(scope="module")
def rows() -> Rows:
    return Rows(1)


def noise_of(kind: str, rng: np.random.Generator, count: int) -> np.ndarray:
    if kind == "settled":  # half of the sum and of the difference of two sides that settled by uniform shares
        sides = rng.uniform(-1.0, 1.0, size=(2, count // 2, DRAWS))
        return np.concatenate([sides[0] + sides[1], sides[0] - sides[1]])
    return rng.standard_normal((count, DRAWS))


@pytest.mark.parametrize("kind", ["normal", "settled"])
@pytest.mark.parametrize("loads", [1, 2, 3])
def test_noise_alone_is_no_structure(kind, loads):
    """At the level of one in a thousand; and the small probabilities come as seldom as they say."""
    made = Rows(2, loads)
    noise = noise_of(kind, np.random.default_rng(3), len(made.group))
    chance = made.test.chance(made.left(noise))
    assert np.mean(chance < REST.structure_p) <= 3.0 * REST.structure_p
    assert np.mean(chance < 0.01) <= 0.015
    assert np.mean(chance < 0.05) <= 0.06
    assert np.median(chance) < 1.0


def test_the_size_of_an_axis_makes_no_difference(rows):
    noise = rows.left(np.random.default_rng(0).standard_normal((len(rows.group), 20)))
    size = np.array([1e-3, 1.0, 50.0, 2.0, 1.0, 0.1])[rows.group % AXES]
    assert rows.test.chance(noise * size[:, None]) == pytest.approx(rows.test.chance(noise))


@pytest.mark.parametrize("axes", [[2], list(range(AXES))], ids=["one axis", "every axis"])
def test_the_reported_size_is_detected_four_times_in_five(rows, axes):
    size = Power(rows.test).size_seen(axes)
    rng = np.random.default_rng(11)
    noise = rows.left(rng.standard_normal((len(rows.group), 1000)))
    structure = rows.left(rows.structure(rng, axes, 1000))
    seen = [np.mean(rows.test.chance(noise + part * size * structure) < REST.structure_p) for part in (0.5, 1.0, 2.0)]
    assert seen[1] == pytest.approx(0.8, abs=0.1)
    assert seen[0] < 0.5
    assert seen[2] > 0.99


def test_what_is_on_every_axis_is_seen_where_it_is_too_small_on_each(rows):
    everywhere, alone = Power(rows.test).size_seen(range(AXES)), Power(rows.test).size_seen([2])
    assert everywhere < 1.0 < 2.0 * everywhere < alone
    detectable_nm = structure_seen_nm(rows.problem, rows.fit, np.arange(1.0, 7.0))
    assert detectable_nm["structure_seen_on_all_nm"] == pytest.approx(everywhere * np.arange(1.0, 7.0))
    assert detectable_nm["structure_seen_nm"][2] == pytest.approx(3.0 * alone)


def test_too_few_visits_see_nothing():
    made = Rows(1)
    made.problem.place = np.arange(POSES * LOADS)  # no pose twice
    everything = np.eye(len(made.group))
    made.fit.basis, made.fit.taken = basis_of(everything), made.taken_by(everything)
    assert misfit(made.problem, made.fit) == 1.0
    detectable_nm = structure_seen_nm(made.problem, made.fit, np.ones(AXES))
    assert detectable_nm == {"structure_seen_nm": [None] * AXES, "structure_seen_on_all_nm": [None] * AXES}


def test_chances_are_pooled_by_their_normal_scores():
    chances = np.array([[0.02, 0.5], [0.10, 0.5], [0.30, 0.5]])
    expected = [stats.combine_pvalues(column, method="stouffer").pvalue for column in chances.T]
    assert pooled(chances) == pytest.approx(expected)
    weights = np.array([1.0, 3.0, 2.0])
    weighted = stats.combine_pvalues(chances[:, 0], method="stouffer", weights=weights).pvalue
    assert pooled(chances, weights)[0] == pytest.approx(weighted)
    assert pooled([np.array([0.0]), np.array([1.0])])[0] == pytest.approx(0.5, abs=1e-3)


@pytest.fixture(scope="module")
def cogging() -> tuple[list[float], list[float]]:
    """Chance of what is left of thirty arms at twelve poses, bare and loaded: with cogging, and without."""
    found: tuple[list[float], list[float]] = ([], [])
    for seed in range(1000, 1030):
        for into, amplitude in zip(found, (1.0, 0.0), strict=True):
            bench = Bench(seed, [], poses=12)
            size = amplitude * np.sqrt(2.0) * half_floor(bench.plant, bench.arm.protocol)
            phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 6)
            swings = [
                effect(
                    "torque_ripple",
                    [axis + 1],
                    amplitude_nm=float(size[axis]),
                    per_revolution=float(bench.arm.gear_ratio[axis]),
                    phase_rad=float(phase[axis]),
                )
                for axis in range(6)
            ]
            bench.plant = apply_effects(bench.plant, swings)
            problem = problem_of(bench, bench.both())
            into.append(misfit(problem, fit(problem, (), first_noise(problem))))
    return found


@pytest.mark.slow
def test_cogging_of_one_floor_on_every_axis_is_seen(cogging):
    with_it, without = (np.array(each) for each in cogging)
    assert np.mean(with_it < REST.structure_p) >= 0.8
    assert np.mean(without < REST.structure_p) <= 1 / 30


def test_a_result_says_what_it_would_have_seen():
    bench = Bench(1, [])
    result = diagnose(bench.both(), bench.robot, bench.options)
    alone, everywhere = (np.array(result.quality[name]) for name in ("structure_seen_nm", "structure_seen_on_all_nm"))
    floor = np.array(result.noise_floor_nm)
    assert everywhere / floor == pytest.approx(everywhere[0] / floor[0])
    assert 0.5 < everywhere[0] / floor[0] < 1.5
    assert (alone > 1.5 * everywhere).all()
    assert (alone < 5.0 * floor).all()
    assert "fresh_seen_nm" not in result.quality


# ------------------------------------------------------------------------------------------------------ fresh rows


def test_fresh_rows_are_judged_by_axis_and_over_all():
    """By chi-square where the noise is known, by F where it was estimated from few; pooled by the root of the rows."""
    group = np.repeat([0, 2, 4], [4, 6, 3])  # half sums of axes 1 and 3, half differences of axis 2 of three
    covariance = np.diag(np.repeat([4.0, 0.25, 1.0], [4, 6, 3]))
    residual = np.concatenate([np.full(4, 3.0), np.full(6, 0.5), np.full(3, 0.1)])
    mean = np.array([9.0 / 4.0, 1.0, 0.01]) / REST.fresh_slack
    known = [stats.chi2.sf(x * n, n) for x, n in zip(mean, (4, 6, 3), strict=True)]
    detectable_nm = [stats.f.sf(x, n, freedom) for x, n, freedom in zip(mean, (4, 6, 3), (10.0, 1.0, 1.0), strict=True)]
    for (first, third, differences), spare in ((known, None), (detectable_nm, np.array([10.0, 0.3, 0.0]))):
        over = stats.combine_pvalues([first, third], method="stouffer", weights=np.sqrt([4.0, 6.0])).pvalue
        expected = 4 * min(2 * min(first, third), over, differences)
        assert fresh_misfit(residual, covariance, group, 3, spare) == pytest.approx(min(1.0, expected))
    assert fresh_misfit(0.1 * residual, covariance, group, 3) == 1.0
    assert fresh_misfit(np.zeros(0), np.zeros((0, 0)), np.zeros(0, dtype=int), 3) == 1.0


def caught(doubled: list[int], draws: int = 600, known_by: float | None = None) -> float:
    """Share of proofs on four fresh poses that catch doubled residuals of some axes of six."""
    rng = np.random.default_rng(5)
    group = np.concatenate([np.tile(np.arange(6), 4), np.tile(np.arange(6), 4) + 6])
    spare = None if known_by is None else np.full(6, known_by)
    chances = []
    for _ in range(draws):
        residual = rng.standard_normal(len(group)) * np.where(np.isin(group % 6, doubled), 2.0, 1.0)
        if known_by is not None:
            residual *= np.sqrt(known_by / rng.chisquare(known_by, 6))[group % 6]
        chances.append(fresh_misfit(residual, np.eye(len(group)), group, 6, spare))
    return float(np.mean(np.array(chances) < REST.fresh_p))


@pytest.mark.parametrize("known_by", [None, 40.0])
def test_four_fresh_poses_see_a_doubled_residual(known_by):
    assert caught([], known_by=known_by) < 0.04
    assert caught([2], known_by=known_by) > 0.38
    assert caught(list(range(6)), known_by=known_by) > 0.98


def test_the_size_that_fresh_poses_would_detect_is_reported():
    """A structure of that RMS on the half sums of one axis, in noise floors, four times in five."""
    rng = np.random.default_rng(6)
    size = fresh_seen(np.array([4, 0, 8]))
    assert np.isinf(size[1])
    assert size[2] < size[0]
    group = np.repeat([0, 2], [4, 8])
    seen = [
        fresh_misfit(rng.standard_normal(12) * np.hypot(1.0, size[0] * (group == 0)), np.eye(12), group, 3)
        < REST.fresh_p
        for _ in range(1500)
    ]
    assert np.mean(seen) == pytest.approx(0.8, abs=0.06)
