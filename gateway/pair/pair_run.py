"""Repeated cycles of one embodiment on one path, over two buses.

A cycle carries the part along the path and back, and both directions learn separately. A trajectory with an incomplete
epoch or a stop is not used for learning.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from gateway.motion.stream import Stream
from gateway.pair.controller import Embodiment, PairController
from gateway.pair.force import InternalForce
from gateway.pair.inverse import GearChain, Hand
from gateway.pair.pair_cell import PairCell
from gateway.pair.pair_motion import FADE_S, PairMotion, PairMotionOptions
from gateway.pair.pair_setpoints import Commander, PreparedTrajectory, Streamed, smooth
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats, slave_command
from gateway.pair.transform_function import TransformFunction, function_of_knots
from gateway.result.pair import CycleSummary

#: Standstill at the start until the servos have crept to their targets, against friction [s].
SETTLED_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class PairCycle:
    """Result of one forward trajectory.

    Attributes
    ----------
    summary : CycleSummary
    force : array of shape (M, 6)
        Internal wrench about the part's centre, world axes, as estimated [N, Nm].
    internal_force : InternalForce or None
        The same with its covariance, None without a common part.
    gaps_m : array of shape (M, n)
        Distances less the demanded ones, NaN where a cycle had no value; n = 0 without sensors.
    learning_s : time that the learning step took
    evaluation_s : mean time of one evaluation of the controller, joint angles included
    """

    summary: CycleSummary
    force: Floats
    gaps_m: Floats
    learning_s: float
    evaluation_s: float
    internal_force: InternalForce | None = None


def reversed_path(path: PairPath) -> PairPath:
    """Return the path from its end to its start."""
    return replace(path, commands=path.commands[::-1].copy(), s_m=path.length_m - path.s_m[::-1])


def reversed_function(function: TransformFunction, length_m: float) -> TransformFunction:
    """Return the function of the arc length from the path's end."""
    return function_of_knots(length_m - function.s_m[::-1], function.knots[::-1])


