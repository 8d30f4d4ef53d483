"""Bench of the numpy tier: the gateway's controllers against the kinetostatic pair, many runs side by side."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.model.robot import Robot, robot_from_dh, with_flange
from gateway.pair.calibration import PairCalibration, PathWrenches
from gateway.pair.controller import PairController
from gateway.pair.embodiments import Embodiment
from gateway.pair.inverse import ForwardChain, chain_of, path_joint_angles, solve
from gateway.pair.learning_update import at_points
from gateway.pair.path import PairPath, PathProgram, master_commands
from gateway.pair.relation import relation, slave_command
from gateway.pair.transform import apply_correction, inverse
from gateway.pair.transform_function import TransformFunction, constant_function, function_of_knots
from gateway.result.pair import CycleSummary
from sim.pair import geometry
from sim.pair.errors import PairErrors, warmed
from sim.pair.kinetostatic import (
    KinetostaticPair,
    PathConstants,
    chain_stiffness,
    path_constants,
    torque_noise,
)
from tests.support.pair.adjust import Adjustment, AdjustmentRule

Array = NDArray[np.float64]
SYNC_S = 0.004
LIMIT_N = 40.0
LOOP_TIME_S = 0.035
#: What the controller is told of the chain: [N/m], [Nm/rad], the stiffest direction of the nominal cell.
STIFFNESS = np.diag(np.repeat([1.6e5, 3.6e3], 3))
PART_T_E = geometry.grasps()
BASES = geometry.bases()
FIXED = inverse(PART_T_E[0]) @ PART_T_E[1]


class Table(NamedTuple):
    """The arm's data sheet as the gateway reads it."""

    convention: str = "standard"
    alpha_rad: tuple[float, ...] = tuple(np.deg2rad([90.0, 0.0, -90.0, 90.0, -90.0, 0.0]))
    a_m: tuple[float, ...] = (0.15, 0.60, 0.10, 0.0, 0.0, 0.0)
    d_m: tuple[float, ...] = (0.45, 0.0, 0.0, 0.64, 0.0, 0.10)
    theta_offset_rad: tuple[float, ...] = (0.0,) * 6


def robot() -> Robot:
    """Nominal arm with its gripper's fingertip as flange."""
    return with_flange(robot_from_dh(Table()), (0.0, 0.0, 0.15))


@functools.cache
def program() -> PathProgram:
    """The reference path as master commands."""
    return PathProgram(master_commands(geometry.part_poses(SYNC_S), BASES[0], PART_T_E[0]), SYNC_S)


