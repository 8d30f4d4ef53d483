"""How good the joint solution is: against the Cramer-Rao bound, its own intervals, and cells of 70 kg.

Gaussian: tables of drawn arms with noise of stated covariance; the bound is computed from pinocchio's regressor.
Stiction: tables from the simulator's friction set. Cells: the large example, its own planner's ten poses, links that
are off by what the cell file trusts them to. The seeds are fixed; nothing was chosen among them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import NDArray

from benchmarks.blind.drawn_arm import draw_arm
from benchmarks.figure import figure
from gateway.acquire.poses import choose_poses
from gateway.cell.config import load_cell
from gateway.data.rows import Table
from gateway.estimate import ESTIMATORS
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import LoadEstimate
from gateway.model.arm_model import arm_robot
from gateway.model.robot import Robot, robot_from_urdf
from gateway.motion.assumed import assumed_noise_nm
from gateway.motion.workspace import workspace_of
from sim.cellfile import read_cell
from sim.draw import choose_poses as informative_poses
from sim.nominal import plant_of
from sim.offline import PlannedVisit, Protocol, measure
from sim.plant import Payload

Floats = NDArray[np.float64]

CELL = Path(__file__).parents[2] / "examples" / "large" / "cell.toml"
GAUSSIAN_ARMS, GAUSSIAN_EACH = 20, 250
STICTION_TABLES = 500
CELLS, PLANS = 200, 10
POSES = 10
STREAM = 4242
_joint = ESTIMATORS["joint"]
#: These arms are drawn with the torque constants that are stated.
EXACT = (0.0,) * 6
_NAMES = ("mass", "com x", "com y", "com z")
_MOMENTS = np.concatenate([10 * link + np.arange(4) for link in range(6)])


def figures() -> dict[str, dict]:
    """Every figure of the estimation with its goal."""
    return {**_gaussian(), **_stiction(), **_cells()}


def table_of(columns: dict[str, Any]) -> Table:
    """Rest table from named columns."""
    n = len(columns["pose"])
    blank = np.full((n, 6), np.nan)
    return Table(
        file=("bench",) * n,
        line=np.arange(n),
        run=np.full(n, "bench"),
        load=np.asarray(columns["load"]),
        pose=np.asarray(columns["pose"]),
        time_s=np.asarray(columns.get("time_s", np.full(n, np.nan)), dtype=float),
        q_rad=np.asarray(columns["q_rad"]),
        qd_rad_s=np.zeros((n, 6)),
        qdd_rad_s2=np.zeros((n, 6)),
        moving=np.zeros(n, dtype=bool),
        direction=np.asarray(columns["dir"]).astype(np.int8),
        tau_nm=np.asarray(columns["tau_nm"]),
        tau_std_nm=np.asarray(columns["tau_std_nm"]),
        count=np.asarray(columns["n"]),
        q2nd_rad=blank,
        temperature_c=blank,
        motor_torque_nm=blank,
    )


def _four(load: LoadEstimate) -> tuple[Floats, Floats]:
    return (
        np.concatenate([[load.mass_kg], load.com_m]),
        np.concatenate([[load.mass_std_kg], load.com_std_m]),
    )


# ---------------------------------------------------------------- Gaussian noise of stated covariance


def _gaussian() -> dict[str, dict]:
    squares, inside = [], []
    for seed in range(GAUSSIAN_ARMS):
        case = _GaussianCase(seed)
        for _ in range(GAUSSIAN_EACH):
            value, std = _four(_joint(case.table(), case.robot, Knowledge(link_std=np.inf, gain_std=EXACT)).loads[0])
            error = value - case.truth
            squares.append((error / case.bound) ** 2)
            inside.append(np.abs(error) < 1.959964 * std)
    out = {}
    for k, name in enumerate(_NAMES):
        out[f"Gaussian tables, variance of {name} over the Cramer-Rao bound"] = _mean(
            np.array(squares)[:, k], "<= 1.05"
        )
    for k, name in enumerate(_NAMES):
        out[f"Gaussian tables, 95 % intervals of {name} that hold the truth"] = _share(
            np.array(inside)[:, k], "94 .. 96"
        )
    return out


class _GaussianCase:
    """A drawn arm at ten poses, bare and loaded, both sides, with noise that the table states."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, STREAM])
        arm = draw_arm(self.rng)
        self.robot: Robot = robot_from_urdf(arm.urdf, "drawn.urdf")
        poses = informative_poses(arm.chain, arm.floor_nm, arm.prior_std, POSES, self.rng)
        tool = arm.loads["tool"]
        self.truth = np.concatenate([[tool.mass_kg], tool.com_m])
        self.std = arm.floor_nm * np.sqrt(2.0)  # of one side
        self.band = arm.plant.coulomb_nm
        model = pinocchio.buildModelFromXML(arm.urdf)
        data, still = model.createData(), np.zeros(6)
        rows = np.array(
            [pinocchio.computeJointTorqueRegressor(model, data, q, still, still)[:, _MOMENTS] for q in poses]
        )
        links = np.array([model.inertias[k + 1].toDynamicParameters()[:4] for k in range(6)]).ravel()
        moment = tool.mass_kg * np.concatenate([[1.0], tool.com_m])
        self.torque = np.concatenate([rows @ links, rows @ links + rows[:, :, 20:] @ moment])
        self.q = np.concatenate([poses, poses])
        self.bound = self._bound(rows)

    def _bound(self, rows: Floats) -> Floats:
        """Cramer-Rao bound (4,) of [m, x, y, z]: links unknown, loads unknown, noise known."""
        white = (rows / (self.std / np.sqrt(2.0))[:, None]).reshape(-1, 24)
        bare, load = np.vstack([white, white]), np.vstack([np.zeros_like(white[:, 20:]), white[:, 20:]])
        left = load - bare @ np.linalg.lstsq(bare, load, rcond=1e-9)[0]
        covariance = np.linalg.inv(left.T @ left)
        mass, com = self.truth[0], self.truth[1:]
        turn = np.vstack([[1.0, 0, 0, 0], np.column_stack([-com, np.eye(3)]) / mass])
        return np.sqrt(np.diag(turn @ covariance @ turn.T))

    def table(self) -> Table:
        sides = []
        for side in (1.0, -1.0):
            noise = self.std * self.rng.standard_normal(self.torque.shape)
            sides.append(self.torque + side * self.band + noise)
        n = len(self.torque)
        return table_of(
            {
                "load": np.tile(np.repeat(["none", "tool"], POSES), 2),
                "pose": np.tile(np.arange(POSES), 4),
                "q_rad": np.tile(self.q, (2, 1)),
                "dir": np.repeat([1.0, -1.0], n)[:, None] * np.ones(6),
                "tau_nm": np.concatenate(sides),
                "tau_std_nm": np.tile(self.std, (2 * n, 1)),
                "n": np.ones(2 * n, dtype=int),
            }
        )


