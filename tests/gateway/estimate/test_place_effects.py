"""What a model lacks at a place: the same under every load, or under one, with a size that the rows determine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from gateway.data.rows import concatenate
from gateway.estimate import estimate
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.place_effects import PlaceEffects, likeliest_effects
from gateway.identify.rest.problem import build_problem
from gateway.identify.solve import ByGroup, Prior
from gateway.model.visits import pair_visits

TOOL = (8.0, 0.12, -0.03, 0.05)


def lacking(table, torque_nm):
    """The table with a further torque (poses, N) at each pose."""
    return replace(table, tau_nm=table.tau_nm + torque_nm[table.pose])


def unnamed(arm, poses):
    """Torque (poses, 6) of no shape that the product knows: several friction bands on J2 and J3."""
    torque = np.zeros_like(poses)
    torque[:, 1] = 2.5 * arm.band_nm[1] * np.sin(2.0 * poses[:, 1] + 0.6)
    torque[:, 2] = 1.5 * arm.band_nm[2] * np.sign(np.sin(3.0 * poses[:, 2]))
    return torque


@pytest.fixture
def repeated(arm, poses, measured):
    """Rest problem whose rows repeat places under two loads, some one-sided."""
    rng = np.random.default_rng(3)
    loads = {"none": None, "tool": TOOL}
    two = measured(arm, poses[:6], loads, rng, left=0.05)
    again = measured(arm, poses[:4], {"tool": TOOL}, rng, left=0.05)
    one = measured(arm, poses[4:8], loads, rng, left=0.05, sides=(1,))
    again = replace(again, pose=again.pose + 100)
    one = replace(one, pose=one.pose + 200)
    return build_problem(arm.robot, pair_visits(concatenate([two, again, one])), Knowledge(link_std=0.05))


def sharing(problem):
    """Whether rows (2, rows, rows) share a place, and a place under one load, row by row from the definition."""
    rows, side, count = problem.rows, problem.rows.side, len(problem.target)
    out = np.zeros((2, count, count), dtype=bool)
    for i, j in np.ndindex(count, count):
        group, (a, b) = problem.group[i], problem.visit[[i, j]]
        axis = group % problem.axes
        half = problem.axes <= group < 2 * problem.axes
        near = np.abs(rows.q_rad[a] - rows.q_rad[b]).max() < 0.01 and side[a, axis] == side[b, axis]
        out[0, i, j] = group == problem.group[j] and near and not half
        out[1, i, j] = out[0, i, j] and rows.load[a] == rows.load[b]
    return out


def covariance_of(problem, variance, shared):
    """Covariance (rows, rows) of rows with these variances (3, groups)."""
    own, place, load = variance[:, problem.group]
    return np.diag(own) + place * shared[0] + load * shared[1]


def test_rows_become_independent_with_unit_variance(repeated):
    rng = np.random.default_rng(1)
    variance = rng.uniform(0.5, 3.0, (3, 3 * repeated.axes))
    variance[1:, [k for k in range(3 * repeated.axes) if k not in repeated.places.cells]] = 0.0
    effects, complete = PlaceEffects(variance), covariance_of(repeated, variance, sharing(repeated))
    every = np.eye(len(complete))
    white = effects.whitened(repeated.places, every)
    assert (np.count_nonzero(complete, axis=1) > 2).any()
    assert white @ complete @ white.T == pytest.approx(every, abs=1e-9)
    assert effects.whitened(repeated.places, every, transposed=True) == pytest.approx(white.T, abs=1e-9)
    columns = ByGroup.of(rng.standard_normal((len(complete), 5)), repeated.group)
    assert effects.whitened_columns(repeated.places, columns).dense == pytest.approx(white @ columns.dense, abs=1e-9)


def test_the_variances_maximise_the_density_of_the_rows(repeated):
    """The oracle integrates the parameters out as one normal distribution of all rows."""
    noise, shared = fit_without_effects(repeated).noise, sharing(repeated)
    rng = np.random.default_rng(2)
    columns = ByGroup.of(rng.standard_normal((len(repeated.target), 4)), repeated.group)
    truth = np.stack([noise.start**2, 9.0 * noise.start**2, noise.start**2])
    truth[1:, [k for k in range(3 * repeated.axes) if k not in repeated.places.cells]] = 0.0
    target = rng.multivariate_normal(np.zeros(len(repeated.target)), covariance_of(repeated, truth, shared))
    prior = replace(Prior.free(4), std=np.full(4, 2.0))
    begin = PlaceEffects.about(noise.start, 2.0 * noise.start)
    found = likeliest_effects(
        repeated.places, columns, target, prior, begin, start=noise.start, least=noise.least, tolerance=1e-10
    ).variance

    def density(variance):
        marginal = covariance_of(repeated, variance, shared) + 4.0 * columns.dense @ columns.dense.T
        value = multivariate_normal(np.zeros(len(target)), marginal).logpdf(target)
        alone = variance[0] / noise.start**2
        value -= 2.0 * np.sum((np.log(alone) + 1.0 / alone)[np.unique(repeated.group)])
        ratio = 2.0 * (variance[1:] / variance[0])[variance[1:] > 0.0]
        return value + np.sum(0.5 * np.log(ratio) - np.log1p(ratio))

    best = density(found)
    for kind, group in np.argwhere(found > 0.0):
        for factor in (0.7, 1.4):
            moved = found.copy()
            moved[kind, group] *= factor
            assert density(moved) < best + 1e-4, (kind, group)


def test_without_bounds_the_fit_is_the_difference_of_loads(arm, poses, measured):
    """Torques of a hundred bands at every place leave the differences, solved here by least squares."""
    rng = np.random.default_rng(5)
    table = measured(arm, poses, {"none": None, "tool": TOOL}, rng, left=0.02)
    table = lacking(table, 100.0 * arm.band_nm * rng.standard_normal(poses.shape))
    knowledge = Knowledge(link_std=np.inf, gain_std=(1e-6,) * 6, change=1e-3)
    (load,) = estimate(table, arm.robot, knowledge).loads
    visits = pair_visits(table)
    difference = visits.sum_nm[visits.load == "tool"] - visits.sum_nm[visits.load == "none"]
    unit = [(1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 1.0)]
    of_mass, *others = (arm.gravity_torque(poses, body) - arm.gravity_torque(poses) for body in unit)
    columns = np.stack([of_mass, *(other - of_mass for other in others)], axis=2) / arm.band_nm[:, None]
    moment = np.linalg.lstsq(columns.reshape(-1, 4), (difference / arm.band_nm).ravel(), rcond=None)[0]
    assert load.mass_kg == pytest.approx(moment[0], abs=0.3 * load.mass_std_kg)
    assert load.mass_std_kg < 0.02 * TOOL[0]
    assert abs(load.mass_kg - TOOL[0]) < 3.0 * load.mass_std_kg


def test_an_effect_without_a_name_does_not_widen_the_interval_by_its_size(arm, poses, measured):
    deviations, clean_std, std = [], [], []
    for seed in range(4):
        rng = np.random.default_rng([seed, 6])
        table = measured(arm, poses, {"none": None, "tool": TOOL}, rng, left=0.05)
        knowledge = Knowledge(link_std=np.inf, gain_std=(0.01,) * 6)
        (clean,) = estimate(table, arm.robot, knowledge).loads
        (load,) = estimate(lacking(table, unnamed(arm, poses)), arm.robot, knowledge).loads
        clean_std.append(clean.mass_std_kg)
        std.append(load.mass_std_kg)
        deviations.append((load.mass_kg - TOOL[0]) / load.mass_std_kg)
    assert np.median(std) < 1.5 * np.median(clean_std)
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5


def test_a_place_is_known_by_its_angles(arm, poses, measured):
    """Pose numbers and the order of the rows change nothing."""
    rng = np.random.default_rng(7)
    table = lacking(measured(arm, poses, {"none": None, "tool": TOOL}, rng, left=0.05), unnamed(arm, poses))
    (load,) = estimate(table, arm.robot, Knowledge(link_std=np.inf)).loads
    renumbered = replace(table, pose=table.pose + 50 * (table.load == "tool"))
    renumbered = renumbered.take(rng.permutation(len(table.pose)))
    (same,) = estimate(renumbered, arm.robot, Knowledge(link_std=np.inf)).loads
    assert same.mass_kg == pytest.approx(load.mass_kg, rel=1e-4)
    assert same.mass_std_kg == pytest.approx(load.mass_std_kg, rel=1e-3)
