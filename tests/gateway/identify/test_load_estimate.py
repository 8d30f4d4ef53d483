"""A load from mass and first moment: propagation of the covariance against draws."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gateway.identify.inertia import LoadInertia
from gateway.identify.load_estimate import (
    LOAD_PARTS,
    in_flange,
    load_from_moment,
    load_result,
    refused_load,
    unknown_load,
)
from gateway.result.names import INERTIA_WHOLE

MOMENT = np.array([10.0, 1.0, -0.5, 2.0])
MIX = np.random.default_rng(3).normal(size=(4, 4))
COVARIANCE = 1e-4 * (MIX @ MIX.T)


def test_covariance_of_mass_and_centre_is_that_of_draws():
    load = load_from_moment("a", MOMENT, COVARIANCE, np.ones(4), np.ones(4, dtype=bool), 2.0)
    draws = np.random.default_rng(0).multivariate_normal(MOMENT, COVARIANCE, size=400_000)
    bodies = np.column_stack([draws[:, 0], draws[:, 1:] / draws[:, :1]])
    assert [load.mass_kg, *load.com_m] == pytest.approx([10.0, 0.1, -0.05, 0.2])
    assert [load.mass_std_kg, *load.com_std_m] == pytest.approx(bodies.std(axis=0).tolist(), rel=0.01)
    assert np.asarray(load.correlation) == pytest.approx(np.corrcoef(bodies.T), abs=0.01)


def test_the_inertia_is_turned_into_the_axes_of_the_flange():
    turn = Rotation.from_euler("ZYX", [20.0, -35.0, 70.0], degrees=True).as_matrix()
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = turn, (0.0, 0.01, 0.12)
    robot = SimpleNamespace(flange=flange, last_link="link_6")
    moments = np.array([2.0, 3.0, 1.5, 0.4, -0.3, 0.2])
    load = load_from_moment(
        "a", 10.0 * np.array([1.0, 0.1, 0.0, 0.2]), np.zeros((4, 4)), np.ones(4), np.ones(4, dtype=bool), 2.0
    )
    result = load_result(replace(load, inertia=LoadInertia(moments, np.full(6, 0.01))), robot)  # type: ignore[arg-type]
    xx, yy, zz, xy, xz, yz = result.inertia_flange_kg_m2
    seen = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # a spin about an axis has the same energy however the axes are named
    for spin in np.random.default_rng(2).normal(size=(5, 3)):
        there = turn.T @ spin
        energy = spin @ np.array([[2.0, 0.4, -0.3], [0.4, 3.0, 0.2], [-0.3, 0.2, 1.5]]) @ spin
        assert there @ seen @ there == pytest.approx(energy)
    moments[2] = np.nan
    part = load_result(replace(load, inertia=LoadInertia(moments, np.full(6, 0.01))), robot)  # type: ignore[arg-type]
    assert part.inertia_flange_kg_m2 is None


def test_widening_widens_the_deviations_and_not_the_correlation():
    plain = load_from_moment("a", MOMENT, COVARIANCE, np.ones(4), np.ones(4, dtype=bool), 2.0)
    wide = load_from_moment("a", MOMENT, COVARIANCE, np.array([2.0, 3.0, 4.0, 5.0]), np.ones(4, dtype=bool), 2.0)
    assert wide.mass_std_kg == pytest.approx(2.0 * plain.mass_std_kg)
    assert wide.com_std_m == pytest.approx(np.array([3.0, 4.0, 5.0]) * plain.com_std_m)
    assert np.asarray(wide.correlation) == pytest.approx(np.asarray(plain.correlation))


def test_what_the_data_do_not_determine_is_unknown_and_named():
    found = np.array([True, True, False, True])
    load = load_from_moment("a", MOMENT, COVARIANCE, np.ones(4), found, 2.0)
    assert load.unidentifiable == ("com_y_m",)
    assert np.isnan(load.com_m[1])
    correlation = np.asarray(load.correlation)
    assert np.isnan(correlation[2]).all()
    assert np.isnan(correlation[:, 2]).all()
    assert correlation[3, 3] == 1.0


def test_a_coordinate_with_an_uncertainty_above_the_arm_length_is_a_guess():
    spread, found = np.diag([1e-4, 1e-4, 1e-4, 900.0]), np.array([True, False, True, True])
    load, result = (load_from_moment("a", MOMENT, spread, np.ones(4), found, length_m) for length_m in (4.0, 1.5))
    assert load.unidentifiable == ("com_x_m",)
    assert result.unidentifiable == ("com_x_m", "com_z_m")
    assert np.isnan(result.com_m).tolist() == [True, False, True]
    assert np.isnan(result.com_std_m[2])
    assert np.isnan(result.correlation[3]).all()
    assert result.correlation[0, 2] == pytest.approx(load.correlation[0, 2])


@pytest.mark.parametrize(("std_kg", "refused"), [(0.32, True), (0.34, False)])
def test_a_mass_below_zero_by_more_than_its_uncertainty_is_refused(std_kg, refused):
    spread = np.diag([std_kg**2, 1e-4, 1e-4, 1e-4])
    load = load_from_moment("a", -MOMENT / 10.0, spread, np.ones(4), np.ones(4, dtype=bool), 2.0)
    assert (load.refused is not None) == refused
    assert np.isnan(load.mass_kg) == refused


def test_loads_that_are_not_estimated():
    nothing = load_result(unknown_load("b"), None)
    assert np.isnan(nothing.mass_kg)
    assert (nothing.com_m, nothing.correlation, nothing.unidentifiable) == (None, None, (*LOAD_PARTS, INERTIA_WHOLE))
    refused = load_result(refused_load("c", "two masses", {"1": 3.0}), None)
    assert (refused.refused, refused.per_pose_mass_kg, refused.correlation) == ("two masses", {"1": 3.0}, None)


def test_a_point_in_the_flange_is_seen_from_its_origin_and_axes():
    flange = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
    point = np.array([0.4, -0.2, 0.5])
    there = in_flange(point, flange)
    assert flange @ np.append(there, 1.0) == pytest.approx(np.append(point, 1.0))
