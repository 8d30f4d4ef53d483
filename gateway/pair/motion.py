"""Both arms streamed along prepared ways: commands out, torques in, forces watched. Run and teaching stand on it.

What stops both arms: an error of any drive or bus, a joint that does not follow, a force inside the part above twice
the limit for more than 20 ms, a gap outside its range or without a value, and the operator. They stop at the same time
by the quick stop ramp of their drives.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gateway.errors import PlanRefused
from gateway.motion.arm import ArmSample
from gateway.pair.calibration import PairCalibration, PathWrenches
from gateway.pair.cell import PairCell
from gateway.pair.felt import Felt, FeltByDistance, FeltByForce
from gateway.pair.follow import JointFollower, WrenchFromTorque
from gateway.pair.friction import FrictionOffset
from gateway.pair.gap import GapWatch
from gateway.pair.guard import ForceGuard
from gateway.pair.inverse import path_joint_angles
from gateway.pair.link import PairLink
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats, inverse

#: How far an arm may stand from where the part is gripped when a run begins [rad].
START_TOLERANCE_RAD = 0.02
#: Speed at which an arm is moved to where the next motion begins, and the shortest time of such a move.
APPROACH_RAD_S = 0.1
APPROACH_S = 0.2
#: Standing still before a way begins, so that the servos have settled [s].
DWELL_S = 0.1
#: For closing a gap at standstill: many times what one correction takes [s].
SETTLE_S = 0.4
#: Over which the end of one motion fades into the next [s].
FADE_S = 0.4
#: Standing still before a way, until torques have become wrenches.
LISTEN_CYCLES = 12
#: Cycles in a row that a joint may stand too far off its target.
FOLLOW_CYCLES = 3

Pair = tuple[Floats, Floats]
#: From the index of a command and both filtered wrenches (None before the first) to both gripper commands.
Commander = Callable[[int, Floats | None, Floats | None], Pair]


class PairStopped(PlanRefused):  # noqa: N818 - reads as what happened
    """Both arms were stopped; the message says why."""


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """How a pair is moved.

    Attributes
    ----------
    speed : speed setting, the cell's if None
    back_speed : of the way back, as forward if None
    force_limit_n : twice this force inside the part stops both arms; None = the cell's limit
    force_stop_s : after this time
    stop_asked : asked every cycle; true stops both arms by KeyboardInterrupt
    progress : called every 50 cycles with cycles done and their number
    """

    speed: float | None = None
    back_speed: float | None = None
    force_limit_n: float | None = None
    force_stop_s: float = 0.02
    stop_asked: Callable[[], bool] = lambda: False
    progress: Callable[[int, int], None] = lambda _done, _count: None


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A way with everything prepared for it: joint targets, forces from torques, forces inside the part."""

    path: PairPath
    joints: Pair
    followers: tuple[JointFollower, JointFollower]
    wrenches: tuple[WrenchFromTorque, WrenchFromTorque]
    maps: PathWrenches


@dataclass(frozen=True, slots=True, eq=False)
class Streamed:
    """What a way has shown.

    Attributes
    ----------
    force : array of shape (M, 6)
        Internal wrench about the part's centre, world axes, low-passed [N, Nm].
    external_nm : array of shape (M, 2, 6)
        External joint torque of both arms, not filtered; NaN where a sample was incomplete.
    gaps_m : array of shape (M, n)
        Distances less the demanded ones [m], NaN where a cycle had no value; n = 0 without sensors.
    complete : every epoch was complete
    evaluation_s : mean time that one command took to compute
    """

    force: Floats
    external_nm: Floats
    gaps_m: Floats
    complete: bool
    evaluation_s: float


def calibration_of(cell: PairCell) -> PairCalibration:
    """What the controller must know of a cell."""
    first, second = cell.arms
    plain = PairCalibration(
        first.world_from_base,
        second.world_from_base,
        inverse(first.part_from_tip),
        loop_time_s=cell.config.loop_delay_s,
    )
    if cell.gap is not None:
        return plain
    stiffness = cell.config.force.stiffness
    return replace(
        plain,
        part_mass_kg=cell.config.part_mass_kg,
        chain_stiffness=np.diag([stiffness.straight] * 3 + [stiffness.turned] * 3),
    )


