"""Teach the first function point by point: the force is reduced at each (CN104379308 embodiment 1, fig. 5).

Both arms hold the part and move slowly from point to point. At rest dry friction hides the force, so both arms make a
small sweep together: every joint then moves in both directions, and over one period friction cancels. The slave's
command is moved against the force until the force is below its set value; what is stored are the commands.

Along the path a joint may barely move, so the sweep moves and rotates the part such that all joints of both arms move.
The taught points and their file are here too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import InputError
from gateway.pair.impedance import Admittance, Gains
from gateway.pair.inverse import turns_at
from gateway.pair.pair_cell import PairCell
from gateway.pair.pair_motion import PairMotion, PairStopped
from gateway.pair.pair_setpoints import Pair, PreparedTrajectory, smooth
from gateway.pair.path import PairPath
from gateway.pair.transform import (
    Floats,
    apply_correction,
    cross_matrix,
    exp_rotation,
    inverse,
    pose,
    relation,
    slave_command,
)
from gateway.pair.transform_function import TransformFunction, function_of_knots
from gateway.result.pair import POINTS_KIND, SCHEMA, TaughtPathFile, TaughtPoint
from gateway.result.values import check_kind, decoded, json_object, json_text, matrix, numbers, text_of

#: Largest change of a correction in one step [m], [rad].
LARGEST_STEP = (1.5e-3, 8e-3)


@dataclass(frozen=True, slots=True)
class TeachRule:
    """Parameters of teaching a point.

    Attributes
    ----------
    force_n, moment_nm : set value: below both a point is done
    sweep_m, sweep_s : half amplitude of the sweep, a rotation by a lever of 0.2 m, and its period
    share : of the correction that would take the whole force away if the stiffness were the cell's
    rounds : sweeps at one point at most
    largest_m, largest_rad : a larger correction is an error, not an adjustment
    path_speed_m_s : mean speed from point to point along the path
    """

    force_n: float = 5.0
    moment_nm: float = 1.5
    sweep_m: float = 0.002
    sweep_s: float = 1.0
    share: float = 0.9
    rounds: int = 25
    largest_m: float = 20e-3
    largest_rad: float = 50e-3
    path_speed_m_s: float = 0.1


class _Yielding:
    """Correction steps against a force with a known upper bound of the stiffness.

    The compliance is corrected by what each step has done to the force (Broyden 1965, second method). When the force
    has grown, the step was too long: it is taken afresh, half of what it was.

    Parameters
    ----------
    compliance : array of shape (6,) [m/N, rad/Nm]
    """

    def __init__(self, compliance: Floats) -> None:
        self._plain = np.diag(compliance)
        self._scale = np.repeat([1.0, LEVER_M], 3)
        self._matrix = self._plain.copy()
        self._last: tuple[Floats, Floats] | None = None

    def step(self, wrench: Floats) -> Floats:
        """Return the change (6,) [m, rad] of the correction for a wrench (6,) [N, Nm] at the hand."""
        if self._last is not None:
            before, moved = self._last
            fallen = before - wrench
            weight = fallen / self._scale**2
            if np.linalg.norm(wrench / self._scale) > np.linalg.norm(before / self._scale):
                self._plain *= 0.5
                self._matrix = self._plain.copy()
            else:
                self._matrix += np.outer(moved - self._matrix @ fallen, weight) / float(weight @ fallen)
        step = self._matrix @ wrench
        step *= min(1.0, LARGEST_STEP[0] / max(float(np.linalg.norm(step[:3])), 1e-12))
        step *= min(1.0, LARGEST_STEP[1] / max(float(np.linalg.norm(step[3:])), 1e-12))
        self._last = (wrench, step)
        return step


class Teacher:
    """Teaching procedure for the points of a path.

    Parameters
    ----------
    motion : PairMotion
        Of powered arms.
    gains : Gains
        Impedance during motion from point to point.
    rule : TeachRule, optional
    """

    def __init__(self, motion: PairMotion, gains: Gains, rule: TeachRule | None = None) -> None:
        self._motion, self._gains, self._rule = motion, gains, rule or TeachRule()
        self._path = motion.cell.path(1.0)
        self._joints = motion.cell.joints(self._path)
        stiffness = motion.cell.config.force.stiffness
        self._compliance = self._rule.share / np.repeat([stiffness.straight, stiffness.turned], 3)
        self._correction = np.zeros(6)
        self._arc_m = 0.0

    def run(
        self, taught_path: TaughtPath, indices: np.ndarray, save: Callable[[TaughtPath, TaughtPoint], None]
    ) -> None:
        """Teach the missing commands of `indices`, then return to the start; both arms stay powered.

        Parameters
        ----------
        taught_path : TaughtPath
            Extended in place.
        indices : array of int
        save : callable
            Called with the taught path and each new point.

        Raises
        ------
        PairStopped
            A point cannot be adjusted; both arms were stopped, what was taught so far is saved.
        """
        self._motion.start()
        done = {point.command - 1 for point in taught_path.points}
        for index in (int(value) for value in indices):
            if index not in done:
                point = self._teach(taught_path, index)
                taught_path.points.append(point)
                taught_path.update_laws(self._motion.following.each_s)
                self._correction = np.zeros(6)
                save(taught_path, point)
        self._go(taught_path, 0.0)

    # -- one point ---------------------------------------------------------------------------------------------------

    def _teach(self, taught_path: TaughtPath, index: int) -> TaughtPoint:
        rule = self._rule
        self._go(taught_path, float(self._path.s_m[index]))
        sweep = self._motion.prepare(lambda: self._sweep(index))
        function = taught_path.function(self._motion.cell.nominal_relation)
        forces, moments = [], []
        yielding = _Yielding(self._compliance)
        for _ in range(rule.rounds):
            begin = self._commands(sweep, function)(0, None, None)
            self._motion.approach(sweep.targets(0, begin), 0.0)
            self._motion.run(sweep, self._commands(sweep, function))
            wrench = sweep.balance.mean_to_and_fro()
            forces.append(float(np.linalg.norm(wrench[:3])))
            moments.append(float(np.linalg.norm(wrench[3:])))
            if forces[-1] <= rule.force_n and moments[-1] <= rule.moment_nm:
                first, second = self._motion.cell.arms
                command = self._path.commands[index]
                s_m = float(self._path.s_m[index])
                plain = slave_command(first.world_from_base, command, second.world_from_base, function.at(s_m))
                adjusted = apply_correction(plain, self._correction)
                together = relation(first.world_from_base, command, second.world_from_base, adjusted)
                return taught_point(index, s_m, together, self._correction, (tuple(forces), tuple(moments)))
            self._correction = self._correction + yielding.step(sweep.maps.at_tip(1, 0, wrench))
            away_m, away_rad = np.linalg.norm(self._correction[:3]), np.linalg.norm(self._correction[3:])
            if away_m > rule.largest_m or away_rad > rule.largest_rad:
                raise PairStopped(
                    f"point {index + 1}: the adjustment went {1e3 * away_m:.1f} mm and {1e3 * away_rad:.1f} mrad away;"
                    " check bases, grasps and torque signs of both arms"
                )
        raise PairStopped(
            f"point {index + 1}: {forces[-1]:.1f} N and {moments[-1]:.2f} Nm are left after {rule.rounds} sweeps, the"
            f" set value is {rule.force_n} N and {rule.moment_nm} Nm; check friction and stiffness in the cell"
        )

    # -- trajectories
    # --------------------------------------------------------------------------------------------------------

    def _commands(self, trajectory: PreparedTrajectory, function: TransformFunction) -> Callable[[int, Any, Any], Pair]:
        """Return both gripper commands of a trajectory under a function and the present correction."""
        first, second = self._motion.cell.arms
        relations = function.many(trajectory.path.s_m)
        slave = slave_command(first.world_from_base, trajectory.path.commands, second.world_from_base, relations)
        return lambda m, _one, _two: (trajectory.path.commands[m], apply_correction(slave[m], self._correction))

    def _trajectory(self, commands: Floats, arcs_m: Floats) -> PreparedTrajectory:
        """The master's commands (n, 4, 4), one per control cycle, near the path at the arc lengths (n,) [m]."""
        path, dt_s = self._path, self._motion.dt_s
        near = int(path.nearest(arcs_m[:1])[0])
        along = replace(path, commands=commands, s_m=arcs_m, dt_s=dt_s)
        return self._motion.prepare_trajectory(along, (self._joints[0][near], self._joints[1][near]))

    def _sweep(self, index: int) -> PreparedTrajectory:
        rule, dt_s, cell = self._rule, self._motion.dt_s, self._motion.cell
        command = self._path.commands[index]
        twist, _ = liveliest_twist(cell, command, (self._joints[0][index], self._joints[1][index]))
        phase = 2.0 * np.pi * np.arange(round(rule.sweep_s / dt_s) + 1) * dt_s / rule.sweep_s
        commands = swept(cell, command, twist, -rule.sweep_m * np.cos(phase))
        return self._trajectory(commands, np.full(len(phase), self._path.s_m[index]))

    def _go(self, taught_path: TaughtPath, to_m: float) -> None:
        """Move along the path to an arc length [m], yielding to force; the correction is kept."""
        function = taught_path.function(self._motion.cell.nominal_relation)
        length = abs(to_m - self._arc_m)
        count = max(10, round(max(0.5, length / self._rule.path_speed_m_s) / self._motion.dt_s))
        share = smooth(np.arange(1, count + 1) / count)
        arcs_m = self._arc_m + share * (to_m - self._arc_m)
        trajectory = self._motion.prepare(lambda: self._trajectory(commands_at(self._path, arcs_m), arcs_m))
        plain = self._commands(trajectory, function)
        began = self._correction
        admittance = Admittance(self._gains, self._motion.dt_s)

        def yielding(m: int, one: Floats | None, two: Floats | None) -> Pair:
            wrench = trajectory.maps.internal(m, one, two)
            if wrench is not None:
                self._correction = began + admittance.step(trajectory.maps.at_tip(1, m, wrench))
            return plain(m, one, two)

        self._motion.run(trajectory, yielding, fade=True)
        self._arc_m = to_m


