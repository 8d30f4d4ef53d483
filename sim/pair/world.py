"""Two arms and one workpiece in PyBullet, one body with two branches, stepped a quarter of a millisecond at a time.

Links are PyBullet's; rotors, gears and the workpiece are not: they hand their torques to the joints at every step. The
world knows no clock. It moves on when both arms have asked for it, so that two buses share one physics.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.pair.body import JOINTS, ArmTruth, load_pair
from sim.pair.motors import Motors, joined
from sim.pair.workpiece import Closure, Stiffness, Workpiece
from sim.physics import bullet
from sim.servo import TICK_S

Array = NDArray[np.float64]

STEP_S = 0.00025
#: How long the physics waits for the SYNC of the other bus, wall clock [s]: in many short pieces, so that a process
#: that was put aside for long does not take its own sleep for a silent bus.
WAIT_S, WAITS = 0.01, 25
#: A SYNC that comes later than this begins afresh; an earlier one finds the time it stands for gone already [s].
SILENT_S = 0.1
#: Rounding of times that are sums of many periods [s].
HAIR_S = 1e-6
#: Largest modulus of a mode of the linearised step.
STABLE = 1.0 + 1e-6


class UnstableStepError(ValueError):
    """The step is too long for the stiffest mode."""


@dataclass(frozen=True, slots=True, eq=False)
class WorldSettings:
    """What is not an arm.

    Attributes
    ----------
    start_rad : two (6,) encoder angles at which the part is gripped free of force
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


