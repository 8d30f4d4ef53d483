"""Teach the first function point by point: the force is reduced at each (CN104379308 embodiment 1, fig. 5).

Both arms hold the part and move slowly from point to point. At rest dry friction hides the force, so both arms make a
small sweep together: every joint then moves in both directions, and over one period friction cancels. The slave's
command is moved against the force until the force is below its set value; what is stored are the commands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gateway.pair.impedance import Admittance, Gains
from gateway.pair.pair_motion import PairMotion, PairStopped
from gateway.pair.pair_setpoints import smooth
from gateway.pair.path import PairPath
from gateway.pair.prepared_trajectory import Pair, PreparedTrajectory
from gateway.pair.relation import relation, slave_command
from gateway.pair.sweep import LEVER_M, liveliest_twist, swept
from gateway.pair.taught_path import TaughtPath, taught_point
from gateway.pair.transform import Floats, apply_correction
from gateway.pair.transform_function import TransformFunction, function_of_knots
from gateway.result.pair import TaughtPoint

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
            wrench = self._measure(sweep, function)
            forces.append(float(np.linalg.norm(wrench[:3])))
            moments.append(float(np.linalg.norm(wrench[3:])))
            if forces[-1] <= rule.force_n and moments[-1] <= rule.moment_nm:
                return self._taught(index, function, (tuple(forces), tuple(moments)))
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

    def _taught(
        self, index: int, function: TransformFunction, seen: tuple[tuple[float, ...], tuple[float, ...]]
    ) -> TaughtPoint:
        first, second = self._motion.cell.arms
        command = self._path.commands[index]
        s_m = float(self._path.s_m[index])
        plain = slave_command(first.world_from_base, command, second.world_from_base, function.at(s_m))
        adjusted = apply_correction(plain, self._correction)
        together = relation(first.world_from_base, command, second.world_from_base, adjusted)
        return taught_point(index, s_m, together, self._correction, seen)

    def _measure(self, sweep: PreparedTrajectory, function: TransformFunction) -> Floats:
        """Mean internal wrench (6,) over one period of the sweep, friction cancelled."""
        self._motion.run(sweep, self._commands(sweep, function))
        return sweep.balance.mean_to_and_fro()

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