def commands_at(path: PairPath, arcs_m: Floats) -> Floats:
    """Return commands (n, 4, 4) of a path at the arc lengths (n,) [m], interpolated by a straight line and a
    rotation.
    """
    ways, first = np.unique(path.s_m, return_index=True)
    function = function_of_knots(ways, path.commands[first])
    return function.many(np.clip(arcs_m, 0.0, path.length_m))


#: Lever that converts rotations to lengths [m].
LEVER_M = 0.2


def directions() -> Floats:
    """Twists (364, 6) of length 1, a turn counted at the lever: every mixture of the six axes but for the sign."""
    mixtures = np.array([mixture for mixture in product((0.0, 1.0, -1.0), repeat=6) if any(mixture)])
    first = mixtures[np.arange(len(mixtures)), np.argmax(mixtures != 0.0, axis=1)]
    kept = mixtures[first > 0.0]
    return kept / np.linalg.norm(kept, axis=1)[:, None] / np.repeat([1.0, LEVER_M], 3)


def liveliest_twist(cell: PairCell, command: Floats, q_rad: tuple[Floats, Floats]) -> tuple[Floats, float]:
    """Return the twist of the part that maximises the smallest joint movement.

    Parameters
    ----------
    cell : PairCell
    command : array of shape (4, 4)
        Of the master's gripper.
    q_rad : two arrays of shape (N,)
        Joint angles of both arms there.

    Returns
    -------
    tuple
        Twist (6,) of the part about its centre, world axes, length 1 [m/m, rad/m]; how far the joint that turns least
        turns with it [rad/m].
    """
    centre = _centre(cell, command)
    twists = directions()
    least = np.full(len(twists), np.inf)
    for arm, q in zip(cell.arms, q_rad, strict=True):
        lever = (arm.world_from_base @ arm.chain.poses(q[None])[0][0])[:3, 3] - centre
        to_base = np.kron(np.eye(2), arm.world_from_base[:3, :3].T)
        at_tip = np.eye(6)
        at_tip[:3, 3:] = -cross_matrix(lever)
        rates = turns_at(arm.chain, q, to_base @ at_tip @ twists.T)
        least = np.minimum(least, np.abs(rates).min(axis=0))
    best = int(np.argmax(least))
    return twists[best], float(least[best])


