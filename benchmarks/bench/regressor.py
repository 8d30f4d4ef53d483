"""Rows per second of the regressor, as ratios to a pinocchio loop and to a plain fill of the same array.

Everything is timed in one process, the candidates in turn, in processor time, which excludes other work on the
machine. Each ratio is the median over the rounds, with the quartiles as interval.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio

from benchmarks.figure import figure
from gateway.model.regressor import gravity_regressor, regressor
from gateway.model.robot import robot_from_urdf

ROBOT = Path(__file__).parents[2] / "examples" / "large" / "robot.urdf"
ROWS = 20_000
ROUNDS = 11
# pinocchio keeps [m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]
_ORDER = np.concatenate([10 * link + np.array([0, 1, 2, 3, 4, 5, 7, 6, 8, 9]) for link in range(6)])
_REST = np.concatenate([10 * link + np.arange(4) for link in range(6)])


def figures() -> dict[str, dict]:
    """Every figure of the regressor with its goal."""
    text = ROBOT.read_text(encoding="utf-8")
    robot = robot_from_urdf(text, str(ROBOT))
    model = pinocchio.buildModelFromXML(text)
    model.gravity.linear = np.array([0.0, 0.0, -9.80665])
    data = model.createData()
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-2, 2, (ROWS, 6)), rng.normal(size=(ROWS, 6)), rng.normal(size=(ROWS, 6))
    peer, full, rest = np.empty((ROWS, 6, 60)), np.empty((ROWS, 6, 60)), np.empty((ROWS, 6, 24))

    def loop() -> None:
        for row in range(ROWS):
            peer[row] = pinocchio.computeJointTorqueRegressor(model, data, q[row], qd[row], qdd[row])

    seconds = _timed(
        {
            "pinocchio": loop,
            "full": lambda: regressor(robot, q, qd, qdd, out=full),
            "rest": lambda: gravity_regressor(robot, q, out=rest),
            "fill full": lambda: full.fill(1.0),
            "fill rest": lambda: rest.fill(1.0),
        }
    )
    regressor(robot, q, qd, qdd, out=full)
    gravity_regressor(robot, q, out=rest)
    loop()
    error = np.abs(full - peer[:, :, _ORDER]).max() / np.abs(peer).max()
    still = np.zeros_like(q)
    for row in range(ROWS):
        peer[row] = pinocchio.computeJointTorqueRegressor(model, data, q[row], still[row], still[row])
    rest_error = np.abs(rest - peer[:, :, _ORDER][:, :, _REST]).max() / np.abs(rest).max()
    return {
        "regressor 6 x 60, rows per second over pinocchio": _ratio(seconds["pinocchio"], seconds["full"], 1.5),
        "regressor 6 x 24, rows per second over pinocchio": _ratio(seconds["pinocchio"], seconds["rest"], 4.0),
        "regressor 6 x 60, time over a plain fill": _limit(seconds["full"], seconds["fill full"]),
        "regressor 6 x 24, time over a plain fill": _limit(seconds["rest"], seconds["fill rest"]),
        "regressor 6 x 60, rows per second": _rate(seconds["full"]),
        "regressor 6 x 24, rows per second": _rate(seconds["rest"]),
        "regressor, difference to pinocchio": figure(float(max(error, rest_error)), "<= 1e-9", "relative"),
        **_memory(robot, q, qd, qdd),
    }


def _timed(work: dict[str, Callable[[], object]]) -> dict[str, np.ndarray]:
    """Processor time [s] of each piece of work, one value per round."""
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for round_ in range(ROUNDS + 1):
        for name, do in work.items():
            start = time.process_time()
            do()
            if round_:
                seconds[name].append(time.process_time() - start)
    return {name: np.array(values) for name, values in seconds.items()}


def _ratio(peer: np.ndarray, own: np.ndarray, goal: float) -> dict:
    ratio = peer / own
    return figure(float(np.median(ratio)), f">= {goal}", "x", np.quantile(ratio, [0.25, 0.75]).tolist())


def _limit(own: np.ndarray, fill: np.ndarray) -> dict:
    return figure(float(np.median(own / np.maximum(fill, 1e-9))), unit="x")


def _rate(own: np.ndarray) -> dict:
    return figure(float(ROWS / np.median(own)), unit="1/s")


def _memory(robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> dict[str, dict]:
    """Peak memory beyond the stored result, for all rows and for a fifth of them."""
    peaks = []
    for count in (ROWS // 5, ROWS):
        out = np.empty((count, 6, 60))
        tracemalloc.start()
        regressor(robot, q[:count], qd[:count], qdd[:count], out=out)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    return {
        "regressor, memory beyond the result": figure(peaks[1] / (ROWS * 6 * 60 * 8), "<= 1", "of result"),
        "regressor, growth of that memory with five times the rows": figure(peaks[1] / peaks[0], "<= 5", "x"),
    }
