"""Base of the plants of a pair: two arms, a part between them, drives, and one time shared by two buses.

A plant has no clock. It advances when both arms have requested it.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.pair.body import ArmTruth, load_pair
from sim.pair.motors import Motors, joined
from sim.pair.workpiece import Closure, Stiffness, Workpiece
from sim.servo import TICK_S

Array = NDArray[np.float64]

STEP_S = 0.00025
#: How long the physics waits for the SYNC of the other bus, wall clock [s]: in many short pieces, so that a process
#: that was suspended for long does not take its own pause for a stopped bus.
WAIT_S, WAITS = 0.01, 25
#: A SYNC later than this starts a new phase; the time of an earlier one has already passed [s].
BUS_GAP_S = 0.1
#: In real time, how far the plant may be ahead of the time of a bus, and the longest wait for it [s].
TOGETHER_S, PATIENCE_S = 0.0005, 0.0015
#: Between two SYNCs that count as one instant of the plant [s].
SAME_S = 0.0003
#: Shorter stretches are left to the next one [ms].
LEAST_TICKS = 0.001
#: Rounding of times that are sums of many periods [s].
HAIR_S = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class WorldSettings:
    """What is not an arm.

    Attributes
    ----------
    start_rad : two (N,) encoder angles at which the part is gripped free of force
    stiffness : of the part
    skew_s, skew_jitter_s : how much later than the master's the slave's SYNC acts, constant and evenly spread part
    step_s : physics step
    seed : of the noise
    filter_s : time constant of the drives' torque filters
    """

    start_rad: tuple[Array, Array]
    stiffness: Stiffness = field(default_factory=Stiffness)
    skew_s: float = 0.0
    skew_jitter_s: float = 0.0
    step_s: float = STEP_S
    seed: int = 1
    filter_s: float = 0.001


class TwoArms(ABC):
    """Two arms that hold one part; how they move is up to the plant.

    Parameters
    ----------
    arms : master and slave
    settings : WorldSettings

    Attributes
    ----------
    time_s : simulated time
    motors, part : drives' side of the gears, and what is between the grippers
    joints, of_arm : how many joints J both arms have, and where each arm's are among them
    q, qd : (J,) joint angles [rad] and speeds [rad/s] of the links
    wrench : (6,) of the part on gripper 2, world axes, about its fingertip [N, Nm]
    record : one row a step of the plant while `recording`: time [s], force on gripper 2 (3) [N], moment about the
        part's centre (3) [Nm], the part's centre (3), fingertip 1 (3) [m]
    push : (J,) torque on the joints from outside [Nm], or None
    undeclared : drawn errors, for the truth file
    before, after : called around every stretch of time with its milliseconds, and with the time [s]
    """

    #: In real time, milliseconds of waiting before the plant advances between two SYNCs.
    usual_ticks = 1.0
    #: The plant advances by whole milliseconds only.
    whole_ticks = True

    def __init__(self, arms: tuple[ArmTruth, ArmTruth], settings: WorldSettings) -> None:
        self.arms, self.settings = arms, settings
        first = len(arms[0].bodies)
        self.joints = first + len(arms[1].bodies)
        self.of_arm = (slice(0, first), slice(first, self.joints))
        self.time_s = 0.0
        self.record: list[tuple[float, ...]] = []
        self.recording = False
        self.push: Array | None = None
        self.undeclared: dict[str, Any] = {}
        self.before: list[Callable[[float], None]] = []
        self.after: list[Callable[[float], None]] = []
        self.part = Workpiece((arms[0].geometry, arms[1].geometry), settings.stiffness)
        self._lock = threading.Condition()
        self._asked, self._owed, self._live = [0.0, 0.0], [0.0, 0.0], [False, False]
        self._random = np.random.default_rng(settings.seed)
        self._engine = load_pair(arms, settings.step_s)
        self.motors = Motors(joined((arms[0].train, arms[1].train)), settings.step_s)
        self._rated = self.motors.train.rated_nm
        self.q, self.qd, self.wrench = np.zeros(self.joints), np.zeros(self.joints), np.zeros(6)
        self._stand(np.concatenate(settings.start_rad))

    def _stand(self, theta_rad: Array) -> None:
        """Place the arms at rest, gears wound up by gravity, the part gripped free of force."""
        q, gravity, still = theta_rad.copy(), np.zeros_like(theta_rad), np.zeros_like(theta_rad)
        stiffness = self.motors.train.stiffness_nm_rad
        for _ in range(20):
            gravity = self._engine.needed_nm(q, still, still)
            q = theta_rad - gravity / stiffness
        self.q, self.qd = q, still
        self.motors.place(q, gravity)
        self.part.grip(q)

    @abstractmethod
    def _stretch(self, ticks: float) -> None:
        """Let milliseconds pass; the lock is held."""

    # -- time --------------------------------------------------------------------------------------------------------

    def catch_up(self, arm: int) -> None:
        """Wait until the physics has advanced as requested by this arm; not for an arm whose bus stopped."""
        with self._lock:
            if self._asked[arm] <= self.time_s + HAIR_S:
                return
            for _ in range(WAITS):
                if self._lock.wait_for(lambda: self._asked[arm] <= self.time_s + HAIR_S, WAIT_S):
                    return
            if self._asked[arm] > self.time_s + HAIR_S:
                self._live[1 - arm] = False
                before_s = self.time_s
                self._run()
                self._owed[1 - arm] += self.time_s - before_s

    def ask(self, arm: int, seconds: float) -> None:
        """An arm's SYNC came: go on once the other's has come too."""
        with self._lock:
            self._live[arm] = True
            owed = self._owed[arm] if self._owed[arm] < BUS_GAP_S else 0.0
            late = min(owed, seconds)
            self._owed[arm] = owed - late
            self._asked[arm] = round(max(self._asked[arm], self.time_s) + seconds - late, 9)
            self._run()

    def arrive(self, arm: int) -> None:
        """Handle a SYNC of an arm before anything is answered.

        The slave's SYNC follows the master's and is for the same instant. One that arrived before the master's belongs
        to an instant that the master's bus has skipped: time advances, and both are in step afterwards.
        """
        with self._lock:
            if arm == 0 and self._asked[0] <= self.time_s + HAIR_S < self._asked[1]:
                self._pass(self._asked[1])

    def _run(self) -> None:
        """Advance to the time requested by all powered arms whose SYNC is not missing."""
        powered = [any(axis.free for axis in self.motors.axes[own]) for own in self.of_arm]
        waited = [live and power for live, power in zip(self._live, powered, strict=True)]
        goal = min(self._asked[arm] for arm in (0, 1) if waited[arm]) if any(waited) else max(self._asked)
        self._pass(goal)

    def follow_the_clock(self, arm: int, seconds: float) -> None:
        """Report the real time of an arm's bus; the plant advances to the time of both buses."""
        with self._lock:
            self._asked[arm] += seconds
            if self._asked[arm] < self._asked[1 - arm] - BUS_GAP_S:  # it stalled for longer than is caught up with
                self._asked[arm] = self._asked[1 - arm]
            self._lock.notify_all()
            self._pass(min(self._asked), self.usual_ticks)

    @contextmanager
    def settled(self, arm: int) -> Generator[None]:
        """In real time: the instant of an arm's SYNC, at which its encoders are latched; time is stopped meanwhile.

        The other bus is waited for, unless it is stalled. A plant that the other arm's SYNC has just advanced to this
        time need not advance: rotors move evenly for so short a time.
        """
        with self._lock:
            together = self._lock.wait_for(lambda: self._asked[1 - arm] >= self._asked[arm] - TOGETHER_S, PATIENCE_S)
            if self._asked[arm] - self.time_s > SAME_S or not together:
                self._pass(self._asked[arm] if together else min(self._asked))
            for axis in self.motors.axes[self.of_arm[arm]]:
                axis.position_rad -= axis.omega_rad_s * (self.time_s - self._asked[arm])
            yield

    def _pass(self, until_s: float, least_ticks: float = LEAST_TICKS) -> None:
        ticks = (until_s - self.time_s) / TICK_S
        ticks = int(ticks + 1e-6) if self.whole_ticks else round(ticks, 6)
        if ticks >= least_ticks:
            self._stretch(ticks)
            self._lock.notify_all()

    # -- grippers ----------------------------------------------------------------------------------------------------

    @property
    def touching(self) -> bool:
        """Whether there is a part that both hands can hold."""
        return self.settings.stiffness.straight_n_m > 0.0

    def open_grippers(self) -> None:
        """No force acts between the arms from here on."""
        with self._lock:
            self.part.open()

    def close_grippers(self) -> None:
        """Grip the part afresh, free of force, where the hands are."""
        with self._lock:
            self.part.close(self.q)

    def _note(self, closure: Closure) -> None:
        centre = _centre(closure)
        force = self.wrench[:3]
        moment = self.wrench[3:] + np.cross(closure.tips[1][:3, 3] - centre, force)
        hand = closure.tips[0][:3, 3]
        self.record.append((self.time_s, *force.tolist(), *moment.tolist(), *centre.tolist(), *hand.tolist()))

    # -- observations ------------------------------------------------------------------------------------------------

    def reading_nm(self, arm: int) -> list[float]:
        """What the drives of an arm report as motor torque, gear output side [Nm]."""
        own, motors = self.of_arm[arm], self.motors
        rated = self._rated[own]
        noise = 0.003 * rated * self._random.standard_normal(len(rated))
        return ((motors.shown_nm[own] + noise) * [axis.free for axis in motors.axes[own]]).tolist()

    def close(self) -> None:
        """Give the physics engine back; may be called again."""
        self._engine.close()


def _centre(closure: Closure) -> Array:
    return 0.5 * (closure.tips[0][:3, 3] + closure.tips[1][:3, 3])
