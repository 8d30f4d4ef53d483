"""Terms without a name that act on the arm or on its load: hose, liquid, knee of a conversion, play of a gear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.model.formula import Hose, Knee, pieces
from gateway.model.kinematics import link_frames
from gateway.model.rest import Model, neutral
from gateway.model.robot import Robot, robot_from_urdf
from gateway.model.unnamed import Play, Slosh
from gateway.model.visits import Visits, pair_visits
from tests.data.resting_arm import Bench

GRAVITY = np.array([0.0, 0.0, -9.80665])


@pytest.fixture(scope="module")
def visits() -> tuple[Robot, Visits]:
    bench = Bench(6, [], poses=5)
    return robot_from_urdf(bench.arm.urdf, "drawn"), pair_visits(bench.both(), (1.0,) * 6)


@pytest.fixture(scope="module")
def model(visits) -> Model:
    return Model(*visits, GRAVITY)


def test_a_hose_exerts_the_torque_of_its_elastic_energy(visits, model):
    robot, rows = visits
    stiffness, anchor, free, link = 300.0, np.array([0.4, -0.7, 1.9]), 1.2, 4
    term = Hose(link, (0.0, 0.0, 1.0), 1.0, 2.0)
    setting = term.apply(neutral(len(rows), rows.axes), np.array([stiffness, *anchor, free]), rows)

    def energy(q_rad: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(link_frames(robot, q_rad)[:, link, :3, 3] - anchor, axis=1)
        return 0.5 * stiffness * np.maximum(length - free, 0.0) ** 2

    step = 1e-6
    expected = [
        (energy(rows.q_rad - step * unit) - energy(rows.q_rad + step * unit)) / (2.0 * step) for unit in np.eye(6)
    ]
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(model.passive(setting).T, expected, atol=1e-4)


def test_a_hose_is_stated_where_the_fit_has_put_it():
    values = np.array([0.4, -0.7, 1.9, 1.2])
    (piece,) = pieces(Hose(5, (0.0, 0.0, 1.0), 1.0, 2.0).shaped(values))
    assert piece.expression == "hose from (0.40, -0.70, 1.90) m to link 6, taut beyond 1.20 m"
    assert piece.unit == "N/m"


@pytest.mark.parametrize("steepness", [0.0, 3.0])
def test_a_liquid_runs_to_the_low_side_of_the_load(visits, model, steepness):
    """The readings are those of the same load with its centre moved visit by visit."""
    robot, rows = visits
    load = np.tile([4.0, 0.2, 0.1, 0.8], (len(rows), 1))
    path = np.array([0.05, -0.02, 0.1])
    none, links, band = neutral(len(rows), rows.axes), np.zeros(24), np.zeros(6)
    found = model.predict(Slosh(steepness).apply(none, path, rows), links, load, band).sum_nm
    down = -link_frames(robot, rows.q_rad)[:, -1, 2, :3]
    moved = load.copy()
    moved[:, 1:] += 4.0 * path * (np.tanh(steepness * down) if steepness else down)
    assert found == pytest.approx(model.predict(none, links, moved, band).sum_nm)
    assert len(pieces(Slosh(steepness))) == 3


def test_play_holds_each_link_on_the_side_of_its_torque(visits, model):
    """The readings are those at angles that are half the play off, against the torque, joint by joint."""
    robot, rows = visits
    none, load, band = neutral(len(rows), rows.axes), np.tile([4.0, 0.2, 0.1, 0.8], (len(rows), 1)), np.zeros(6)
    links = np.tile([20.0, 2.0, 1.0, 4.0], 6)
    play = Play(2).apply(Play(1).apply(none, np.array([0.004]), rows), np.array([0.002]), rows)
    torque = model.predict(none, links, load, band).sum_nm
    shift = -0.5 * np.array([0.0, 0.004, 0.002, 0.0, 0.0, 0.0]) * np.sign(torque)
    expected = Model(robot, replace(rows, q_rad=rows.q_rad + shift), model.gravity).predict(none, links, load, band)
    assert (np.abs(expected.sum_nm - torque).max(axis=0)[1:3] > 0.01).all()
    np.testing.assert_allclose(model.predict(play, links, load, band).sum_nm, expected.sum_nm, atol=1e-9)


def test_a_knee_changes_the_gain_beyond_it(visits, model):
    _, rows = visits
    none, band = neutral(len(rows), rows.axes), np.zeros(6)
    torque = np.linspace(-300.0, 300.0, rows.q_rad.size).reshape(rows.q_rad.shape)
    found = model.readings(Knee(1, 0.2, 300.0).apply(none, np.array([-0.4, 1.0 / 3.0]), rows), torque, band).sum_nm
    (piece,) = pieces(Knee(1, 0.2, 300.0).shaped(np.array([1.0 / 3.0])))
    names = {"u": torque[:, 1], "max": np.maximum, "abs": np.abs, "sign": np.sign}
    beyond = eval(piece.expression, {"__builtins__": {}}, names)
    expected = torque.copy()
    expected[:, 1] -= 0.4 * np.sign(torque[:, 1]) * np.clip(np.abs(torque[:, 1]) - 100.0, 0.0, None)
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(beyond, (torque - expected)[:, 1] / 0.4, atol=1e-9)
