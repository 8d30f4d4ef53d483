"""Postures that leave a part of the centre of gravity open: the diagnosis does not state it, as `estimate` does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
import pytest

from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.hypothesis_fit import fit
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import loads_of
from gateway.identify.rest.start_noise import first_noise
from gateway.model.robot import robot_from_urdf
from gateway.model.visits import pair_visits
from tests.data.arms import peer_of
from tests.support.rigs.tables import make_table

URDF = (Path(__file__).parents[4] / "examples" / "small" / "robot.urdf").read_text()
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
    rng = np.random.default_rng(5)
    model, data = peer_of(URDF)
    bare, tool = pinocchio.Inertia(model.inertias[6]), pinocchio.Inertia(MASS, COM, np.zeros((3, 3)))
    rows: list[tuple[str, int, float]] = []
    torque, angles = [], []
    poses = {"none": rng.uniform(-1.2, 1.2, (12, 6)), "tool": postures(request.param)}
    for label, q_rad in poses.items():
        model.inertias[6] = bare if label == "none" else bare + tool
        for number, q in enumerate(q_rad):
            gravity = pinocchio.computeGeneralizedGravity(model, data, q).copy()
            for side in (1.0, -1.0):
                rows.append((label, number + 100 * (label == "tool"), side))
                torque.append(gravity + side * BAND * (1.0 - 0.05 * rng.uniform(size=6)))
                angles.append(q)
    load, pose, side = zip(*rows, strict=True)
    table = make_table(
        np.array(load), np.array(pose), np.array(angles), np.array(torque),
        time=10.0 * np.arange(len(rows)), direction=np.array(side), std=0.01, count=100,
    )  # fmt: skip
    return table, robot_from_urdf(URDF, "small")


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
