"""What missing axes cost: the standard deviation of the mass without them over that with them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.estimate import EstimateOptions, recommendation
from gateway.estimate.recommendation import cost_of_missing_axes, next_pose
from gateway.identify.budget import CONSTANTS
from gateway.model.regressor import load_regressor

SIGMA = np.array([2.0, 3.0, 2.0, 1.0, 0.5, 0.4])


def mass_std(robot, poses, sigma):
    """Of mass and first moment alone, by the normal equations written here."""
    rows = load_regressor(robot, poses)
    use = np.isfinite(sigma)
    weighted = (rows[:, use] / sigma[use][None, :, None]).reshape(-1, 4)
    return np.sqrt(np.linalg.inv(weighted.T @ weighted)[0, 0])


@pytest.mark.parametrize("missing", [[1], [3, 4], [5]])
def test_cost_is_the_ratio_of_the_standard_deviations(arm, poses, missing):
    sigma = SIGMA.copy()
    sigma[missing] = np.nan
    full = np.where(np.isnan(sigma), np.nanmedian(sigma), sigma)
    cost = cost_of_missing_axes(arm.robot, poses, sigma, EstimateOptions())
    assert cost == pytest.approx(mass_std(arm.robot, poses, sigma) / mass_std(arm.robot, poses, full), rel=1e-6)
    assert cost >= 1.0


@pytest.mark.parametrize("constants", [0.0, 0.4, 0.9])
def test_no_pose_takes_away_what_the_constants_leave_open(arm, constants):
    """The share of the noise falls as if there were nothing else, that of the constants stays."""
    load = SimpleNamespace(
        label="tool",
        refused=None,
        covariance=np.diag([0.1, 0.01, 0.01, 0.02]) ** 2 / (1.0 - constants),
        unidentifiable=(),
        budget={CONSTANTS: constants, "noise": 1.0 - constants},
    )
    alone = next_pose(without_constants(load), arm.robot, SIGMA, EstimateOptions())
    found = next_pose(load, arm.robot, SIGMA, EstimateOptions())
    assert found.poses_rad == alone.poses_rad
    assert found.reduction == pytest.approx(np.sqrt(constants + (1.0 - constants) * alone.reduction**2))
    assert alone.reduction < 1.0


def without_constants(load):
    """The same load with the covariance that is not of the constants, and nothing else."""
    share = 1.0 - load.budget[CONSTANTS]
    rest = {"covariance": share * load.covariance, "budget": {}}
    return SimpleNamespace(**vars(load) | rest)


def test_cost_is_infinite_where_the_mass_is_open(arm, poses):
    only_vertical = np.array([2.0, *[np.nan] * 5])
    assert np.isinf(cost_of_missing_axes(arm.robot, poses, only_vertical, EstimateOptions()))


def test_the_mass_is_known_where_only_a_moment_is_open_and_open_where_it_hides_behind_one():
    """By the inverse of what is known; a direction that nothing is known of costs only what points along it."""
    plain = np.diag([4.0, 1.0, 9.0, 0.0])
    assert recommendation._mass_variance(plain) == pytest.approx(1 / 4)
    coupled = plain.copy()
    coupled[0, 1] = coupled[1, 0] = 1.5
    assert recommendation._mass_variance(coupled) == pytest.approx(np.linalg.inv(coupled[:3, :3])[0, 0])
    row = np.array([[1.0, 0.0, 0.0, 2.0]])
    assert np.isinf(recommendation._mass_variance(row.T @ row))