def calibration() -> PairCalibration:
    """The cell as the controller knows it."""
    return PairCalibration(
        BASES[0],
        BASES[1],
        inverse(PART_T_E[0]),
        part_mass_kg=geometry.PART_MASS_KG,
        chain_stiffness=STIFFNESS,
        loop_time_s=LOOP_TIME_S,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The path at one speed setting, with everything that all runs on it share."""

    path: PairPath
    chain: ForwardChain
    constants: PathConstants

    def stiffness(self, errors: PairErrors) -> Array:
        """Chain stiffness (M, 6, 6) of one pair of arms along the path."""
        return _stiffness(self.constants, errors)

    def yielding(self, errors: PairErrors) -> Array:
        """Compliance (M, 3, 3) [m/N] of the master's gears at its fingertip."""
        linear = self.constants.jacobian[:, 0, :3]
        return (linear / errors.master.gear_stiffness_nm_rad) @ np.swapaxes(linear, 1, 2)


@functools.lru_cache(maxsize=256)
def _stiffness(constants: PathConstants, errors: PairErrors) -> Array:
    return chain_stiffness(constants, errors)


@functools.cache
def track(speed: float, sync_s: float = SYNC_S) -> Track:
    """The reference path at a speed setting."""
    path = program().at_speed(speed, sync_s)
    chain = chain_of(robot())
    slave = slave_command(BASES[0], path.commands, BASES[1], FIXED)
    joints = [
        path_joint_angles(chain, commands, seed)[0]
        for commands, seed in zip((path.commands, slave), geometry.START_RAD, strict=True)
    ]
    return Track(path, chain, path_constants(np.stack(joints, axis=1), path.dt_s))


@dataclass(slots=True)
class Run:
    """One row of the comparison for one seed.

    Attributes
    ----------
    name, errors, controller : the row, the simulator's secret, what is under test
    cycles : how many it runs
    freeze_after : cycles after which learning is switched off
    snag_cycle : cycle in which a cable pulls arm 2 with 20 N, 0 = none
    jitter_s : the skew of the slave's SYNC is drawn anew each cycle of the bus between 0 and this, None = as drawn
    warming_s : time of work that passes with each cycle: both upper arms grow
    knots_m : where the first function has its knots
    """

    name: str
    errors: PairErrors
    controller: PairController
    cycles: int = 1
    freeze_after: int = 10**6
    snag_cycle: int = 0
    jitter_s: float | None = None
    warming_s: float = 0.0
    grasp: Array | None = None
    results: list[CycleResult] = field(default_factory=list)
    knots_m: Array = field(init=False)

    def __post_init__(self) -> None:
        self.knots_m = self.controller.function.s_m


@dataclass(frozen=True, slots=True, eq=False)
class CycleResult:
    """Truth of one cycle: internal wrench (M, 6), world axes, and what the controller says of it.

    `part_off_m` is how far the part is moved off the path of the unloaded master: by the master's own corrections, and
    by what the force winds up its gears.
    """

    internal: Array
    summary: CycleSummary
    part_off_m: float

    @property
    def force_n(self) -> float:
        """Largest internal force."""
        return float(np.linalg.norm(self.internal[:, :3], axis=1).max())


def run_all(on: Track, runs: Sequence[Run]) -> None:
    """Run all cycles of all runs side by side; results are added to the runs."""
    for cycle in range(1, max(run.cycles for run in runs) + 1):
        active = [run for run in runs if cycle <= run.cycles]
        for run in active:
            if cycle > run.freeze_after:
                run.controller.freeze()
        _cycle(on, active, cycle)


def _cycle(on: Track, runs: list[Run], cycle: int) -> None:
    count, path = len(on.path), on.path
    present = [warmed(run.errors, run.warming_s * (cycle - 1)) for run in runs]
    plant = KinetostaticPair(on.constants, present, [on.stiffness(run.errors) for run in runs])
    for row, run in enumerate(runs):
        run.controller.start_cycle()
        plant.snag_n[row, 0] = 20.0 if cycle == run.snag_cycle else 0.0
    noise = {run.errors.seed: torque_noise(run.errors.seed, cycle, count + 1) for run in runs}
    noises = np.stack([noise[run.errors.seed] for run in runs], axis=1)
    start = [
        (path.commands[0], slave_command(BASES[0], path.commands[0], BASES[1], run.controller.function.at(0.0)))
        for run in runs
    ]
    q = joints_of(on, start, np.broadcast_to(on.constants.q_rad[0], (len(runs), 2, 6)))
    plant.place(q)
    plant.grip()
    for row, run in enumerate(runs):
        if run.grasp is None:
            run.grasp = plant.grasp[row].copy()
        plant.grasp[row] = run.grasp
    reading = plant.step(0, q, noises[count])
    measured = [run.controller.needs_measured for run in runs]
    internal = np.empty((count, len(runs), 6))
    off = np.zeros(len(runs))
    skew = _skew(runs, count, cycle)
    for m in range(count):
        plant.delay(skew[m])
        poses = on.chain.poses(reading.encoder_rad.reshape(-1, 6))[0].reshape(-1, 2, 4, 4) if any(measured) else None
        commands = []
        for row, run in enumerate(runs):
            seen = None if poses is None or not measured[row] else (poses[row, 0], poses[row, 1])
            commands.append(run.controller.step(m, reading.wrench[row, 0], reading.wrench[row, 1], seen))
        ahead = on.constants.q_rad[m] - on.constants.q_rad[max(m - 1, 0)]
        q = joints_of(on, commands, q + ahead)
        reading = plant.step(m, q, noises[m])
        internal[m] = reading.internal
        off = np.maximum(off, [np.linalg.norm(pair[0][:3, 3] - path.commands[m, :3, 3]) for pair in commands])
    for row, run in enumerate(runs):
        summary = run.controller.end_cycle(complete=True)
        wound = float(np.linalg.norm(on.yielding(run.errors) @ internal[:, row, :3, None], axis=1).max())
        run.results.append(CycleResult(internal[:, row].copy(), summary, float(off[row]) + wound))


def _skew(runs: list[Run], count: int, cycle: int) -> Array:
    """Skew (count, n) [s] of the slave's bus."""
    skew = np.tile([run.errors.skew_s for run in runs], (count, 1))
    for row, run in enumerate(runs):
        if run.jitter_s is not None:
            skew[:, row] = np.random.default_rng([run.errors.seed, cycle, 0x5C]).uniform(0.0, run.jitter_s, count)
    return skew


def joints_of(on: Track, commands: Sequence[tuple[Array, Array]], seeds: Array) -> Array:
    """Joint positions (n, 2, 6) [rad] for commands of both grippers, each near its seed (n, 2, 6)."""
    return solve(on.chain, np.array(commands).reshape(-1, 4, 4), seeds.reshape(-1, 6)).reshape(-1, 2, 6)


def teach(on: Track, errors: Sequence[PairErrors], points: NDArray[np.int64]) -> list[TransformFunction]:
    """First function of each pair of arms: at every point the slave is adjusted until the force has gone.

    Parameters
    ----------
    on : Track
    errors : sequence of PairErrors
    points : array of int
        Indices of the commands that are taught.
    """
    master = np.tile(on.path.commands[points], (len(errors), 1, 1))
    slave = slave_command(BASES[0], master, BASES[1], FIXED)
    index = np.tile(points, len(errors))
    each = [item for item in errors for _ in points]
    plant = _gripped_at_start(on, each)
    wrenches = PathWrenches(calibration(), on.path, slave_command(BASES[0], on.path.commands, BASES[1], FIXED))
    rule = AdjustmentRule()
    adjustments = [Adjustment(rule, SYNC_S, STIFFNESS, LOOP_TIME_S) for _ in each]
    rng = np.random.default_rng([errors[0].seed, 0x7E])
    q = joints_of(on, list(zip(master, slave, strict=True)), on.constants.q_rad[index])
    plant.place(q)
    running = np.ones(len(each), dtype=bool)
    reading = plant.step(index, q, np.zeros((len(each), 2, 6)), 0.0)
    corrections = np.zeros((len(each), 6))
    while running.any():
        for row in np.flatnonzero(running):
            m = int(index[row])
            deviation = wrenches.internal(m, reading.wrench[row, 0], reading.wrench[row, 1])
            assert deviation is not None
            verdict = adjustments[row].step(wrenches.at_tip(1, m, deviation))
            assert verdict in ("running", "done"), verdict
            running[row] = verdict == "running"
            corrections[row] = adjustments[row].correction
        q = joints_of(on, list(zip(master, apply_correction(slave, corrections), strict=True)), q)
        noise = torque_noise(int(rng.integers(1 << 30)), 0, len(each))
        reading = plant.step(index, q, noise, 0.0)
    taught = relation(BASES[0], master, BASES[1], apply_correction(slave, corrections))
    ways = on.path.s_m[points]
    return [function_of_knots(ways, rows) for rows in taught.reshape(len(errors), len(points), 4, 4)]


def _gripped_at_start(on: Track, errors: Sequence[PairErrors]) -> KinetostaticPair:
    """Pairs that have closed their grippers free of force at the first command, by the fixed relation."""
    plant = KinetostaticPair(on.constants, errors, [on.stiffness(item) for item in errors])
    plant.place(np.tile(on.constants.q_rad[0], (len(errors), 1, 1)))
    plant.grip()
    return plant


def exact(on: Track, errors: PairErrors, rounds: int = 4) -> TransformFunction:
    """The relation that leaves no mismatch at rest at any command: the simulator's truth."""
    count = len(on.path)
    start = _gripped_at_start(on, [errors])
    plant = KinetostaticPair(on.constants, [errors] * count, list(on.stiffness(errors)[:, None]))
    plant.grasp = np.tile(start.grasp, (count, 1, 1))
    master = on.path.commands
    slave = slave_command(BASES[0], master, BASES[1], FIXED)
    q = on.constants.q_rad
    turn = BASES[1][:3, :3]
    for _ in range(rounds):
        q = joints_of(on, list(zip(master, slave, strict=True)), q)
        plant.place(q)
        mismatch = plant.mismatch()
        slave = apply_correction(slave, -np.concatenate([mismatch[:, :3] @ turn, mismatch[:, 3:] @ turn], axis=1))
    return at_points(relation(BASES[0], master, BASES[1], slave), on.path.s_m, np.arange(count))


def fixed_function() -> TransformFunction:
    """The relation at the start posture, by the data sheets."""
    return constant_function(FIXED)


def controller(on: Track, row: Embodiment, first: TransformFunction) -> PairController:
    """Controller of a row."""
    return PairController(row, on.path, calibration(), first)