# ---------------------------------------------------------------- friction as a set


def _stiction() -> dict[str, dict]:
    inside = []
    for seed in range(STICTION_TABLES):
        rng = np.random.default_rng([seed, STREAM, 1])
        arm = draw_arm(rng)
        poses = informative_poses(arm.chain, arm.floor_nm, arm.prior_std, POSES, rng)
        columns = measure(arm.chain, arm.plant, _visits(poses), arm.loads, arm.protocol, rng)
        options = Knowledge(link_std=0.05, efficiency=tuple(arm.efficiency.tolist()), gain_std=EXACT)
        found = _joint(table_of(columns), robot_from_urdf(arm.urdf, "drawn.urdf"), options)
        tool = arm.loads["tool"]
        value, std = _four(found.loads[0])
        inside.append(np.abs(value - np.concatenate([[tool.mass_kg], tool.com_m])) < 1.959964 * std)
    hits = np.array(inside)
    return {
        "stiction tables, 95 % intervals of mass that hold the truth": _share(hits[:, 0], "92 .. 98"),
        "stiction tables, 95 % intervals of com that hold the truth": _share(
            hits[:, 1:].ravel(), "92 .. 98", len(hits)
        ),
    }


def _visits(poses: Floats) -> list[PlannedVisit]:
    """Every pose bare, then every pose with the tool."""
    bare = [PlannedVisit(k, "none", 25.0 * k, q) for k, q in enumerate(poses)]
    return bare + [PlannedVisit(k, "tool", 2000.0 + 25.0 * k, q) for k, q in enumerate(poses)]


