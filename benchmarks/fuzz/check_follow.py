"""Promises of what `follow` reads: a path, and the result that names the load."""

from __future__ import annotations

import csv
import json
from functools import cache

import numpy as np
from hypothesis import strategies as st

from benchmarks.fuzz.check_files import EXAMPLES, RESULT_SEED, in_file
from benchmarks.fuzz.guard import bounded
from benchmarks.fuzz.mutate import damaged
from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig, LoadedCell, load_cell
from gateway.errors import ConfigError, DataUnusable, InputError, PlanRefused
from gateway.feedforward.load import check_origin, identified_load
from gateway.follow.path import LONGEST_S, check_path, read_path
from gateway.follow.settings import feed_model, three_settings
from gateway.model.arm_model import arm_robot
from gateway.model.robot import Robot
from gateway.motion.opening import axis_setups
from gateway.motion.workspace import Workspace, workspace_of
from gateway.pipeline.inputs import read_bare
from gateway.result.result import from_json

#: Coarse, so that the longest path that is taken stays small.
PERIOD_S = 0.5


@cache
def _arm() -> tuple[LoadedCell, ArmConfig, Robot, list[DriveProfile]]:
    """The large example's arm."""
    loaded = load_cell(EXAMPLES / "large" / "cell.toml")
    arm = loaded.cell.arm[0]
    return loaded, arm, arm_robot(loaded, arm), [setup.profile for setup in axis_setups(loaded, arm)]


@cache
def _workspace() -> Workspace:
    _, arm, robot, _ = _arm()
    return workspace_of(arm, robot)


_TOML_SEEDS = [
    (EXAMPLES / "large" / "path.toml").read_bytes(),
    b"waypoints_rad = [[0,0,0,0,0,0], [0.1,0.1,0,0,0,0]]\nrepeat = 2\nspeed_share = 0.5\ndwell_s = 0\n",
]
_CSV_SEEDS = [
    (EXAMPLES / "small" / "path.csv").read_bytes(),
    b"q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n0,0,0,0,0,0\n0.1,0,0,0,0,0\n0.1,0.2,0,0,0.3,0\n",
]


def toml_paths() -> st.SearchStrategy[bytes]:
    return damaged(_TOML_SEEDS)


def csv_paths() -> st.SearchStrategy[bytes]:
    return damaged(_CSV_SEEDS)


def check_toml_path(data: bytes) -> None:
    """Setpoints inside the limits of the arm's axes, or a typed error."""
    _check_path(data, "path.toml")


def check_csv_path(data: bytes) -> None:
    """As `check_toml_path`; what was read ends at the last row of the file."""
    end = _check_path(data, "path.csv")
    if end is not None:
        rows = [row for row in csv.reader(data.decode().splitlines()) if row and not row[0].lstrip().startswith("#")]
        names = [name.strip() for name in rows[0]]
        last = [float(rows[-1][names.index(f"q{joint}_rad")]) for joint in range(1, 7)]
        assert np.allclose(end, last, atol=1e-9)


def _check_path(data: bytes, name: str) -> np.ndarray | None:
    file, workspace = in_file(data, name), _workspace()
    path = bounded(lambda: read_path(file, workspace, PERIOD_S), (InputError, PlanRefused), len(data))
    if path is None:
        return None
    assert path.duration_s <= LONGEST_S + PERIOD_S
    for motion in path.motions:
        assert np.isfinite([motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2]).all()
        assert (np.abs(motion.qd_rad_s) <= workspace.speed_rad_s * 1.001).all()
        assert (motion.qd_rad_s[-1] == 0).all()
    held = sum(part.nbytes for m in path.motions for part in (m.q_rad, m.qd_rad_s, m.qdd_rad_s2))
    bounded(lambda: check_path(path, workspace), (PlanRefused,), len(data) + held)
    return path.end_rad


def loads() -> st.SearchStrategy[bytes]:
    return damaged([_load_seed(), _load_seed(), _load_seed(bare=True)])


def _load_seed(bare: bool = False) -> bytes:
    """A result of the large arm, with a bare identification of every link parameter on request."""
    body = json.loads(RESULT_SEED) | {"robot": "qh165", "data": {"cell": "large", "arm": "main"}}
    if bare:
        one = np.eye(24)
        body["bare"] = {
            "robot": "qh165",
            "gravity_m_s2": [0.0, 0.0, -9.80665],
            "columns": list(range(24)),
            "names": [f"p{number}" for number in range(24)],
            "value": _drawn_moments(),
            "covariance": (1e-4 * one).tolist(),
            "combination": one.tolist(),
        }
    return json.dumps(body).encode()


def _drawn_moments() -> list[float]:
    """Mass and first moment [kg, kg m] of the six links as drawn."""
    robot = _arm()[2]
    return np.column_stack([robot.mass_kg, robot.mass_kg[:, None] * robot.com_m]).ravel().tolist()


def check_load(data: bytes) -> None:
    """A load that can be fed, on this robot, or a typed error."""
    file = in_file(data, "load.json")
    loaded, arm, robot, profiles = _arm()

    def read() -> None:
        result = from_json(file.read_text(encoding="utf-8", errors="replace"), "load.json")
        check_origin(result, loaded, arm, robot, "load.json")
        load = identified_load(result, None, "load.json")
        assert load.mass_kg > 0
        assert np.isfinite(load.parameters).all()
        three_settings(arm, feed_model(arm, robot, profiles, result), load)

    bounded(read, (InputError, ConfigError, DataUnusable), len(data))
    bounded(lambda: read_bare(file), (InputError,), len(data))