class PairWorld:
    """Physics of two arms that hold one part.

    Parameters
    ----------
    arms : master and slave
    settings : WorldSettings

    Attributes
    ----------
    time_s : simulated time
    record : one row a millisecond while `recording`: time [s], force on gripper 2 (3) [N], moment about the part's
        centre (3) [Nm], the part's centre (3), fingertip 1 (3) [m]
    push : (12,) torque on the joints from outside [Nm], or None
    told_nobody : drawn errors, for the truth file
    before, after : called around every stretch of time with its milliseconds, and with the time [s]
    """

    def __init__(self, arms: tuple[ArmTruth, ArmTruth], settings: WorldSettings) -> None:
        self.arms, self.settings = arms, settings
        self.time_s = 0.0
        self.record: list[tuple[float, ...]] = []
        self.recording = False
        self.push: Array | None = None
        self.told_nobody: dict[str, Any] = {}
        self.before: list[Callable[[int], None]] = []
        self.after: list[Callable[[float], None]] = []
        self.part = Workpiece((arms[0].geometry, arms[1].geometry), settings.stiffness)
        self._lock = threading.Condition()
        self._asked, self._owed, self._live = [0.0, 0.0], [0.0, 0.0], [False, False]
        self._random = np.random.default_rng(settings.seed)
        self._early = np.zeros(12)
        self._substeps = round(TICK_S / settings.step_s)
        self._share = TICK_S / (TICK_S + settings.filter_s)
        self._client, self._body = load_pair(arms, settings.step_s)
        shift = np.concatenate([arm.shift_rad for arm in arms])
        limits = np.concatenate([arm.max_rad_s for arm in arms])
        self.motors = Motors(joined((arms[0].train, arms[1].train)), shift, limits, settings.step_s)
        self._rated = self.motors.train.rated_nm
        self.q, self.qd = np.zeros(12), np.zeros(12)
        self._stand(np.concatenate(settings.start_rad))
        self.radius = self._largest_mode()
        if self.radius > STABLE:
            self.close()
            raise UnstableStepError(
                f"the physics step of {settings.step_s * 1e3:g} ms is too long: its fastest mode grows by"
                f" {self.radius:.4f} a step; take a shorter one or a softer workpiece"
            )

    # -- setting up --------------------------------------------------------------------------------------------------

    def _stand(self, theta_rad: Array) -> None:
        """Hang still, gears wound up by gravity, the part gripped free of force."""
        q, gravity = theta_rad.copy(), np.zeros(12)
        stiffness = self.motors.train.stiffness_nm_rad
        for _ in range(20):
            gravity = self._gravity(q)
            q = theta_rad - gravity / stiffness
        self.q, self.qd = q, np.zeros(12)
        for joint in JOINTS:
            bullet.resetJointState(self._body, joint, float(q[joint]), 0.0, physicsClientId=self._client)
        self.motors.place(q, gravity)
        self.part.grip(q)
        closure = self.part.at(q)
        self.part.size_damping(closure.jacobian @ np.linalg.solve(self._mass(q), closure.jacobian.T))
        self.wrench = np.zeros(6)
        self._centre = _centre(closure)

    def _gravity(self, q: Array) -> Array:
        still = [0.0] * 12
        return np.array(
            bullet.calculateInverseDynamics(self._body, q.tolist(), still, still, physicsClientId=self._client)
        )

    def _mass(self, q: Array) -> Array:
        return np.array(bullet.calculateMassMatrix(self._body, q.tolist(), physicsClientId=self._client))

    def _largest_mode(self) -> float:
        """Largest modulus of the eigenvalues of one step, linearised at rest."""
        train, h, n = self.motors.train, self.settings.step_s, 12
        rate = self.part.at(self.q).jacobian
        inverse = np.linalg.inv(self._mass(self.q))
        spring, damper = np.diag(train.stiffness_nm_rad), np.diag(train.damping_nm_s_rad)
        part_spring = rate.T @ (self.part.stiffness[:, None] * rate)
        part_damper = rate.T @ (self.part.damping[:, None] * rate)
        rotor = h * np.diag(1.0 / train.rotor_kg_m2)
        zero, one = np.zeros((n, n)), np.eye(n)
        # q, qd, theta, omega; forces from the old state, angles from the new speeds
        speed = np.hstack(
            [
                -h * inverse @ (spring + part_spring),
                one - h * inverse @ (damper + part_damper),
                h * inverse @ spring,
                h * inverse @ damper,
            ]
        )
        turn_ = np.hstack([rotor @ spring, rotor @ damper, -rotor @ spring, one - rotor @ damper])
        angle = np.hstack([one, zero, zero, zero]) + h * speed
        shaft = np.hstack([zero, zero, one, zero]) + h * turn_
        return float(np.abs(np.linalg.eigvals(np.vstack([angle, speed, shaft, turn_]))).max())

    # -- time --------------------------------------------------------------------------------------------------------

    def catch_up(self, arm: int) -> None:
        """Wait until the physics has done what this arm has asked for; not for an arm whose bus is silent."""
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
            owed = self._owed[arm] if self._owed[arm] < SILENT_S else 0.0
            late = min(owed, seconds)
            self._owed[arm] = owed - late
            self._asked[arm] = round(max(self._asked[arm], self.time_s) + seconds - late, 9)
            self._run()

    def arrive(self, arm: int) -> None:
        """A SYNC of an arm came, nothing has been answered yet.

        The slave's SYNC follows the master's and stands for the same instant. One that was there before the master's is
        of an instant that the master's bus has skipped: it passes now, and both are in step from here on.
        """
        with self._lock:
            if arm == 0 and self._asked[0] <= self.time_s + HAIR_S < self._asked[1]:
                self._pass(self._asked[1])

    def _run(self) -> None:
        """Go on to what has been asked for by all arms that are powered and whose SYNC has not stayed away."""
        powered = [bool(self.motors.live[6 * arm : 6 * arm + 6].any()) for arm in (0, 1)]
        waited = [live and power for live, power in zip(self._live, powered, strict=True)]
        goal = min(self._asked[arm] for arm in (0, 1) if waited[arm]) if any(waited) else max(self._asked)
        self._pass(goal)

    def _pass(self, until_s: float) -> None:
        ticks = int((until_s - self.time_s) / TICK_S + 1e-6)
        if ticks > 0:
            self._stretch(ticks)
            self._lock.notify_all()

    def _stretch(self, ticks: int) -> None:
        for act in self.before:
            act(ticks)
        jitter = self.settings.skew_jitter_s
        self._early[6:] = -self.settings.skew_s - (self._random.uniform(0.0, jitter) if jitter else 0.0)
        for _ in range(ticks):
            self._tick()
        self.motors.show()
        for act in self.after:
            act(self.time_s)

    def _tick(self) -> None:
        """One millisecond."""
        motors, part, body, client = self.motors, self.part, self._body, self._client
        motors.control(self._early, self._share, TICK_S)
        q, qd = self.q, self.qd
        closure = part.at(q)
        rate, stiffness, damping = closure.jacobian, part.stiffness, part.damping
        base, push, wrench = closure.deviation - rate @ q, self.push, self.wrench
        for _ in range(self._substeps):
            wrench = -stiffness * (base + rate @ q) - damping * (rate @ qd)
            torque = motors.step(q, qd) + wrench @ rate
            if push is not None:
                torque = torque + push
            bullet.setJointMotorControlArray(
                body, JOINTS, bullet.TORQUE_CONTROL, forces=torque.tolist(), physicsClientId=client
            )
            bullet.stepSimulation(physicsClientId=client)
            states = bullet.getJointStates(body, JOINTS, physicsClientId=client)
            q, qd = np.array([state[0] for state in states]), np.array([state[1] for state in states])
        self.q, self.qd, self.wrench = q, qd, wrench
        self.time_s = round((self.time_s + TICK_S) / TICK_S) * TICK_S
        if self.recording:
            self._note(closure)

    def _note(self, closure: Closure) -> None:
        centre = _centre(closure)
        force = self.wrench[:3]
        moment = self.wrench[3:] + np.cross(closure.tips[1][:3, 3] - centre, force)
        hand = closure.tips[0][:3, 3]
        self.record.append((self.time_s, *force.tolist(), *moment.tolist(), *centre.tolist(), *hand.tolist()))

    # -- what is seen ------------------------------------------------------------------------------------------------

    def reading_nm(self, arm: int) -> list[float]:
        """What six drives report as motor torque, gear output side [Nm]."""
        six = slice(6 * arm, 6 * arm + 6)
        motors = self.motors
        noise = 0.003 * self._rated[six] * self._random.standard_normal(6)
        return ((motors.shown_nm[six] + noise) * motors.live[six]).tolist()

    @property
    def fastest_rad_s(self) -> Array:
        """Largest speed of each motor at its gear output since `forget_fastest`, shape (12,) [rad/s]."""
        return self.motors.fastest.copy()

    def forget_fastest(self) -> None:
        """Begin anew to look for the largest speed."""
        self.motors.fastest[:] = 0.0

    def close(self) -> None:
        """Give the physics engine back; may be called again."""
        if self._client >= 0:
            bullet.disconnect(physicsClientId=self._client)
            self._client = -1


def _centre(closure: Closure) -> Array:
    return 0.5 * (closure.tips[0][:3, 3] + closure.tips[1][:3, 3])