class PairMotion:
    """Moves both arms of a link.

    Parameters
    ----------
    cell : PairCell
    link : PairLink
    options : MotionOptions, optional

    Attributes
    ----------
    q_rad : last targets (6,) of both arms
    """

    def __init__(self, cell: PairCell, link: PairLink, options: MotionOptions | None = None) -> None:
        self.cell, self.link = cell, link
        self.options = options or MotionOptions()
        self.calibration = calibration_of(cell)
        self.dt_s = cell.sync_period_s
        self.q_rad: Pair = (cell.arms[0].start_rad, cell.arms[1].start_rad)
        self._gap = None if cell.gap is None else GapWatch(cell.gap)
        lag_s = cell.config.servo_lag_s
        self._friction = [FrictionOffset(arm, self.dt_s, lag_s) for arm in cell.arms] if cell.gap else []
        self._follow_rad = [np.array([axis.following_error_limit_rad for axis in arm.config.axis]) for arm in cell.arms]
        #: What both arms reported last.
        self.samples: tuple[ArmSample, ArmSample] | None = None
        self._too_far = 0
        self._complete = True

    def passage(self, path: PairPath, seeds_rad: Pair) -> Passage:
        """Prepare a way of the master that begins near joint angles (6,) of both arms.

        Raises
        ------
        PlanRefused
            A pose out of reach, or a singular posture: there the force is not observable.
        """
        cell = self.cell
        slave = cell.nominal_slave(path)
        targets = (path.commands, slave)
        joints = [
            path_joint_angles(arm.chain, to, seed)[0]
            for arm, to, seed in zip(cell.arms, targets, seeds_rad, strict=True)
        ]
        followers = [JointFollower(arm, q) for arm, q in zip(cell.arms, joints, strict=True)]
        wrenches = [
            WrenchFromTorque(arm, each, path.dt_s, cell.config.servo_lag_s, cell.config.force_filter_hz)
            for arm, each in zip(cell.arms, followers, strict=True)
        ]
        return Passage(
            path,
            (joints[0], joints[1]),
            (followers[0], followers[1]),
            (wrenches[0], wrenches[1]),
            PathWrenches(self.calibration, path, slave),
        )

    def start(self) -> None:
        """Power both arms where they stand, at the start of the path with the part gripped.

        Raises
        ------
        PlanRefused
            An arm stands elsewhere; nothing was powered.
        """
        for arm, q in zip(self.cell.arms, self.link.where(), strict=True):
            away = np.abs(q - arm.start_rad)
            if away.max() > START_TOLERANCE_RAD:
                joint = int(np.argmax(away))
                raise PlanRefused(
                    f"arm '{arm.config.name}': joint {joint + 1} stands at {q[joint]:.4f} rad, the part is gripped at"
                    f" {arm.start_rad[joint]:.4f} rad; bring both arms to the start of the path first"
                )
        first, second = self.link.enable()
        self.q_rad = (first.q_rad.copy(), second.q_rad.copy())
        self._look((first, second))

    def approach(self, goal: Pair, dwell_s: float = DWELL_S) -> None:
        """Bring both arms to joint targets (6,) slowly, at the same time, then stand still."""
        began = self.q_rad
        most = max(float(np.abs(to - at).max()) for to, at in zip(goal, began, strict=True))
        count = max(1, round(max(APPROACH_S, most / APPROACH_RAD_S) / self.dt_s))
        for row in range(1, count + 1):
            share = smooth(row / count)
            self.exchange((began[0] + share * (goal[0] - began[0]), began[1] + share * (goal[1] - began[1])))
        for _ in range(round(dwell_s / self.dt_s)):
            self.exchange(goal)

    def settle(self, way: Passage, commander: Commander) -> None:
        """Stand at the beginning of a way until the commander has nothing left to correct."""
        felt = self._felt(way)
        for _ in range(round(SETTLE_S / self.dt_s)):
            felt.listen(self.exchange(self.targets(way, 0, commander(0, *felt.inputs(0)))))

    def targets(self, way: Passage, m: int, commands: Pair) -> Pair:
        """Joint targets of both arms for the gripper commands of index m."""
        first, second = way.followers
        return first.joints(m, commands[0]), second.joints(m, commands[1])

    def stream(self, way: Passage, commander: Commander, *, fade: bool = False) -> Streamed:
        """Every command of a way; with `fade` what the arms stand off its beginning is faded out.

        Raises
        ------
        PairStopped, DriveError, KeyboardInterrupt
            Both arms have been stopped.
        """
        count, felt = len(way.path), self._felt(way)
        for _ in range(LISTEN_CYCLES):
            felt.listen(self.exchange(self.q_rad))
        self._complete, spent, offset = True, 0.0, None
        fading = round(FADE_S / self.dt_s) if fade else 0
        for m in range(count):
            began = time.perf_counter()
            q = self.targets(way, m, commander(m, *felt.inputs(m)))
            spent += time.perf_counter() - began
            if m < fading:
                offset = offset or (self.q_rad[0] - q[0], self.q_rad[1] - q[1])
                share = 1.0 - smooth((m + 1) / fading)
                q = (q[0] + share * offset[0], q[1] + share * offset[1])
            trouble = felt.take(m, self.exchange(q))
            if trouble:
                self.stop(trouble)
            if m % 50 == 0:
                self.options.progress(m, count)
        return Streamed(felt.force, felt.external_nm, felt.gaps_m, self._complete, spent / count)

    def _felt(self, way: Passage) -> Felt:
        """What tells on this way how far the hands are off, from standing still on."""
        if self._gap is not None:
            return FeltByDistance(self._gap, self.cell.nominal_slave(way.path))
        limit_n = self.options.force_limit_n or self.cell.config.force.limit_n
        return FeltByForce(way.wrenches, way.maps, ForceGuard(limit_n, self.dt_s, self.options.force_stop_s))

    def exchange(self, q: Pair) -> tuple[ArmSample, ArmSample]:
        """One cycle with joint targets (6,) of both arms; checks that they follow."""
        before, self.q_rad = self.q_rad, q
        samples = self.samples = self.link.exchange(q, self._offsets(q))
        self._look(samples)
        far: tuple[int, int] | None = None
        for index, (sample, wanted) in enumerate(zip(samples, before, strict=True)):
            if not sample.complete:
                self._complete = False
                continue
            away = np.abs(sample.q_rad - wanted) > self._follow_rad[index]
            if away.any():
                far = (index, int(np.argmax(away)))
        self._too_far = 0 if far is None else self._too_far + 1
        if far is not None and self._too_far >= FOLLOW_CYCLES:
            name = self.cell.arms[far[0]].config.name
            self.stop(f"arm '{name}': joint {far[1] + 1} does not follow its target: both arms were stopped")
        if self.options.stop_asked():
            self.link.quick_stop()
            raise KeyboardInterrupt
        return samples

    def _offsets(self, q: Pair) -> Pair | None:
        """Friction of free hands; with a common part the torque is what tells the force, and nothing is added to it."""
        if not self._friction:
            return None
        first, second = (each.at(target) for each, target in zip(self._friction, q, strict=True))
        return first, second

    def _look(self, samples: tuple[ArmSample, ArmSample]) -> None:
        """Watch the gap wherever the arms are powered, also on the way to the start."""
        trouble = "" if self._gap is None else self._gap.take(samples)
        if trouble:
            self.stop(trouble)

    def stop(self, why: str) -> None:
        """Both arms by quick stop, at the same time; raises PairStopped with the reason."""
        error = PairStopped(why)
        try:
            self.link.quick_stop()
        except Exception as failure:
            error.add_note(f"while stopping: {failure}")
        raise error


def smooth(share: float) -> float:
    """From 0 to 1, at rest at both ends."""
    return share * share * (3.0 - 2.0 * share)
