"""Setpoint sources of a pair: approaches, prepared trajectories under a commander, corrections at rest."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from gateway.data.visit import ArmSample
from gateway.motion.setpoints import MotionSetpoints, PerArm
from gateway.motion.stops import StopKind
from gateway.motion.trajectory import Motion
from gateway.pair.balance import ForceBalance
from gateway.pair.calibration import PathWrenches
from gateway.pair.deviation import Deviation
from gateway.pair.force import InternalForce
from gateway.pair.joint_targets import ExternalTorque, JointFollower
from gateway.pair.pair_cell import PairCell
from gateway.pair.path import PairPath
from gateway.pair.servo_lag import ServoLag, equalised_targets, lag_differences
from gateway.pair.transform import Floats

#: For closing a gap at standstill: until corrections go at their full speed, and many times what one takes then [s].
RISING_S, SETTLE_S = 0.2, 0.4
#: Share of a correction that is left of it at the next SYNC when closing is broken off.
LEFT = 0.8
#: Rounding tolerance of a position along a trajectory, in rows.
HAIR = 1e-9
#: SYNCs after the decision to stop along the path in which the force may still rise, and how many times larger it may
#: become later: ramps that end one by one squeeze the part by hundreds of newtons, the slowing down itself by less.
RISING_SYNCS, RISING = 3, 2.5

Share = TypeVar("Share", float, Floats)
#: Listener called at every SYNC.
Watch = Callable[[tuple[ArmSample, ...]], None]


class MovedPair(Protocol):
    """Interface of the pair used by its setpoint sources."""

    dt_s: float
    cell: PairCell
    laws_s: Floats

    @property
    def q_rad(self) -> Pair:
        """Last targets (N,) of each arm."""
        ...

    def offsets(self, q: PerArm) -> PerArm | None:
        """Torque offsets of both arms, if any."""
        ...

    def see(self, samples: tuple[ArmSample, ...]) -> None:
        """Process the samples of a SYNC."""
        ...

    def ask(self, why: str, kind: StopKind = StopKind.ALONG_PATH) -> None:
        """Request a stop of both arms."""
        ...


class WatchedMotion(MotionSetpoints):
    """Prepared motions of both arms with monitoring of the gap and of a further condition."""

    def __init__(self, motion: MovedPair, began: Pair, motions: Sequence[Motion], watch: Watch | None = None) -> None:
        super().__init__(began, motions)
        self._motion, self._watch = motion, watch

    def targets(self, at: float, rate: float) -> PerArm:
        """As `SetpointSource.targets`."""
        self._q_rad = super().targets(at, rate)
        return self._q_rad

    def offsets(self) -> PerArm | None:
        """As `SetpointSource.offsets`."""
        return self._motion.offsets(self._q_rad)

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """As `SetpointSource.take`."""
        self._motion.see(samples)
        if self._watch is not None:
            self._watch(samples)


class Along:
    """A prepared trajectory under a commander.

    The commander reacts at every SYNC to the last measurement. Between two rows, when time along the path is slowed
    down, setpoints are on the straight line from row to row, so that both arms keep their relation; corrections are
    added to both ends of it. A joint with a longer lag gets a lead.

    Attributes
    ----------
    count : rows
    deviation : Deviation
    spent_s : time that the commander took
    """

    def __init__(
        self, motion: MovedPair, trajectory: PreparedTrajectory, commander: Commander, deviation: Deviation, fading: int
    ) -> None:
        self.count = len(trajectory.path)
        self.spent_s = 0.0
        self._motion, self._trajectory, self._commander, self.deviation = motion, trajectory, commander, deviation
        self._fading = fading
        self._offset: Pair | None = None
        self._row, self._deviation_at = -1, 0
        self._before = self._after = self._q_rad = motion.q_rad
        self._ahead = equalised_targets(np.hstack(trajectory.joints), motion.laws_s, motion.dt_s)
        lag_s = motion.cell.config.servo_lag_s + lag_differences(motion.laws_s)[1]
        self._lag = ServoLag(motion.dt_s, lag_s, self._ahead.shape[1])
        #: SYNCs since a stop was requested because of the force, and the largest force of the first of them.
        self._since, self._most_n = 0, 0.0

    def rates(self, at: float) -> tuple[Floats, Floats]:
        """As `SetpointSource.rates`."""
        row = max(round(at), 0)
        return self._trajectory.speed_rad_s[row], self._trajectory.acceleration_rad_s2[row]

    def targets(self, at: float, rate: float) -> PerArm:
        """As `SetpointSource.targets`."""
        row = max(math.ceil(at - HAIR), 0)
        self._lag.slow_down(rate)
        if row == self._row:
            self._yield(row)
        while self._row < row:
            self._row += 1
            self._before, self._after = self._after, self._compute(self._row)
        share = 1.0 - (row - at) if row > at else 1.0
        first, second = (
            before + share * (after - before) for before, after in zip(self._before, self._after, strict=True)
        )
        self._q_rad = self._after if share == 1.0 else (first, second)
        if self._lag.slower:
            speed = self._trajectory.speed_rad_s
            back = self._lag.given_back(speed[max(row - 1, 0)] + share * (speed[row] - speed[max(row - 1, 0)]))
            self._q_rad = (first - back[: len(first)], second - back[len(first) :])
        return self._q_rad

    def _yield(self, m: int) -> None:
        """Repeat a SYNC towards the same row."""
        now = self._compute(m)
        first, second = (to - before for to, before in zip(now, self._after, strict=True))
        self._before = (self._before[0] + first, self._before[1] + second)
        self._after = now

    def _compute(self, m: int) -> Pair:
        began = time.perf_counter()
        doubtful = self._lag.slower and self.deviation.doubtful(self._deviation_at)
        deviation = (None, None) if doubtful else self.deviation.inputs(m)
        first, second = self._trajectory.targets(m, self._commander(m, *deviation))
        ahead = self._ahead[m]
        q = (first + ahead[: len(first)], second + ahead[len(first) :])
        self.spent_s += time.perf_counter() - began
        if m < self._fading:
            at = self._motion.q_rad
            self._offset = self._offset or (at[0] - q[0], at[1] - q[1])
            share = 1.0 - smooth((m + 1) / self._fading)
            q = (q[0] + share * self._offset[0], q[1] + share * self._offset[1])
        return q

    def ahead(self, at: float, rate: float) -> None:
        """Return None: future setpoints depend on measurements that are not available yet."""

    def offsets(self) -> PerArm | None:
        """As `SetpointSource.offsets`."""
        return self._motion.offsets(self._q_rad)

    def modelled(self, at: float) -> PerArm:
        """As `SetpointSource.modelled`."""
        row = max(round(at), 0)
        return tuple(free[row] for free in self._trajectory.free_nm)

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """As `SetpointSource.take`."""
        self._motion.see(samples)
        self._lag.take(self._q_rad, samples, self._trajectory.speed_rad_s[self._row])
        self._deviation_at = self._row
        trouble = self.deviation.take(self._row, samples, rate)
        if not trouble:
            return
        size_n = self.deviation.size_n(self._row)
        if self._since == 0:
            self._motion.ask(trouble)
        elif self._since > RISING_SYNCS and size_n > RISING * self._most_n:
            self._motion.ask(trouble, StopKind.QUICK_STOP)
        if self._since <= RISING_SYNCS:
            self._most_n = max(self._most_n, size_n)
        self._since += 1


class Settling:
    """Rows at the start of a trajectory, where the commander corrects the initial deviation."""

    def __init__(
        self,
        motion: MovedPair,
        trajectory: PreparedTrajectory,
        commander: Commander,
        deviation: Deviation,
        watch: Watch | None = None,
    ) -> None:
        self.count = round((RISING_S + SETTLE_S) / motion.dt_s)
        self._rising, self._share = RISING_S / motion.dt_s, 0.0
        self._motion, self._trajectory, self._commander, self._deviation, self._watch = (
            motion,
            trajectory,
            commander,
            deviation,
            watch,
        )
        self._still = np.zeros(trajectory.speed_rad_s.shape[1])

    def rates(self, at: float) -> tuple[Floats, Floats]:
        """As `SetpointSource.rates`: zero, so that it can be ended at once."""
        return self._still, self._still

    def targets(self, at: float, rate: float) -> PerArm:
        """As `SetpointSource.targets`."""
        self._share = LEFT * self._share if rate == 0.0 else smooth(min(1.0, (at + 1.0) / self._rising))
        deviation = (None if one is None else self._share * one for one in self._deviation.inputs(0))
        self._q_rad = self._trajectory.targets(0, self._commander(0, *deviation))
        return self._q_rad

    def ahead(self, at: float, rate: float) -> None:
        """None."""

    def offsets(self) -> PerArm | None:
        """As `SetpointSource.offsets`."""
        return self._motion.offsets(self._q_rad)

    def modelled(self, at: float) -> PerArm:
        """As `SetpointSource.modelled`."""
        return tuple(free[0] for free in self._trajectory.free_nm)

    def take(self, at: float, rate: float, samples: tuple[ArmSample, ...]) -> None:
        """As `SetpointSource.take`."""
        self._motion.see(samples)
        self._deviation.listen(samples)
        if self._watch is not None:
            self._watch(samples)


def smooth(share: Share) -> Share:
    """From 0 to 1, at rest at both ends; a share or many."""
    return share * share * (3.0 - 2.0 * share)


Pair = tuple[Floats, Floats]
#: From the index of a command and both filtered wrenches (None before the first) to both gripper commands.
Commander = Callable[[int, Floats | None, Floats | None], Pair]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTrajectory:
    """A trajectory with everything precomputed for it.

    Attributes
    ----------
    path : PairPath
        Of the master.
    joints, followers : joint angles (M, N) of each arm by the nominal relation, and followers for targets near them
    torques, maps, balance : external torques, wrenches along the trajectory, and the internal force from both
    speed_rad_s, acceleration_rad_s2 : arrays of shape (M, J), both arms' joints in one row
        Of the nominal trajectories.
    free_nm : torque (M, N) of each arm in a free motion
    """

    path: PairPath
    joints: Pair
    followers: tuple[JointFollower, JointFollower]
    torques: tuple[ExternalTorque, ExternalTorque]
    maps: PathWrenches
    balance: ForceBalance
    speed_rad_s: Floats
    acceleration_rad_s2: Floats
    free_nm: Pair

    def targets(self, m: int, commands: Pair) -> Pair:
        """Joint targets of both arms for the gripper commands of index m."""
        first, second = self.followers
        return first.joints(m, commands[0]), second.joints(m, commands[1])


@dataclass(frozen=True, slots=True, eq=False)
class Streamed:
    """Result of a trajectory.

    Attributes
    ----------
    force : array of shape (M, 6)
        Internal wrench about the part's centre, world axes, low-passed [N, Nm].
    internal_force : InternalForce or None
        The same after completion, with its covariance; None without a common part.
    gaps_m : array of shape (M, n)
        Distances less the demanded ones [m], NaN where a cycle had no value; n = 0 without sensors.
    complete : every epoch was complete
    evaluation_s : mean time that one command took to compute
    """

    force: Floats
    internal_force: InternalForce | None
    gaps_m: Floats
    complete: bool
    evaluation_s: float
