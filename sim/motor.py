"""Motor of a simulated drive: power, brake, encoder and loops; with gear and rotor behind a stiff coupling for one arm.

All angles and torques are at the gear output.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sim.friction import JointFriction
from sim.servo import TICK_S, ServoLoop

AMBIENT_C = 25.0
#: A falling axis meets a soft stop after this movement.
FALL_RAD = 0.1


class Motor:
    """What a drive has of its motor: power, holding brake, encoder and control loops.

    Attributes
    ----------
    servo : loops
    free : the holding brake is open
    fed : and the motor gives torque; a free axis that is not fed coasts
    slip_rad_s : speed at which the closed brake lets the axis sink under its load; 0 = it holds
    fall_rad_s2 : acceleration with which the axis falls once its brake is to hold it again; 0 = the brake holds
    fastest_rad_s : largest speed of the rotor since `fastest_rad_s` was set to 0
    position_rad, omega_rad_s : of the encoder, cell's zero offset taken off
    torque_nm : load of the gear
    shift_rad : joint angle at which the encoder's position is zero
    winding_c : gives the temperature of the winding [deg C], that of the surroundings by default
    """

    def __init__(self, servo: ServoLoop, shift_rad: float = 0.0) -> None:
        self.servo, self.shift_rad = servo, shift_rad
        self.free = self.fed = False
        self.slip_rad_s = self.fall_rad_s2 = self.fastest_rad_s = 0.0
        #: Direction of a fall (0 = the brake holds), and the speed and the angle it has reached.
        self._down = self._fallen_rad_s = self._fallen_rad = 0.0
        self.position_rad = self.omega_rad_s = self.torque_nm = 0.0
        self.winding_c: Callable[[], float] = lambda: AMBIENT_C

    @property
    def falls(self) -> bool:
        """Return whether the axis falls although its brake is closed."""
        return self._down != 0.0 and self.fall_rad_s2 > 0.0

    def sink(self, seconds: float, load_nm: float) -> float:
        """Return the speed [rad/s] of the axis in its closed brake, after a time under a load."""
        omega = -math.copysign(self.slip_rad_s, load_nm) if self.slip_rad_s else 0.0
        if self.falls:
            faster = self.fall_rad_s2 if self._fallen_rad < FALL_RAD / 2.0 else -self.fall_rad_s2
            self._fallen_rad_s = max(self._fallen_rad_s + faster * seconds, 0.0)
            self._fallen_rad += self._fallen_rad_s * seconds
            omega += self._down * self._fallen_rad_s
        return omega

    def release(self) -> None:
        """Power the motor and open the brake; the reference is the present position."""
        if not self.fed:
            self.servo.reset(self.position_rad)
            self.free = self.fed = True
            self._down = self._fallen_rad_s = self._fallen_rad = 0.0

    def coast(self) -> None:
        """Cut the motor power and leave the brake open."""
        if self.fed:
            self.fed = False
            self.servo.reset(self.position_rad)

    def lock(self) -> None:
        """Close the brake and cut the motor."""
        if self.free:
            self.free = self.fed = False
            self.servo.reset(self.position_rad)
            if self.fall_rad_s2:
                self._down = -math.copysign(1.0, self.torque_nm)


class MotorAxis(Motor):
    """One motor with its gear and rotor.

    Attributes
    ----------
    friction : of the gear
    theta_rad : of the rotor
    compliance_rad_nm : of the gear
    step : millisecond over rotor inertia [s / (kg m2)]
    shown_nm : motor torque behind the drive's filter
    shown_sum_nm : the same, summed over the milliseconds since it was set to 0
    """

    def __init__(self, servo: ServoLoop, friction: JointFriction, filter_s: float) -> None:
        super().__init__(servo)
        self.friction = friction
        self.shown_lag = TICK_S / (TICK_S + filter_s)
        self.theta_rad = self.shown_nm = self.shown_sum_nm = self.compliance_rad_nm = self.step = 0.0

    def tick(self, q_rad: float, torque: float) -> None:
        """Advance by one millisecond, while the coupling transmits a torque [Nm] to the link."""
        self.torque_nm = torque
        self.position_rad = position = q_rad + self.compliance_rad_nm * torque - self.shift_rad
        if self.free:
            u = self.servo.torque(position, self.omega_rad_s) if self.fed else 0.0
            omega = self.friction.speed(self.omega_rad_s, u, torque, self.step)
            self.shown_nm += (u - self.shown_nm) * self.shown_lag
        else:
            omega = self.sink(TICK_S, torque)
            self.shown_nm -= self.shown_nm * self.shown_lag
        self.omega_rad_s = omega
        self.theta_rad += omega * TICK_S
        self.shown_sum_nm += self.shown_nm
        if omega > self.fastest_rad_s or -omega > self.fastest_rad_s:
            self.fastest_rad_s = abs(omega)

    def release(self) -> None:
        """Power the motor and open the brake; a joint that was held has no memory of creep."""
        if not self.fed:
            self.friction.stuck_s = 0.0
            super().release()
