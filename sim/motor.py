"""One motor behind its gear: rotor, encoder, brake; it hands its torque to the link through a stiff coupling."""

from __future__ import annotations

from sim.friction import JointFriction
from sim.servo import TICK_S, ServoLoop


class MotorAxis:
    """One motor with its gear, loops and encoder; angles and torques on the gear output.

    Attributes
    ----------
    free : the holding brake is open and the motor is fed
    theta_rad, omega_rad_s : rotor
    torque_nm : transmitted to the link
    position_rad : what the encoder gives, cell's zero offset taken off
    shown_nm : motor torque behind the drive's filter
    """

    __slots__ = (
        "compliance_rad_nm",
        "damping",
        "free",
        "friction",
        "omega_rad_s",
        "position_rad",
        "servo",
        "shift_rad",
        "shown_lag",
        "shown_nm",
        "step",
        "stiffness",
        "theta_rad",
        "torque_nm",
    )

    def __init__(self, servo: ServoLoop, friction: JointFriction, filter_s: float) -> None:
        self.servo, self.friction = servo, friction
        self.free = False
        self.shown_lag = TICK_S / (TICK_S + filter_s)
        self.theta_rad = self.omega_rad_s = self.torque_nm = self.position_rad = self.shown_nm = 0.0
        self.compliance_rad_nm = self.shift_rad = self.stiffness = self.damping = self.step = 0.0

    def tick(self, q_rad: float, qd_rad_s: float) -> float:
        """One millisecond; returns the torque on the link [Nm]."""
        omega = self.omega_rad_s
        torque = self.stiffness * (self.theta_rad - q_rad) + self.damping * (omega - qd_rad_s)
        self.torque_nm = torque
        self.position_rad = position = q_rad + self.compliance_rad_nm * torque - self.shift_rad
        if self.free:
            u = self.servo.torque(position, omega)
            omega = self.omega_rad_s = self.friction.speed(omega, u, torque, self.step)
            self.theta_rad += omega * TICK_S
            self.shown_nm += (u - self.shown_nm) * self.shown_lag
        else:
            self.omega_rad_s = 0.0
            self.shown_nm -= self.shown_nm * self.shown_lag
        return torque

    def release(self) -> None:
        """Feed the motor and open the brake; the reference is where the axis stands."""
        if not self.free:
            self.servo.reset(self.position_rad)
            self.friction.stuck_s = 0.0
            self.free = True

    def lock(self) -> None:
        """Close the brake and cut the motor."""
        if self.free:
            self.free = False
            self.servo.reset(self.position_rad)