def swept(cell: PairCell, command: Floats, twist: Floats, offsets_m: Floats) -> Floats:
    """Return the master's commands (n, 4, 4) that move the part from a command along a twist by offsets (n,) [m]."""
    base = cell.arms[0].world_from_base
    centre = pose(np.eye(3), _centre(cell, command))
    back = inverse(base)
    moved = [pose(exp_rotation(twist[3:] * offset_m), twist[:3] * offset_m) for offset_m in offsets_m]
    return np.array([back @ centre @ each @ inverse(centre) @ base @ command for each in moved])


def _centre(cell: PairCell, command: Floats) -> Floats:
    first = cell.arms[0]
    return (first.world_from_base @ command @ inverse(first.part_from_tip))[:3, 3]


AFRESH = "teach again without --resume"


def taught_point(
    index: int, s_m: float, relation: Floats, correction: Floats, forces: tuple[ArrayLike, ArrayLike]
) -> TaughtPoint:
    """Build a taught point from arrays.

    Parameters
    ----------
    index : of the command on the path, from 0
    s_m : arc length
    relation : array of shape (4, 4), gripper 2 in gripper 1
    correction : array of shape (6,), of the slave, its base [m, rad]
    forces : force [N] and moment [Nm] of every sweep
    """
    return TaughtPoint(
        command=index + 1,
        s_m=s_m,
        relation=matrix(relation),
        correction_m=numbers(correction[:3]),
        correction_rad=numbers(correction[3:]),
        force_n=numbers(forces[0]),
        moment_nm=numbers(forces[1]),
    )


