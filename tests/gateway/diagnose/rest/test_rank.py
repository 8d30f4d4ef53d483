"""Postures that leave a part of the centre of gravity open: the diagnosis does not state it, as `estimate` does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import loads_of
from gateway.identify.rest.start_noise import first_noise
from gateway.model.visits import pair_visits
from tests.data.moving_arm import URDF
from tests.gateway.estimate.conftest import Arm, make_measured

MASS, COM = 4.0, np.array([0.03, -0.02, 0.06])
BAND = np.array([4.0, 5.0, 3.0, 0.8, 0.6, 0.4])


def postures(kind: str) -> np.ndarray:
    """Three postures that differ in joint 1 alone; or, axis 6 vertical, in joints 1 and 6: gravity turns in neither."""
    out = np.repeat([[0.0, -0.4, 0.9, 0.0, 0.3, 0.7]], 3, axis=0)
    out[:, 0] = (-1.0, 0.2, 1.3)
    if kind == "joints 1 and 6":
        out[:, 4], out[:, 5] = np.pi / 2 - 0.5, (-2.0, 0.4, 1.5)
    return out


@pytest.fixture(scope="module", params=["joint 1", "joints 1 and 6"])
def measured(request: pytest.FixtureRequest):
    """Both sides of twelve bare poses and of the three postures with the load."""
    rng, arm = np.random.default_rng(5), Arm(URDF, BAND)
    bare = make_measured(arm, rng.uniform(-1.2, 1.2, (12, 6)), {"none": None}, rng, left=0.02)
    loaded = make_measured(arm, postures(request.param), {"tool": (MASS, *COM)}, rng, left=0.02)
    return concatenate([bare, replace(loaded, pose=loaded.pose + 100)]), arm.robot


@pytest.mark.parametrize("link_std", [np.inf, 0.05])
def test_what_no_posture_shows_is_not_stated(measured, link_std: float) -> None:
    table, robot = measured
    problem = build_problem(robot, pair_visits(table, None), Knowledge(link_std=link_std))
    load = loads_of(problem, fit(problem, (), first_noise(problem)), robot)[0]
    expected = run(table, robot, Knowledge(link_std=link_std)).loads[0]
    names = ("com_x_m", "com_y_m", "com_z_m")
    open_ = [name in expected.unidentifiable for name in names]
    assert any(open_)
    stated = np.full(3, np.nan) if load.com_m is None else np.array(load.com_m)
    assert np.isnan(stated[open_]).all()
    assert {name for name, is_open in zip(names, open_, strict=True) if is_open} <= set(load.unidentifiable)
    assert load.mass_kg == pytest.approx(MASS, abs=4.0 * load.mass_std_kg)
