"""What an identification costs: 60 s of motion at 250 Hz, six axes, beside the same least squares by pinocchio."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from benchmarks.figure import Figures, figure
from benchmarks.moving.cells import draw_cell
from gateway.data.rows import Table
from gateway.estimate import estimate
from gateway.model.robot import robot_from_urdf

Floats = NDArray[np.float64]

#: Three periods of 10 s bare and three loaded.
PERIODS, RATE_HZ = 3, 250.0
SEED, ROUNDS = 5, 3
SMOOTH_RAD_S = 0.02


def timing_figures() -> Figures:
    """Processor time of an identification, and its ratio to plain least squares through pinocchio's regressors."""
    cell = draw_cell(SEED, "stated", periods=PERIODS, rate_hz=RATE_HZ)
    table, robot = cell.table(), robot_from_urdf(cell.stated.urdf, "timed")
    own = [_seconds(lambda: estimate(table, robot, cell.knowledge)) for _ in range(ROUNDS)]
    plain = [
        _seconds(lambda: plain_least_squares(cell.stated.urdf, cell.stated.link_std, table)) for _ in range(ROUNDS)
    ]
    ratio = float(np.median(own) / np.median(plain))
    rows = f"s of {ROUNDS}, {len(table)} rows"
    return {
        "identification of 60 s at 250 Hz, processor time": figure(
            float(np.median(own)), "<= 3", rows, (min(own), max(own))
        ),
        "the same least squares through pinocchio, processor time": figure(
            float(np.median(plain)), "printed", rows, (min(plain), max(plain))
        ),
        "identification over the same least squares through pinocchio": figure(
            ratio, "<= 0.7", interval=(min(own) / max(plain), max(own) / min(plain))
        ),
    }


def plain_least_squares(urdf: str, link_std: float, table: Table) -> tuple[Floats, Floats]:
    """What anyone would write: a row of pinocchio's at a time, links, load, friction and rotors, axes weighted once.

    The links keep the CAD's values with the standard deviation that is stated; no gains, no delays, no covariance of
    noise that is autocorrelated.

    Returns
    -------
    parameters : links (10 N), load (10), then Coulomb and viscous friction and rotor inertia of every axis (3 N)
    covariance : of the parameters
    """
    model = pinocchio.buildModelFromXML(urdf)
    data = model.createData()
    states = zip(table.q_rad, table.qd_rad_s, table.qdd_rad_s2, strict=True)
    links = np.array([pinocchio.computeJointTorqueRegressor(model, data, *state).copy() for state in states])
    n, axes, count = links.shape
    loaded = (np.asarray(table.load) != "none")[:, None, None]
    own = np.stack([np.tanh(table.qd_rad_s / SMOOTH_RAD_S), table.qd_rad_s, table.qdd_rad_s2], axis=2)
    friction = (own[:, :, None] * np.eye(axes)[:, :, None]).reshape(n, axes, -1)
    design = np.concatenate([links, loaded * links[:, :, -10:], friction], axis=2)
    cad = np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])
    size = np.maximum(np.abs(cad).reshape(-1, 10).max(axis=1), 1e-6).repeat(10) * link_std
    held = np.hstack([np.diag(1.0 / size), np.zeros((count, design.shape[2] - count))])
    sigma, found, stacked = np.ones(axes), np.zeros(0), held
    for _ in range(2):
        weighted = (design / sigma[:, None]).reshape(-1, design.shape[2])
        target = (table.tau_nm / sigma).ravel()
        stacked = np.vstack([weighted, held])
        found = np.linalg.lstsq(stacked, np.concatenate([target, cad / size]), rcond=None)[0]
        sigma = np.sqrt(((table.tau_nm - design @ found) ** 2).mean(axis=0))
    return found, np.linalg.pinv(stacked.T @ stacked)


def _seconds(work: Callable[[], object]) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun
