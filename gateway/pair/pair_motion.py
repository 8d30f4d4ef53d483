"""Motion of both arms along prepared trajectories: gripper commands in, setpoints out, forces and gaps monitored.

Stops requested here: an internal force above twice the limit for more than 20 ms stops along the path, with the
relation kept, and by quick stop if it goes on rising. A gap outside its range stops by quick stop, one without a value
along the path. All other limits are checked by `gateway.motion`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from gateway.data.visit import ArmSample
from gateway.errors import LimitExceeded, PlanRefused, WrongPlace
from gateway.motion.joint_path import angles
from gateway.motion.reactions import ARM_RULES
from gateway.motion.setpoints import PerArm
from gateway.motion.stops import StopKind
from gateway.motion.stream import MoveOptions, Stream
from gateway.motion.trajectory import Motion
from gateway.motion.workspace import Workspace
from gateway.pair.balance import ForceBalance
from gateway.pair.calibration import PairCalibration, PathWrenches
from gateway.pair.deviation import NEAR_RAD, Deviation, DeviationFromDistance, DeviationFromForce
from gateway.pair.force import ForceGuard, InternalForce
from gateway.pair.gap import GapWatch, SensorCheck
from gateway.pair.inverse import path_joint_angles
from gateway.pair.joint_targets import ExternalTorque, FrictionOffset, JointFollower
from gateway.pair.model_uncertainty import ModelUncertainty, constants_of
from gateway.pair.pair_cell import PairCell
from gateway.pair.pair_setpoints import (
    Along,
    Commander,
    Pair,
    PreparedTrajectory,
    Settling,
    Streamed,
    Watch,
    WatchedMotion,
    smooth,
)
from gateway.pair.path import PairPath
from gateway.pair.servo_lag import LagLaw
from gateway.pair.transform import Floats, inverse, relation

#: Largest distance of an arm from the grip posture when a run begins [rad].
START_TOLERANCE_RAD = 0.02
#: Speed at which an arm is moved to where the next motion begins, and the shortest time of such a move.
APPROACH_RAD_S = 0.1
APPROACH_S = 0.2
#: Speed near the start where a part may already be held: a rising force is detected before it is large [rad/s].
HELD_RAD_S = 0.002
#: Standstill before a trajectory begins, so that the servos settle [s].
DWELL_S = 0.1
#: Over which the end of one motion fades into the next [s].
FADE_S = 0.4
#: Standstill before a trajectory, until wrenches are available.
LISTEN_CYCLES = 12
#: Observations of the servos are combined over this time [s].
TOGETHER_S = 0.4
#: Share of the limit allowed as certain force in a part during the approach to the start.
AT_REST = 0.5
#: While stopping, a force below this share of the limit may be friction: hands do not yield to it.
DOUBTFUL = 0.5

Result = TypeVar("Result")
Samples = tuple[ArmSample, ...]


class PairStopped(PlanRefused):
    """Both arms were stopped, or are about to be; the message states the cause."""


@dataclass(frozen=True, slots=True)
class PairMotionOptions:
    """Options of the motion of a pair.

    Attributes
    ----------
    speed : speed setting, the cell's if None
    back_speed : of the return, as forward if None
    force_limit_n : twice this internal force stops both arms; None = the cell's limit
    force_stop_s : after this time
    laws_s : how each joint (J, 2) follows its setpoints, as in `TaughtPath`; None = all equal
    moves : options of every motion, also of a single arm
    """

    speed: float | None = None
    back_speed: float | None = None
    force_limit_n: float | None = None
    force_stop_s: float = ARM_RULES["force"].limit
    laws_s: Floats | None = None
    moves: MoveOptions = field(default_factory=MoveOptions)


def calibration_of(cell: PairCell) -> PairCalibration:
    """Return the calibration data of a cell for the controller."""
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
        force_limit_n=cell.config.force.limit_n,
        chain_stiffness=np.diag([stiffness.straight] * 3 + [stiffness.turned] * 3),
    )


class PairMotion:
    """Motion of both arms of a pair along prepared trajectories.

    Parameters
    ----------
    cell : PairCell
    stream : Stream
        Of both arms, not necessarily powered yet.
    options : PairMotionOptions, optional

    Attributes
    ----------
    samples : what both arms reported last
    uncertainty : uncertainty of the constants of both arms, updated by every trajectory
    laws_s : how each joint (J, 2) follows its setpoints: every trajectory compensates the differences
    following : the same, estimated from all motions so far
    """

    def __init__(self, cell: PairCell, stream: Stream, options: PairMotionOptions | None = None) -> None:
        self.cell, self.stream = cell, stream
        self.options = options or PairMotionOptions()
        self.calibration = calibration_of(cell)
        self.dt_s = cell.sync_period_s
        self._desk = stream.options.desk
        self._gap = None if cell.gap is None else GapWatch(cell.gap)
        lag_s = cell.config.servo_lag_s
        self._friction = [FrictionOffset(arm, self.dt_s, lag_s) for arm in cell.arms] if cell.gap else []
        self.samples: Samples | None = None
        joints = sum(arm.axes for arm in cell.arms)
        self.uncertainty = ModelUncertainty(constants_of(joints))
        self.following = LagLaw(self.dt_s, joints, round(TOGETHER_S / self.dt_s))
        stated = self.options.laws_s
        self.laws_s = np.full((joints, 2), np.nan) if stated is None else stated
        self._complete = True

    @property
    def q_rad(self) -> Pair:
        """Return the last targets (N,) of each arm [rad]."""
        first, second = self.stream.q_rad
        return first, second

    @property
    def present(self) -> Pair | None:
        """Poses (4, 4) of both grippers in their bases by the encoders of the last SYNC; None if it brought not all."""
        samples = self.samples
        if samples is None or not all(sample.complete for sample in samples):
            return None
        first, second = (
            arm.chain.poses(sample.q_rad[None])[0][0] for arm, sample in zip(self.cell.arms, samples, strict=True)
        )
        return first, second

    def prepare_trajectory(self, path: PairPath, seeds_rad: Pair) -> PreparedTrajectory:
        """Prepare a trajectory of the master that begins near joint angles (N,) of each arm.

        Raises
        ------
        PlanRefused
            A pose out of reach, a singular posture (there the force is not observable), joints beyond the limits of
            the cell, or a posture in a keep-out box.
        """
        cell = self.cell
        slave = cell.nominal_slave(path)
        targets = (path.commands, slave)
        joints = [
            path_joint_angles(arm.chain, to, seed)[0]
            for arm, to, seed in zip(cell.arms, targets, seeds_rad, strict=True)
        ]
        for arm, workspace, q in zip(cell.arms, self.stream.workspaces, joints, strict=True):
            refuse_unreachable(arm.config.name, workspace, q, path.dt_s)
        followers = [JointFollower(arm, q) for arm, q in zip(cell.arms, joints, strict=True)]
        rates = [np.gradient(q, path.dt_s, axis=0) for q in joints]
        changes = [np.gradient(rate, path.dt_s, axis=0) for rate in rates]
        free = [
            arm.model_torque(q, rate, change)
            for arm, q, rate, change in zip(cell.arms, joints, rates, changes, strict=True)
        ]
        first, second = (
            ExternalTorque(arm, each, path.dt_s, cell.config.servo_lag_s)
            for arm, each in zip(cell.arms, followers, strict=True)
        )
        maps = PathWrenches(self.calibration, path, slave)
        return PreparedTrajectory(
            path,
            (joints[0], joints[1]),
            (followers[0], followers[1]),
            (first, second),
            maps,
            ForceBalance((first, second), maps, path.dt_s, cell.config.force_filter_hz),
            np.hstack(rates),
            np.hstack(changes),
            (free[0], free[1]),
        )

    def start(self) -> None:
        """Stay at rest after enabling until the drives carry the torque that the brakes carried."""
        self.see(self.stream.samples)
        self.stream.take_over(self.see)

    def stand(self, rows: int, what: str = "stand", listen: Callable[[Samples], None] | None = None) -> None:
        """Stay at rest for some SYNCs at the last targets."""

        def pass_on(samples: Samples) -> None:
            self.see(samples)
            if listen is not None:
                listen(samples)

        self.stream.stand(rows * self.dt_s, what, pass_on)

    def approach(self, goal: Pair, dwell_s: float = DWELL_S, held: PreparedTrajectory | None = None) -> None:
        """Move each arm slowly to joint targets (N,), both at the same time, then stay at rest.

        With `held`, the trajectory that begins there, the force in a part that may already be held is monitored.
        """
        deviation = None if held is None or self._gap is not None else self.prepare(lambda: self._force_deviation(held))
        watch = None if deviation is None else self._asking(deviation.rest)
        began = self.q_rad
        most = max(float(np.abs(to - at).max()) for to, at in zip(goal, began, strict=True))
        speed = APPROACH_RAD_S if watch is None or most > NEAR_RAD else HELD_RAD_S
        count = max(1, round(max(APPROACH_S, most / speed) / self.dt_s))
        share = np.arange(1, count + 1)[:, None] / count
        time_s = count * self.dt_s
        motions = [
            Motion(
                at + smooth(share) * (to - at),
                6.0 * share * (1.0 - share) * (to - at) / time_s,
                (6.0 - 12.0 * share) * (to - at) / time_s**2,
                self.dt_s,
            )
            for at, to in zip(began, goal, strict=True)
        ]
        self.stream.drive(WatchedMotion(self, began, motions, watch), "approach")
        self.stand(round(dwell_s / self.dt_s), listen=watch)

    def _asking(self, look: Callable[[Samples], str]) -> Watch:
        """Return a listener that requests a stop of both arms once `look`, called at every SYNC, returns a cause."""
        asked = False

        def watch(samples: Samples) -> None:
            nonlocal asked
            why = "" if asked else look(samples)
            if why:
                asked = True
                self.ask(why)

        return watch

    def prepare(self, job: Callable[[], Result]) -> Result:
        """Run a computation that takes longer than a cycle while both arms are at rest."""
        return self.stream.hold_while(job, "compute")

    def settle(self, trajectory: PreparedTrajectory, commander: Commander) -> None:
        """Stay at the start of a trajectory until the commander has nothing left to correct."""
        watch = None if self._gap is None else self._asking(self._sensors_follow(self._gap))
        deviation = self.prepare(lambda: self._deviation(trajectory))
        self.stream.drive(Settling(self, trajectory, commander, deviation, watch), "settle")

    def _sensors_follow(self, gap: GapWatch) -> Callable[[Samples], str]:
        first, second = self.cell.arms
        check = SensorCheck(gap.layout)

        def look(_samples: Samples) -> str:
            hands = self.present
            if hands is None:
                return ""
            return check.take(
                gap.readings_m, relation(first.world_from_base, hands[0], second.world_from_base, hands[1])
            )

        return look

    def run(self, trajectory: PreparedTrajectory, commander: Commander, *, fade: bool = False) -> Streamed:
        """Run every command of a trajectory; with `fade` the initial deviation of the arms is faded out.

        Raises
        ------
        PairStopped, DriveError, LimitExceeded, KeyboardInterrupt
            Both arms are at rest, or are stopped when their power is taken away.
        """
        along = self.prepare(
            lambda: Along(
                self, trajectory, commander, self._deviation(trajectory), round(FADE_S / self.dt_s) if fade else 0
            )
        )
        self.stand(LISTEN_CYCLES, listen=along.deviation.listen)
        self._complete = True
        self.stream.drive(along, "along the path")
        internal_force = None if self._gap is not None else self.prepare(lambda: self._internal_force(trajectory))
        return Streamed(
            along.deviation.force,
            internal_force,
            along.deviation.gaps_m,
            self._complete,
            along.spent_s / len(trajectory.path),
        )

    def _internal_force(self, trajectory: PreparedTrajectory) -> InternalForce:
        """Return the internal force along a completed trajectory, and update the model."""
        if self._complete:
            trajectory.balance.learn()
        return trajectory.balance.internal_force()

    def _deviation(self, trajectory: PreparedTrajectory) -> Deviation:
        """Return the deviation estimate of this trajectory, starting at rest."""
        if self._gap is not None:
            return DeviationFromDistance(self._gap, self.cell.nominal_slave(trajectory.path))
        return self._force_deviation(trajectory)

    def _force_deviation(self, trajectory: PreparedTrajectory) -> DeviationFromForce:
        usual_n = self.cell.config.force.limit_n
        limit_n, stop_s = self.options.force_limit_n or usual_n, self.options.force_stop_s
        guard, still = ForceGuard(limit_n, self.dt_s, stop_s), ForceGuard(AT_REST * limit_n, self.dt_s, stop_s, 1.0)
        trajectory.balance.begin(self.uncertainty)
        return DeviationFromForce(trajectory.torques, trajectory.balance, guard, still, self.dt_s, DOUBTFUL * usual_n)

    def offsets(self, q: PerArm) -> PerArm | None:
        """Return friction offsets of free hands; with a common part the torque measures the force and gets no
        offset.
        """
        if not self._friction:
            return None
        return tuple(each.at(target) for each, target in zip(self._friction, q, strict=True))

    def see(self, samples: Samples) -> None:
        """Process the samples of a SYNC whenever the arms are powered, also during the approach to the start."""
        self.samples = samples
        self.following.take(np.concatenate(self.q_rad), np.concatenate([sample.q_rad for sample in samples]))
        if not all(sample.complete for sample in samples):
            self._complete = False
        trouble = None if self._gap is None else self._gap.take(samples)
        if trouble is not None:
            self.ask(trouble.why, StopKind.QUICK_STOP if trouble.urgent else StopKind.ALONG_PATH)

    def ask(self, why: str, kind: StopKind = StopKind.ALONG_PATH) -> None:
        """Request a stop of both arms."""
        self._desk.ask(PairStopped(why), kind)


def refuse_elsewhere(cell: PairCell, where: Sequence[Floats]) -> None:
    """Refuse arms that are not at the start of the path, where the part is gripped.

    Parameters
    ----------
    cell : PairCell
    where : joint positions (N,) of each arm in its brakes

    Raises
    ------
    WrongPlace
        An arm is at another posture.
    """
    for arm, q in zip(cell.arms, where, strict=True):
        away = np.abs(q - arm.start_rad)
        if away.max() > START_TOLERANCE_RAD:
            joint = int(np.argmax(away))
            raise WrongPlace(
                f"arm '{arm.config.name}': joint {joint + 1} is at {q[joint]:.4f} rad, the part is gripped at"
                f" {arm.start_rad[joint]:.4f} rad; bring both arms to the start of the path first, without the part",
                arm.config.name,
                ",".join(f"{value:g}" for value in arm.start_rad),
            )


def refuse_unreachable(name: str, workspace: Workspace, q_rad: Floats, dt_s: float) -> None:
    """Refuse a trajectory (M, N) [rad], one row per SYNC, that exceeds the limits of the cell, between its rows too.

    The other arm and the part are no obstacles here.

    Raises
    ------
    PlanRefused, LimitExceeded
        A posture that is not allowed, or a joint that would turn faster than its limit.
    """
    refusal = workspace.refused_on(q_rad)
    if refusal is not None:
        raise PlanRefused(
            f"arm '{name}', command {int(refusal.row) + 1} at {angles(refusal.q_rad)}: {refusal.reason}; move the path"
            " or the base"
        )
    speed = np.abs(np.diff(q_rad, axis=0)).max(axis=0) / dt_s
    fast = speed > workspace.speed_rad_s
    if fast.any():
        joint = int(np.argmax(fast))
        raise LimitExceeded(
            f"arm '{name}', joint {joint + 1} would turn with {speed[joint]:.3f} rad/s, its limit is"
            f" {workspace.speed_rad_s[joint]:g} rad/s; lower the speed",
            joint + 1,
        )
