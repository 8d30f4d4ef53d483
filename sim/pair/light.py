"""Two arms and one workpiece in real time, for which two arms in PyBullet are too slow.

Each motor follows its reference as a lag of first order, the links are in static equilibrium on their gears: in every
stretch of time the force inside the part, the wind-up of the gears and the torque of each motor are in balance, `T +
J^T W = tau`, with what the arms need for gravity and motion taken from PyBullet's inverse dynamics. There are no
vibrations, so a time step may have any length. An axis without torque, or one that exceeds its torque limit, falls
freely.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.motor import Motor
from sim.pair.body import ArmTruth
from sim.pair.two_arms import TwoArms, WorldSettings
from sim.servo import TICK_S

Array = NDArray[np.float64]

#: Movement of a rotor, at its joint, until dry friction has its full size [rad]; it keeps it at rest.
BREAKAWAY_RAD = 1e-4
#: Time in which a speed loop brings a rotor to the commanded speed: a step takes its torque over this time, however
#: short the stretch in which it is seen [s].
SPEED_LOOP_S = 0.001


class LightWorld(TwoArms):
    """Two arms without mass forces of their own; `record` gets a row a stretch.

    Parameters
    ----------
    arms : master and slave
    settings : WorldSettings

    Attributes
    ----------
    friction : (J,) dry friction that each motor overcomes, share of its full size, -1 to 1
    """

    usual_ticks = 6.0
    whole_ticks = False

    def __init__(self, arms: tuple[ArmTruth, ArmTruth], settings: WorldSettings) -> None:
        super().__init__(arms, settings)
        train = self.motors.train
        self._lag_s = train.lag_s.tolist()
        self._coulomb, self._viscous = train.coulomb_nm, train.viscous_nm_s_rad
        self._rotor, self._half = train.rotor_kg_m2, 0.5 * train.backlash_rad
        self._acceleration = np.zeros(self.joints)
        #: What of a change of speed the speed loops have not taken up yet [rad/s].
        self._open = np.zeros(self.joints)
        self.friction = np.zeros(self.joints)
        self._need = self.motors.gear_nm.copy()
        self._inertia = np.diag(self._engine.mass(self.q)) + self._rotor

    def _stretch(self, ticks: float) -> None:
        for act in self.before:
            act(ticks)
        self._turn(ticks)
        self._balance(ticks)
        self.time_s = round(self.time_s + ticks * TICK_S, 9)
        self.motors.show()
        if self.recording:
            self._note(self.part.at(self.q))
        for act in self.after:
            act(self.time_s)

    # -- motors ------------------------------------------------------------------------------------------------------

    def _turn(self, ticks: float) -> None:
        """Rotors follow their references, fall, or are held by their brakes."""
        motors, seconds = self.motors, ticks * TICK_S
        decay = [math.exp(-seconds / lag_s) for lag_s in self._lag_s]
        jitter = self.settings.skew_jitter_s
        delay_s = self.settings.skew_s + (self._random.uniform(0.0, jitter) if jitter else 0.0)
        slave = self.of_arm[1].start
        theta, omega = motors.theta.tolist(), motors.omega.tolist()
        asked = np.zeros(self.joints)
        gear, need = motors.gear_nm.tolist(), self._need.tolist()
        for i, axis in enumerate(motors.axes):
            before = omega[i]
            if axis.fed:
                most_nm = axis.servo.max_nm
                at = self._follow(axis, theta[i], ticks, self._lag_s[i], decay[i], delay_s if i >= slave else 0.0)
                if axis.servo.limited:
                    at = self._fall(i, theta[i], before, math.copysign(most_nm, need[i]), seconds)
                theta[i], omega[i] = at
                axis.servo.error_rad = axis.servo.reference_rad - (theta[i] - axis.shift_rad)
            elif axis.free:
                theta[i], omega[i] = self._fall(i, theta[i], before, 0.0, seconds)
            else:
                before = omega[i] = axis.sink(seconds, gear[i])
                theta[i] += omega[i] * seconds
            asked[i] = omega[i] - before
            axis.fastest_rad_s = max(axis.fastest_rad_s, abs(omega[i]))
        left = (self._open + asked) * math.exp(-seconds / SPEED_LOOP_S)
        self._acceleration, self._open = (self._open + asked - left) / seconds, left
        turned = np.array(theta) - motors.theta
        self.friction = np.clip(self.friction + turned / BREAKAWAY_RAD, -1.0, 1.0)
        motors.theta, motors.omega = np.array(theta), np.array(omega)

    def _follow(
        self, axis: Motor, theta: float, ticks: float, lag_s: float, decay: float, delay_s: float
    ) -> tuple[float, float]:
        """Angle and speed of a rotor behind a reference that moves evenly; the exact solution of its lag."""
        servo = axis.servo
        seconds, speed = ticks * TICK_S, axis.servo.reference_step_rad / TICK_S
        servo.reference_rad += servo.reference_step_rad * ticks
        goal = servo.reference_rad + axis.shift_rad - speed * delay_s
        behind, steady = goal - speed * seconds - theta, lag_s * (speed - servo.offset_rad_s)
        behind = steady + (behind - steady) * decay
        most = servo.max_rad_s * seconds
        way = min(max(goal - behind - theta, -most), most)
        omega = (goal - theta - way) / lag_s + servo.offset_rad_s
        return theta + way, min(max(omega, -servo.max_rad_s), servo.max_rad_s)

    def _fall(self, i: int, theta: float, omega: float, motor_nm: float, seconds: float) -> tuple[float, float]:
        """Angle and speed of a rotor under a torque that is given, its load and its friction."""
        load = float(self.motors.gear_nm[i]) + float(self._viscous[i]) * omega
        free = omega + (motor_nm - load) / float(self._inertia[i]) * seconds
        lost = float(self._coulomb[i]) / float(self._inertia[i]) * seconds
        omega = free - min(max(free, -lost), lost)
        return theta + omega * seconds, omega

    # -- torques -----------------------------------------------------------------------------------------------------

    def _balance(self, ticks: float) -> None:
        """Wind-up of the gears, force inside the part, torque of each motor."""
        motors = self.motors
        motors.play = np.minimum(np.maximum(motors.play, motors.theta - self._half), motors.theta + self._half)
        free = motors.play + motors.cyclic(motors.theta)
        self.qd = motors.omega
        links = free - motors.gear_nm / motors.train.stiffness_nm_rad
        tau = self._engine.needed_nm(links, self.qd, self._acceleration)
        if self.push is not None:
            tau = tau - self.push
        gear, compliance = tau, 1.0 / motors.train.stiffness_nm_rad
        self.wrench = np.zeros(6)
        stiffness = self.part.stiffness
        if stiffness.any():
            closure = self.part.at(free)
            rate = closure.jacobian
            gap = closure.deviation - rate @ (tau * compliance)
            chain = stiffness[:, None] * ((rate * compliance) @ rate.T)
            self.wrench = np.linalg.solve(np.eye(6) + chain, -stiffness * gap)
            gear = tau - self.wrench @ rate
        motors.gear_nm = gear
        self.q = free - gear * compliance
        self._report(ticks)

    def _report(self, ticks: float) -> None:
        """Torque that each motor gives, and whether it is all it has."""
        motors, omega = self.motors, self.motors.omega
        rubbing = self._coulomb * self.friction + self._viscous * omega
        self._need = motors.gear_nm + self._rotor * self._acceleration + rubbing
        need = self._need.tolist()
        for i, axis in enumerate(motors.axes):
            if not axis.fed:
                need[i] = 0.0
                continue
            servo = axis.servo
            servo.limited = not -servo.max_nm <= need[i] <= servo.max_nm
            need[i] = min(max(need[i], -servo.max_nm), servo.max_nm)
            servo.demand_nm = servo.u_nm = need[i]
        motors.u_nm = np.array(need)
        share = 1.0 - math.exp(-ticks * TICK_S / self.settings.filter_s) if self.settings.filter_s else 1.0
        motors.shown_nm = motors.shown_nm + (motors.u_nm - motors.shown_nm) * share
