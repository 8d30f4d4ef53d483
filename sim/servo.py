"""Cascaded control loops of one simulated drive, 1 kHz: position P, velocity PI with feedforward, first-order current.

All quantities are at the gear output: an angle is the motor angle divided by the gear ratio, a torque is the motor
torque times the ratio. One call of `ServoLoop.torque` advances the loops by one millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass

TICK_S = 0.001


@dataclass(frozen=True, slots=True)
class ServoGains:
    """Tuning of one axis.

    Attributes
    ----------
    position_1_s : position loop gain [1/s]
    speed_nm_s_rad : proportional gain of the velocity loop [Nm s/rad]
    reset_time_s : integral time of the velocity loop [s]
    feedforward : share of the reference speed that is fed forward, 0 to 1
    window_rad : standstill window [rad]: with the reference at rest and a smaller error, the integrator is held
    current_s : time constant of the current loop [s]
    """

    position_1_s: float
    speed_nm_s_rad: float
    reset_time_s: float = 0.12
    feedforward: float = 0.8
    window_rad: float = 1e-4
    current_s: float = 0.0008


class ServoLoop:
    """Control loops of one axis, with their state.

    Attributes
    ----------
    reference_rad, reference_step_rad : position reference and its increment per millisecond
    torque_only : cyclic synchronous torque mode: `offset_nm` is the whole torque demand
    offset_nm : torque feedforward (0x60B2) or torque demand
    offset_rad_s : speed feedforward (0x60B1)
    max_nm, max_rad_s : torque limit [Nm] and speed limit [rad/s]
    error_rad : following error [rad]
    demand_nm, u_nm : torque demand of the current loop, and the motor torque that it produces [Nm]
    limited : the torque limit acts
    """

    def __init__(self, gains: ServoGains, max_nm: float, max_rad_s: float) -> None:
        self.gains = gains
        self.max_nm, self.max_rad_s = max_nm, max_rad_s
        self._ki = gains.speed_nm_s_rad * TICK_S / gains.reset_time_s
        self._lag = TICK_S / (TICK_S + gains.current_s)
        self.reference_rad = self.reference_step_rad = self.offset_nm = self.offset_rad_s = 0.0
        self.torque_only = False
        self.reset(0.0)

    def reset(self, position_rad: float) -> None:
        """Reset the loops as at power-off: zero torque; the reference is the present position."""
        self.reference_rad, self.reference_step_rad = position_rad, 0.0
        self.error_rad = self.demand_nm = self.u_nm = self._integral_nm = 0.0
        self.limited = False

    def torque(self, position_rad: float, speed_rad_s: float) -> float:
        """Advance the loops by one millisecond and return the motor torque at the gear output [Nm]."""
        gains = self.gains
        step = self.reference_step_rad
        reference = self.reference_rad = self.reference_rad + step
        error = self.error_rad = reference - position_rad
        limit = self.max_nm
        speed_error = 0.0
        if self.torque_only:
            demand = self.offset_nm
            hold = True
        else:
            speed = gains.position_1_s * error + gains.feedforward * step / TICK_S + self.offset_rad_s
            if speed > self.max_rad_s:
                speed = self.max_rad_s
            elif speed < -self.max_rad_s:
                speed = -self.max_rad_s
            speed_error = speed - speed_rad_s
            demand = gains.speed_nm_s_rad * speed_error + self._integral_nm + self.offset_nm
            hold = step == 0.0 and -gains.window_rad < error < gains.window_rad
        self.limited = not -limit <= demand <= limit
        if self.limited:
            demand = limit if demand > 0.0 else -limit
        elif not hold:
            self._integral_nm += self._ki * speed_error
        self.demand_nm = demand
        self.u_nm += (demand - self.u_nm) * self._lag
        return self.u_nm
