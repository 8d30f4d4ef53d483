"""Rest visits of a simulated arm with effects built in, and what a diagnosis has found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gateway.data.table import Table, concatenate
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.rest_mistakes import Mistake
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.linear import RestProblem
from gateway.identify.solve import Basis, ByGroup
from gateway.model.robot import Robot, robot_from_urdf
from gateway.result.result import Result
from sim.draw import DrawnArm, choose_poses, draw_arm
from sim.effects import apply_effects
from sim.offline import PlannedVisit, Protocol, measure, point_jacobian
from tests.support.rigs.tables import simulated_table

STEP_S = 25.0


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