# ---------------------------------------------------------------- cells of 70 kg


def _cells() -> dict[str, dict]:
    loaded = load_cell(CELL)
    config = loaded.cell.arm[0]
    robot = arm_robot(loaded, config)
    spec = read_cell(CELL).arms[0]
    plant = plant_of(spec)
    workspace = workspace_of(config, robot)
    offset_rad = loaded.cell.poses.approach_offset_rad
    noise = assumed_noise_nm(workspace)
    plans = [
        np.array([pose.q_rad for pose in choose_poses(workspace, POSES, 0, offset_rad, seed, noise)])
        for seed in range(PLANS)
    ]
    efficiency = np.array([axis.gear_efficiency.value for axis in config.axis])
    options = Knowledge(
        link_std=config.link_std,
        gravity_m_s2=config.gravity_m_s2,
        efficiency=tuple(efficiency.tolist()),
        gain_std=EXACT,
    )
    errors, hits = [], []
    for seed in range(CELLS):
        rng = np.random.default_rng([seed, STREAM, 2])
        load = Payload("tool", 70.0, rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.4]), np.eye(3))
        arm = replace(plant, **_links_off(robot, rng))
        columns = measure(spec.chain, arm, _visits(plans[seed % PLANS]), {"tool": load}, Protocol(), rng)
        value, std = _four(_joint(table_of(columns), robot, options).loads[0])
        error = value - np.concatenate([[70.0], load.com_m])
        errors.append([100.0 * abs(error[0]) / 70.0, 1000.0 * np.linalg.norm(error[1:])])
        hits.append(np.abs(error) < 1.959964 * std)
    mass, com = np.array(errors).T
    return {
        "cells of 70 kg, median error of the mass": _median(mass, "%", 1.0),
        "cells of 70 kg, median error of the centre of mass": _median(com, "mm", 5.0),
        "cells of 70 kg, 95 % intervals that hold the truth": _share(np.array(hits).ravel(), "92 .. 98", CELLS),
    }


def _links_off(robot: Robot, rng: np.random.Generator) -> dict[str, Floats]:
    """True links that differ from the URDF's by 5 % of mass, and of mass x link length."""
    mass = robot.mass_kg * (1.0 + 0.05 * np.clip(rng.standard_normal(6), -2.5, 2.5))
    length = np.append(np.linalg.norm(robot.placement[1:, :3, 3], axis=1), 0.1)
    com = robot.com_m + 0.05 * np.clip(rng.standard_normal((6, 3)), -2.5, 2.5) * length[:, None]
    return {"link_mass_kg": mass, "link_com_m": com}


# ---------------------------------------------------------------- figures


def _mean(values: Floats, goal: str) -> dict:
    value, half = float(values.mean()), 1.96 * float(values.std() / np.sqrt(len(values)))
    return figure(value, goal, "x", (value - half, value + half))


def _share(hits: Floats, goal: str, independent: int | None = None) -> dict:
    """Share in percent; the interval counts `independent` trials (all of them if not given)."""
    count = len(hits) if independent is None else independent
    share = float(np.mean(hits))
    half = 1.96 * float(np.sqrt(max(share * (1 - share), 1e-4) / count))
    return figure(100.0 * share, goal, "%", (100.0 * (share - half), 100.0 * (share + half)))


def _median(values: Floats, unit: str, most: float) -> dict:
    ordered = np.sort(values)
    n = len(ordered)
    reach = int(np.ceil(0.98 * np.sqrt(n)))
    low, high = ordered[max(n // 2 - reach, 0)], ordered[min(n // 2 + reach, n - 1)]
    return figure(float(np.median(ordered)), f"<= {most:g}", unit, (float(low), float(high)))