@dataclass(slots=True)
class TaughtPath:
    """Points taught so far, for one path of one cell.

    Attributes
    ----------
    laws_s : array of shape (J, 2)
        T and tau [s] of `e + tau e' = T u'`, by which each joint of both arms followed its setpoints, NaN where
        unknown; None = not estimated.
    """

    path_hash: str
    cell_hash: str
    points: list[TaughtPoint] = field(default_factory=list)
    laws_s: Floats | None = None

    def update_laws(self, laws_s: Floats) -> None:
        """Take the present estimates of T and tau (J, 2) [s]; values that are no longer estimated are kept."""
        before = np.full(laws_s.shape, math.nan) if self.laws_s is None else self.laws_s
        self.laws_s = np.where(np.isnan(laws_s), before, laws_s)

    def function(self, start: Floats) -> TransformFunction:
        """Function through the points; `start` (4, 4) while there is none."""
        if not self.points:
            return function_of_knots([0.0], start[None])
        ordered = sorted(self.points, key=lambda point: point.s_m)
        return function_of_knots([point.s_m for point in ordered], np.array([point.relation for point in ordered]))

    def to_json(self) -> str:
        """Return the JSON text of the file."""
        rows = [] if self.laws_s is None else self.laws_s.tolist()
        laws = tuple(None if math.isnan(lag_s) else (lag_s, tau_s) for lag_s, tau_s in rows)
        points = tuple(self.points)
        return json_text(
            TaughtPathFile(path_hash=self.path_hash, cell_hash=self.cell_hash, points=points, servo_law_s=laws)
        )


def taught_path_from_json(text: str, where: str) -> TaughtPath:
    """Read taught points.

    Raises
    ------
    InputError
        Not such a file, or a key is missing or of the wrong kind.
    """
    try:
        data = json_object(text, where)
        check_kind(data, SCHEMA, where, POINTS_KIND)
        stored = decoded(TaughtPathFile, data, where)
    except InputError as error:
        raise InputError(f"{error}; {AFRESH}") from error
    unknown = (math.nan, math.nan)
    laws = np.array([unknown if law is None else law for law in stored.servo_law_s]) if stored.servo_law_s else None
    return TaughtPath(stored.path_hash, stored.cell_hash, list(stored.points), laws)


def read_taught_path(path: Path, path_hash: str, cell_hash: str) -> TaughtPath:
    """Taught points of a file, if it is for this path of this cell.

    Raises
    ------
    InputError
        It cannot be read, or is for another one.
    """
    taught_path = taught_path_from_json(text_of(path, AFRESH), str(path))
    if (taught_path.path_hash, taught_path.cell_hash) != (path_hash, cell_hash):
        raise InputError(f"{path}: its points were taught on another path or in another cell; {AFRESH}")
    return taught_path
