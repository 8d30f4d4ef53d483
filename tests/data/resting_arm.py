"""Rest visits of a simulated arm with effects built in, and what a diagnosis has found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.blind.drawn_arm import draw_arm
from gateway.data.table import Table, concatenate
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.rest_mistakes import Mistake
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.linear import RestProblem
from gateway.identify.solve import Basis, ByGroup
from gateway.model.robot import Robot, robot_from_urdf
from gateway.result.result import Result
from sim.draw import DrawnArm, choose_poses
from sim.effects import apply_effects
from sim.offline import PlannedVisit, Protocol, measure, point_jacobian
from tests.data.arms import carrying, peer_of, torque_of
from tests.support.rigs.tables import make_table, simulated_table

STEP_S = 25.0
#: Cell and URDF of the small arm; ten of its poses [rad], and the friction of its axes [Nm].
SMALL = Path(__file__).parents[2] / "examples" / "small"
LIMIT = np.array([2.5, 1.4, 1.6, 2.5, 1.6, 2.5])
POSES = np.random.default_rng(4).uniform(-LIMIT, LIMIT, (10, 6))
BAND_NM = np.array([10.0, 8.0, 5.0, 1.0, 1.0, 0.5])


def two_sided(
    load: str,
    body: tuple[float, float, float, float] | None,
    q: np.ndarray = POSES,
    start_s: float = 0.0,
    seed: int = 1,
    first: int = 1,
    gain: ArrayLike = 0.0,
    error: Callable[[np.ndarray], np.ndarray] = np.zeros_like,
) -> Table:
    """Rest rows of the small arm (torque by pinocchio) with a body (mass [kg], x, y, z [m]), from both sides.

    `gain`: torque by the constants of the cell over the true torque, less 1; `error`: torque [Nm] beside gravity.
    """
    rng, count = np.random.default_rng([seed, first, len(load)]), len(q)
    model, _ = peer_of((SMALL / "robot.urdf").read_text(encoding="utf-8"))
    torque = error(q) + torque_of(model if body is None else carrying(model, body[0], body[1:]), q)
    sides = [torque + side * BAND_NM * (1 + 0.02 * rng.standard_normal(torque.shape)) for side in (1, -1)]
    return make_table(
        [load] * (2 * count),
        np.tile(np.arange(first, first + count), 2),
        np.tile(q, (2, 1)),
        np.vstack(sides) * (1 + np.asarray(gain)),
        time=start_s + 20.0 * np.tile(np.arange(count), 2) + np.repeat([0.0, 8.0], count),
        direction=np.repeat([[1] * 6, [-1] * 6], count, axis=0),
    )


def basis_of(orthogonal: np.ndarray) -> Basis:
    """An orthonormal basis (n, p) as a fit has it."""
    return Basis(ByGroup.of(orthogonal), np.ones(len(orthogonal)), np.eye(orthogonal.shape[1]))


class Bench:
    """An arm with effects built in, and the poses it is measured at."""

    def __init__(self, seed: int, effects: list[dict], poses: int = 10) -> None:
        rng = np.random.default_rng([seed, 99])
        self.arm: DrawnArm = draw_arm(rng)
        self.plant = apply_effects(self.arm.plant, effects, point_jacobian(self.arm.chain))
        self.poses = choose_poses(self.arm.chain, self.arm.floor_nm, self.arm.prior_std, poses, rng)
        self.robot: Robot = robot_from_urdf(self.arm.urdf, "drawn")
        self.seed, self.now_s, self.next_pose = seed, 0.0, 100
        self.options = Knowledge(efficiency=self.arm.efficiency, gear_ratio=self.arm.gear_ratio)

    def table(
        self, poses: np.ndarray, load: str, first: int = 0, protocol: Protocol | None = None, run: str = "bench"
    ) -> Table:
        visits = []
        for k, q in enumerate(poses):
            visits.append(PlannedVisit(first + k, load, self.now_s, q))
            self.now_s += STEP_S
        self.now_s += 60.0
        rng = np.random.default_rng([self.seed, int(self.now_s)])
        columns = measure(self.arm.chain, self.plant, visits, self.arm.loads, protocol or self.arm.protocol, rng)
        return simulated_table(columns, run)

    def both(self) -> Table:
        return concatenate([self.table(self.poses, "none"), self.table(self.poses, "tool")])

    def more(self, poses: np.ndarray) -> Table:
        self.next_pose += len(poses)
        return self.table(poses, "tool", self.next_pose)


def undirected(table: Table) -> Table:
    """The table without approach directions."""
    return replace(table, direction=np.zeros_like(table.direction))


def single_joint_sweep(bench: Bench, axis: int) -> Table:
    """Visits along which one axis alone moves."""
    bench.poses = np.tile(bench.poses[0], (12, 1))
    bench.poses[:, axis] = np.linspace(-0.8, 0.8, 12)
    return bench.both()


def problems(bench: Bench, table: Table) -> Callable[[tuple[Mistake, ...]], RestProblem]:
    """How a diagnosis makes a problem of this table, also with mistakes in it undone; outlier visits are rejected."""
    diagnosis = RestDiagnosis(bench.robot, bench.options)
    return partial(diagnosis.problem, table, diagnosis.read(table).rejected)


def problem_of(bench: Bench, table: Table) -> RestProblem:
    """The rows of a table as a diagnosis fits them."""
    return problems(bench, table)(())


def effect(name: str, joints: list[int], **parameters: object) -> dict:
    return {"name": name, "joints": joints, "parameters": parameters}


def found(result: Result) -> list[tuple[str, tuple[int, ...]]]:
    return [(entry.name, entry.joints) for entry in result.effects]
