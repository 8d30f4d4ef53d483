"""One embodiment on one path, cycle after cycle, over two buses.

A cycle carries the part along the path and back. On the way forward the controller corrects and learns, on the way back
it only corrects. Learning never sees a cycle with an incomplete epoch or a stop in it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from gateway.motion.stream import Stream
from gateway.pair.cell import PairCell
from gateway.pair.chain import Chain, Hand
from gateway.pair.controller import PairController
from gateway.pair.embodiments import Embodiment
from gateway.pair.function import TransformFunction, function_of_knots
from gateway.pair.inside import Inside
from gateway.pair.motion import PairMotion, PairMotionOptions
from gateway.pair.passage import Commander, Passage, Streamed
from gateway.pair.path import PairPath
from gateway.pair.relation import slave_command
from gateway.pair.transform import Floats
from gateway.result.pair import CycleSummary


@dataclass(frozen=True, slots=True, eq=False)
class PairCycle:
    """One way forward.

    Attributes
    ----------
    summary : CycleSummary
    force : array of shape (M, 6)
        Internal wrench about the part's centre, world axes, as estimated [N, Nm].
    inside : Inside or None
        The same with its covariance, None where nothing is held in common.
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
    inside: Inside | None = None


def reversed_path(path: PairPath) -> PairPath:
    """The same path from its end to its start."""
    return replace(path, commands=path.commands[::-1].copy(), s_m=path.length_m - path.s_m[::-1])


def reversed_function(function: TransformFunction, length_m: float) -> TransformFunction:
    """The same relation by the way from the end."""
    return function_of_knots(length_m - function.s_m[::-1], function.knots[::-1])


class PairRun:
    """Runs one embodiment.

    Parameters
    ----------
    cell : PairCell
    stream : Stream
        Of both arms, not necessarily powered yet.
    config : Embodiment
    first : TransformFunction
    options : PairMotionOptions, optional

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
    ) -> None:
        self.config, self._cell, self._first = config, cell, first
        self.motion = PairMotion(cell, stream, options)
        self.path = cell.path(self.motion.options.speed)
        self._way = self.motion.passage(self.path, (cell.arms[0].start_rad, cell.arms[1].start_rad))
        known = self.motion.calibration
        first_hand, second_hand = (Hand(each.poses, each.jacobian) for each in self._way.followers)
        bases = known.w_t_b1, known.w_t_b2
        chain = Chain((first_hand, second_hand), bases, np.diag(known.chain_stiffness))
        self.controller = PairController(config, self.path, known, first, chain)
        self._back = reversed_path(cell.path(self.motion.options.back_speed or self.path.speed))
        ends = (self._way.joints[0][-1], self._way.joints[1][-1])
        self._home: Passage = self.motion.passage(self._back, ends)

    @property
    def late(self) -> int:
        """How many commands the arms are behind."""
        return self._way.balance.late

    def start(self) -> None:
        """Both arms are powered at the start of the path, where the part is gripped."""
        self.motion.start()

    def stand(self) -> None:
        """Bring both arms to the start of the path, corrections at nothing: where the grippers close."""
        self.motion.approach(self._way.targets(0, self._standing()))

    def cycle(self) -> PairCycle:
        """One way forward, from standing at the start; learns from it if it was complete.

        Raises
        ------
        PairStopped, DriveError, KeyboardInterrupt
            Both arms were stopped; nothing was learned from this cycle.
        """
        controller, way = self.controller, self._way
        self.motion.prepare(controller.start_cycle)
        self.stand()
        try:
            if self.config.sensing == "distance":
                self.motion.settle(way, self._commander())
            streamed: Streamed = self.motion.run(way, self._commander())
        except BaseException:
            controller.end_cycle(complete=False)
            raise
        began = time.perf_counter()
        summary = self.motion.prepare(lambda: controller.end_cycle(streamed.complete, streamed.inside))
        learning_s = time.perf_counter() - began
        gaps_m = streamed.gaps_m
        if gaps_m.size and not np.isnan(gaps_m).all():
            summary = replace(summary, gap_m=float(np.nanmax(np.abs(gaps_m))))
        inside = streamed.inside
        force = streamed.force if inside is None else inside.wrench
        return PairCycle(summary, force, gaps_m, learning_s, streamed.evaluation_s, inside)

    def _commander(self) -> Commander:
        """The controller's step, with the present positions of both grippers where the embodiment learns from them."""
        rule = self.config.learning
        if rule is None or rule.source == "command":
            return self.controller.step
        return lambda m, one, two: self.controller.step(m, one, two, self._present())

    def _present(self) -> tuple[Floats, Floats] | None:
        samples = self.motion.samples
        if samples is None or not (samples[0].complete and samples[1].complete):
            return None
        first, second = (
            arm.chain.poses(sample.q_rad[None])[0][0] for arm, sample in zip(self._cell.arms, samples, strict=True)
        )
        return first, second

    def _standing(self) -> tuple[Floats, Floats]:
        """Both gripper commands at the start of the path, without corrections."""
        first, second = self._cell.arms
        command = self.path.commands[0]
        relation = self.controller.function.at(float(self.path.s_m[0]))
        return command, slave_command(first.world_from_base, command, second.world_from_base, relation)

    def back(self) -> None:
        """The same way back under the same function, corrected but not learned from."""
        controller = self.motion.prepare(self._returning)
        self.motion.run(self._home, controller.step, fade=True)

    def _returning(self) -> PairController:
        """Controller of the way back, under the function of the way forward as it is at the points of the first one.

        What lies between them was learned from how servos and gears answer to the way forward at its speed.
        """
        there = self._first.s_m
        function = reversed_function(function_of_knots(there, self.controller.function.many(there)), self.path.length_m)
        config = replace(self.config, learning=None)
        controller = PairController(config, self._back, self.motion.calibration, function)
        controller.start_cycle()
        return controller
