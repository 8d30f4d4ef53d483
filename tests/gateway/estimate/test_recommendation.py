"""What missing axes cost: the standard deviation of the mass without them over that with them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.estimate import recommendation
from gateway.estimate.recommendation import cost_of_missing_axes, next_pose, payload_information
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import CONSTANTS
from gateway.model.regressor import load_regressor

NAMES = ("mass_kg", "com_x_m", "com_y_m", "com_z_m")
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
    cost = cost_of_missing_axes(arm.robot, poses, sigma, Knowledge())
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
    alone = next_pose(without_constants(load), arm.robot, SIGMA, Knowledge())
    found = next_pose(load, arm.robot, SIGMA, Knowledge())
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
    assert np.isinf(cost_of_missing_axes(arm.robot, poses, only_vertical, Knowledge()))


def test_the_mass_is_known_where_only_a_moment_is_open_and_open_where_it_hides_behind_one(arm, poses, monkeypatch):
    """By the inverse of what is known; a direction that nothing is known of costs only what points along it."""
    plain = np.diag([4.0, 1.0, 9.0, 0.0])
    coupled = plain.copy()
    coupled[0, 1] = coupled[1, 0] = 1.5
    known = np.linalg.inv(coupled[:3, :3])[0, 0]
    hidden = np.outer([1.0, 0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 2.0])
    for information, variance in ((plain, 1 / 4), (coupled, known), (hidden, np.inf)):
        both = iter((information[None], np.eye(4)[None]))
        monkeypatch.setattr(recommendation, "payload_information", lambda *_, both=both: next(both))
        assert cost_of_missing_axes(arm.robot, poses, SIGMA, Knowledge()) == pytest.approx(np.sqrt(variance))


@pytest.mark.parametrize(
    ("unknown", "wide", "constants"),
    [("", 0.0, 0.0), ("com_y_m", 300.0, 0.0), ("mass_kg", 1000.0, 0.0), ("mass_kg", 1000.0, 0.75)],
)
def test_moments_that_a_load_leaves_open_are_bounded_by_an_unknown_load(arm, poses, unknown, wide, constants):
    """Mass up to an unknown load, moments up to that 0.3 m away; what is known stays as it is."""
    known, stated = np.diag([1.0, 2.0, 3.0, 4.0]), Knowledge()
    what = {"label": "tool", "covariance": known, "unidentifiable": (unknown,), "budget": {CONSTANTS: constants}}
    now = (1.0 - constants) * known + np.diag([wide if name == unknown else 0.0 for name in NAMES]) ** 2
    gained = np.linalg.det(np.eye(4) + now @ payload_information(arm.robot, poses[:1], SIGMA, stated.gravity_m_s2)[0])
    found = next_pose(SimpleNamespace(**what, refused=None), arm.robot, SIGMA, stated, poses[:1])
    assert found.reduction == pytest.approx(np.sqrt(constants + (1.0 - constants) * gained**-0.25))
    assert next_pose(SimpleNamespace(**what, refused="too few"), arm.robot, SIGMA, stated, poses[:1]) is None