class PairRun:
    """Runner of one embodiment with forward and return cycles.

    Parameters
    ----------
    cell : PairCell
    stream : Stream
        Of both arms, not necessarily powered yet.
    config : Embodiment
    first : TransformFunction
    options : PairMotionOptions, optional
    back : TransformFunction, optional
        Of the return, by the arc length from the end of the path; as forward if there is none.

    Attributes
    ----------
    controller : PairController
    path : PairPath
    motion : PairMotion
    """

    def __init__(
        self,
        cell: PairCell,
        stream: Stream,
        config: Embodiment,
        first: TransformFunction,
        options: PairMotionOptions | None = None,
        back: TransformFunction | None = None,
    ) -> None:
        self.config, self._cell = config, cell
        self.motion = PairMotion(cell, stream, options)
        self.path = cell.path(self.motion.options.speed)
        self._trajectory = self.motion.prepare_trajectory(self.path, (cell.arms[0].start_rad, cell.arms[1].start_rad))
        self.controller = self._controller(config, self._trajectory, self.path, first)
        self._first_back = self._reversed(first) if back is None else back
        self._return: PairController | None = None
        self._back = reversed_path(cell.path(self.motion.options.back_speed or self.path.speed))
        ends = (self._trajectory.joints[0][-1], self._trajectory.joints[1][-1])
        self._home: PreparedTrajectory = self.motion.prepare_trajectory(self._back, ends)

    @property
    def delay(self) -> int:
        """Return by how many commands the arms lag."""
        return self._trajectory.balance.delay

    @property
    def learned_back(self) -> TransformFunction | None:
        """Return the learned function of the return, None = nothing yet."""
        return None if self._return is None else self._return.state().second

    def start(self) -> None:
        """Both arms are powered at the start of the path, where the part is gripped."""
        self.motion.start()

    def stand(self) -> None:
        """Move both arms to the start of the path with zero corrections, where the grippers close."""
        first, second = self._cell.arms
        command = self.path.commands[0]
        relation = self.controller.function.at(float(self.path.s_m[0]))
        self.motion.approach(
            self._trajectory.targets(
                0, (command, slave_command(first.world_from_base, command, second.world_from_base, relation))
            ),
            SETTLED_S,
            self._trajectory,
        )

    def cycle(self) -> PairCycle:
        """Run one forward trajectory from rest at the start; learn from it if it was complete.

        Raises
        ------
        PairStopped, DriveError, KeyboardInterrupt
            Both arms were stopped; this cycle was not used for learning.
        """
        controller, trajectory = self.controller, self._trajectory
        self.motion.prepare(controller.start_cycle)
        self.stand()
        try:
            if self.config.sensing == "distance":
                self.motion.settle(trajectory, self._commander())
            streamed: Streamed = self.motion.run(trajectory, self._commander())
        except BaseException:
            controller.end_cycle(complete=False)
            raise
        began = time.perf_counter()
        summary = self.motion.prepare(lambda: controller.end_cycle(streamed.complete, streamed.internal_force))
        learning_s = time.perf_counter() - began
        gaps_m = streamed.gaps_m
        if gaps_m.size and not np.isnan(gaps_m).all():
            summary = replace(summary, gap_m=float(np.nanmax(np.abs(gaps_m))))
        internal_force = streamed.internal_force
        force = streamed.force if internal_force is None else internal_force.wrench
        return PairCycle(summary, force, gaps_m, learning_s, streamed.evaluation_s, internal_force)

    def _commander(self) -> Commander:
        """The controller's step, with the present positions of both grippers where the embodiment learns from them."""
        rule = self.config.learning
        if rule is None or rule.source == "command":
            return self.controller.step
        return lambda m, one, two: self.controller.step(m, one, two, self.motion.present)

    def back(self) -> bool:
        """Run the return, which learns separately because servos and gears respond differently; return whether it has
        learned.
        """
        controller, begun = self.motion.prepare(self._returning)
        streamed = self.motion.run(self._home, controller.step, fade=begun is None)
        return self.motion.prepare(lambda: controller.end_cycle(streamed.complete, streamed.internal_force)).learned

    def _begun(self, controller: PairController) -> Floats:
        """Return corrections (n, 6) that lead the slave from its present pose to the function."""
        away = controller.beside(self._cell.arms[1].chain.poses(self.motion.q_rad[1][None])[0][0])
        count = round(FADE_S / self.motion.dt_s)
        return (1.0 - smooth(np.arange(1, count + 1) / count))[:, None] * away

    def _returning(self) -> tuple[PairController, Floats | None]:
        """Return the controller of the return with its cycle begun; None where only setpoints are faded.

        Rows that learn from measured positions or keep a gap return with the forward function.
        """
        rule = self.config.learning
        if rule is None or rule.source != "command" or self.config.sensing != "force":
            config = replace(self.config, learning=None)
            controller = self._controller(config, self._home, self._back, self._reversed(self.controller.function))
            controller.start_cycle()
            return controller, None
        if self._return is None:
            self._return = self._controller(self.config, self._home, self._back, self._first_back)
        controller = self._return
        if self.controller.state().frozen:
            controller.freeze()
        else:
            controller.resume()
        begun = None if self.config.corrects != "slave" else self._begun(controller)
        controller.start_cycle(begun)
        return controller, begun

    def _reversed(self, function: TransformFunction) -> TransformFunction:
        return reversed_function(function, self.path.length_m)

    def _controller(
        self, config: Embodiment, trajectory: PreparedTrajectory, path: PairPath, first: TransformFunction
    ) -> PairController:
        known = self.motion.calibration
        one, two = (Hand(each.poses, each.jacobian) for each in trajectory.followers)
        chain = GearChain((one, two), (known.w_t_b1, known.w_t_b2), np.diag(known.chain_stiffness))
        return PairController(config, path, known, first, chain)
