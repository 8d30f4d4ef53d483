"""Motor with gear, rotor, encoder and brake; its torque acts on the link through a stiff coupling."""

from __future__ import annotations

import math
from collections.abc import Callable

from sim.friction import JointFriction
from sim.servo import TICK_S, ServoLoop

#: A falling axis meets a soft stop after this movement.
FALL_RAD = 0.1


class MotorAxis:
    """One motor with its gear, loops and encoder; angles and torques on the gear output.

    Attributes
    ----------
    free : the holding brake is open
    fed : and the motor gives torque; a free axis that is not fed coasts
    slip_rad_s : speed at which the closed brake lets the axis sink under its load; 0 = it holds
    fall_rad_s2 : acceleration with which the axis falls once its brake is to hold it again; 0 = the brake holds
    fastest_rad_s : largest speed of the rotor since `fastest_rad_s` was set to 0
    theta_rad, omega_rad_s : rotor
    torque_nm : transmitted to the link
    position_rad : what the encoder gives, cell's zero offset taken off
    shown_nm : motor torque behind the drive's filter
    shown_sum_nm : the same, summed over the milliseconds since it was set to 0
    winding_c : gives the temperature of the winding [deg C]
    """

    __slots__ = (
        "_down",
        "_fallen_rad",
        "_fallen_rad_s",
        "compliance_rad_nm",
        "fall_rad_s2",
        "fastest_rad_s",
        "fed",
        "free",
        "friction",
        "omega_rad_s",
        "position_rad",
        "servo",
        "shift_rad",
        "shown_lag",
        "shown_nm",
        "shown_sum_nm",
        "slip_rad_s",
        "step",
        "theta_rad",
        "torque_nm",
        "winding_c",
    )

    def __init__(self, servo: ServoLoop, friction: JointFriction, filter_s: float) -> None:
        self.servo, self.friction = servo, friction
        self.free = self.fed = False
        self.slip_rad_s = self.fall_rad_s2 = self.fastest_rad_s = 0.0
        #: Direction of a fall (0 = the brake holds), and the speed and the angle it has reached.
        self._down = self._fallen_rad_s = self._fallen_rad = 0.0
        self.shown_lag = TICK_S / (TICK_S + filter_s)
        self.theta_rad = self.omega_rad_s = self.torque_nm = self.position_rad = 0.0
        self.shown_nm = self.shown_sum_nm = 0.0
        self.compliance_rad_nm = self.shift_rad = self.step = 0.0
        self.winding_c: Callable[[], float] = lambda: math.nan

    def tick(self, q_rad: float, torque: float) -> None:
        """Advance by one millisecond, while the coupling transmits a torque [Nm] to the link."""
        omega = self.omega_rad_s
        self.torque_nm = torque
        self.position_rad = position = q_rad + self.compliance_rad_nm * torque - self.shift_rad
        if self.free:
            u = self.servo.torque(position, omega) if self.fed else 0.0
            omega = self.omega_rad_s = self.friction.speed(omega, u, torque, self.step)
            self.theta_rad += omega * TICK_S
            self.shown_nm += (u - self.shown_nm) * self.shown_lag
        else:
            omega = -math.copysign(self.slip_rad_s, torque) if self.slip_rad_s else 0.0
            if self.falls:
                faster = self.fall_rad_s2 if self._fallen_rad < FALL_RAD / 2.0 else -self.fall_rad_s2
                self._fallen_rad_s = max(self._fallen_rad_s + faster * TICK_S, 0.0)
                self._fallen_rad += self._fallen_rad_s * TICK_S
                omega += self._down * self._fallen_rad_s
            self.omega_rad_s = omega
            self.theta_rad += omega * TICK_S
            self.shown_nm -= self.shown_nm * self.shown_lag
        self.shown_sum_nm += self.shown_nm
        if omega > self.fastest_rad_s or -omega > self.fastest_rad_s:
            self.fastest_rad_s = abs(omega)

    @property
    def falls(self) -> bool:
        """Return whether the axis falls although its brake is closed."""
        return self._down != 0.0 and self.fall_rad_s2 > 0.0

    def release(self) -> None:
        """Power the motor and open the brake; the reference is the present position."""
        if not self.fed:
            self.servo.reset(self.position_rad)
            self.friction.stuck_s = 0.0
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
