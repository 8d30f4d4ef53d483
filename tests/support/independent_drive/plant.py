"""What happens on the shaft: servo, weight, friction and brake of one axis, and the arm that couples six of them."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Sequence

from tests.support.independent_drive.arm import COUNTS_PER_REVOLUTION, EFFICIENCY, MOTORS, Motor, moments_of_weight

STEP_S = 0.0025
#: Bandwidth of the position servo, critically damped [rad/s].
SERVO_RAD_S = 60.0
#: Part of the reference's speed that the servo feeds forward; with less than all of it the joint does not overshoot.
RATE_SHARE = 0.5
#: Joint angle over which friction turns round (Dahl) [rad].
PRESLIDING_RAD = 5e-4
#: Noise of the measured torque [per mille of the rated torque].
NOISE_PERMILLE = 1.0


class Axis:
    """One joint with motor, gear, brake and servo; positions are joint angles [rad]."""

    def __init__(self, motor: Motor, angle: float) -> None:
        self.motor = motor
        self.angle, self.speed, self.acceleration = angle, 0.0, 0.0
        self.friction = 0.0
        self.weight = 0.0
        self.powered = False
        self.brake_closed = True
        #: Reference of the servo: where it is, how fast it moves, where to, and until when.
        self.reference, self.rate = angle, 0.0
        self._until_s = math.inf
        #: Deceleration of a stop ramp [rad/s2]; 0 = none.
        self.ramp = 0.0
        self.limit_nm = math.inf
        self.limited = False
        self.torque = 0.0
        self.counts_per_rad = motor.ratio * COUNTS_PER_REVOLUTION / (2.0 * math.pi)

    @property
    def count(self) -> int:
        """Position actual value at the motor."""
        return round((self.angle - self.motor.zero_rad) * self.counts_per_rad)

    @property
    def motor_rad_s(self) -> float:
        """Speed of the motor."""
        return self.speed * self.motor.ratio

    @property
    def motor_nm(self) -> float:
        """Torque of the motor."""
        return self.torque / self.motor.ratio

    @property
    def resistance(self) -> float:
        """Torque of the motor, at the joint, that keeps the present speed against weight and friction.

        A motor that drives the joint has to give 1 / efficiency of it; one that is driven feels the efficiency of it.
        Which of both it is follows from the direction of the last motion, as friction does.
        """
        direction = self.friction / self.motor.coulomb
        behind = self.weight + self.friction + self.motor.viscous * self.speed
        factor = 1.0 / EFFICIENCY if direction * behind > 0.0 else EFFICIENCY
        return behind * (1.0 + abs(direction) * (factor - 1.0))

    def hold(self) -> None:
        """The reference is where the axis is."""
        self.reference, self.rate, self.ramp, self._until_s = self.angle, 0.0, 0.0, math.inf

    def go(self, count: int, period_s: float, now_s: float) -> None:
        """The reference moves to a position within a period."""
        target = count / self.counts_per_rad + self.motor.zero_rad
        self.rate, self._until_s = (target - self.reference) / period_s, now_s + period_s

    def slow_down(self, deceleration: float) -> None:
        """The reference comes to rest by a ramp."""
        self.ramp, self._until_s = deceleration, math.inf

    @property
    def at_rest(self) -> bool:
        """Whether the reference and the joint are at rest."""
        return self.rate == 0.0 and abs(self.speed) < 1e-3

    def step(self, now_s: float) -> None:
        """One step of STEP_S."""
        if self.brake_closed:
            self.speed = self.acceleration = 0.0
            self.torque = self.resistance if self.powered else 0.0
            return
        resistance = self.resistance
        if self.powered:
            if self.ramp:
                change = self.ramp * STEP_S
                self.rate = 0.0 if abs(self.rate) <= change else self.rate - math.copysign(change, self.rate)
            part = min(1.0, max(0.0, (self._until_s - now_s) / STEP_S + 1.0))
            self.reference += self.rate * STEP_S * part
            if part < 1.0 - 1e-6:  # the last step of a period ends with it, whatever the clock's rounding
                self.rate, self._until_s = 0.0, math.inf
            error, slip = self.reference - self.angle, RATE_SHARE * self.rate - self.speed
            wanted = SERVO_RAD_S * (SERVO_RAD_S * error + 2.0 * slip)
            torque = resistance + self.motor.inertia * wanted
            self.torque = min(self.limit_nm, max(-self.limit_nm, torque))
            self.limited = self.torque != torque
        else:
            self.torque, self.limited = 0.0, False
        self.acceleration = (self.torque - resistance) / self.motor.inertia
        self.speed += self.acceleration * STEP_S
        move = self.speed * STEP_S
        self.angle += move
        band = self.motor.coulomb
        fade = math.exp(-abs(move) / PRESLIDING_RAD)
        self.friction = self.friction * fade + math.copysign(band, move) * (1.0 - fade)


class Arm:
    """Six axes whose weights depend on each other, in real time.

    Their clock follows the SYNC, as that of a drive does: a frame that comes a few milliseconds off moves no
    reference. Without SYNC it runs with the computer's.

    Parameters
    ----------
    angles : sequence of float
        Where the joints are at the beginning [rad].
    """

    def __init__(self, angles: Sequence[float]) -> None:
        self.axes = [Axis(motor, angle) for motor, angle in zip(MOTORS, angles, strict=True)]
        self.load: tuple[float, tuple[float, float, float]] | None = None
        self.time_s = time.monotonic()
        #: What this clock is behind the computer's [s].
        self._lag_s = 0.0
        #: Of the last SYNC, its time on the computer's clock and on this one [s].
        self._sync_s = self._sync_at_s = -math.inf
        self._noise = random.Random(1)

    def sync(self, period_s: float) -> None:
        """A SYNC came: one period has passed since the last one, unless SYNC had stopped."""
        now_s = time.monotonic()
        if now_s - self._sync_s < 2.5 * period_s:
            self._lag_s = now_s - (self._sync_at_s + period_s)
        self._sync_s, self._sync_at_s = now_s, now_s - self._lag_s
        self._until(self._sync_at_s)

    def advance(self, period_s: float) -> None:
        """Let the time pass that has passed; between two SYNCs no more than the period."""
        now_s = time.monotonic()
        until_s = now_s - self._lag_s
        if now_s - self._sync_s < 2.5 * period_s:
            until_s = min(until_s, self._sync_at_s + period_s)
        self._until(until_s)

    def _until(self, end_s: float) -> None:
        # rounding: without it a period of four steps is three, then five
        steps = math.floor((end_s - self.time_s) / STEP_S + 1e-6)
        if steps < 1:
            return
        moving = [axis for axis in self.axes if not axis.brake_closed or axis.powered]
        if moving:
            weights = moments_of_weight([axis.angle for axis in self.axes], self.load)
            for axis, weight in zip(self.axes, weights, strict=True):
                axis.weight = weight
            for number in range(min(steps, 400)):
                for axis in moving:
                    axis.step(self.time_s + (number + 1) * STEP_S)
        self.time_s += steps * STEP_S

    def noise(self) -> float:
        """Noise of one torque reading [per mille]."""
        return self._noise.gauss(0.0, NOISE_PERMILLE)
