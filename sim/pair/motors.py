"""Two-mass joints as arrays: rotor and encoder on one side, gear spring, link on the other.

All quantities are at the gear output. The gear's backlash is a play between rotor and spring, its cyclic error an angle
added to the spring deflection; the encoder measures neither, nor the wind-up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.motor import Motor
from sim.servo import ServoGains, ServoLoop

Array = NDArray[np.float64]

#: Damping of the gear spring against the rotor, share of critical.
GEAR_DAMPING = 0.03
#: Velocity loop: bandwidth on the rotor [rad/s], reset time [s]; feedforward leaves a fifth of the speed as lag.
SPEED_BANDWIDTH_RAD_S = 300.0
RESET_S = 0.04
FEEDFORWARD = 0.8
WINDOW_RAD = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class DriveTrain:
    """Drive train between motor and link, for n joints; arrays of shape (n,).

    Attributes
    ----------
    stiffness_nm_rad : gear spring
    rotor_kg_m2 : rotor inertia, reflected
    coulomb_nm, viscous_nm_s_rad : friction of motor and gear
    rated_nm : rated torque
    lag_s : following lag of the position loop behind its reference
    backlash_rad, cyclic_rad : play, and amplitude of the gear's cyclic error
    cyclic_per_rad : its phase per radian of joint angle
    cyclic_phase_rad : its phase at joint angle 0
    shift_rad : joint angle at which the drives' positions are zero
    max_rad_s : speed limit of the drives
    """

    stiffness_nm_rad: Array
    rotor_kg_m2: Array
    coulomb_nm: Array
    viscous_nm_s_rad: Array
    rated_nm: Array
    lag_s: Array
    backlash_rad: Array
    cyclic_rad: Array
    cyclic_per_rad: Array
    cyclic_phase_rad: Array
    shift_rad: Array
    max_rad_s: Array

    @property
    def damping_nm_s_rad(self) -> Array:
        """Damping of the gear spring, shape (n,)."""
        return 2.0 * GEAR_DAMPING * np.sqrt(self.stiffness_nm_rad * self.rotor_kg_m2)


def joined(trains: tuple[DriveTrain, DriveTrain]) -> DriveTrain:
    """Two arms as one list of joints."""
    first, second = trains
    return DriveTrain(
        *(
            np.concatenate([np.asarray(getattr(first, name)), np.asarray(getattr(second, name))])
            for name in DriveTrain.__slots__
        )
    )


class Motors:
    """State of n rotors.

    Parameters
    ----------
    train : DriveTrain
    step_s : physics step

    Attributes
    ----------
    theta, omega : (n,) rotor angle [rad] and speed [rad/s]
    play : (n,) angle behind the backlash [rad]
    u_nm : (n,) motor torque
    shown_nm : (n,) motor torque behind the drive's filter
    gear_nm : (n,) torque of the gear spring on the link
    axes : power, brake, encoder and loops of each
    """

    def __init__(self, train: DriveTrain, step_s: float) -> None:
        self.train = train
        n = len(train.rotor_kg_m2)
        self.theta, self.omega, self.play = np.zeros(n), np.zeros(n), np.zeros(n)
        self.u_nm, self.shown_nm, self.gear_nm = np.zeros(n), np.zeros(n), np.zeros(n)
        self._step_s = step_s
        self._rate = step_s / train.rotor_kg_m2
        self._lost = train.coulomb_nm * self._rate
        self._keep = 1.0 - train.viscous_nm_s_rad * self._rate
        self._half = 0.5 * train.backlash_rad
        self._stiffness, self._damping = train.stiffness_nm_rad, train.damping_nm_s_rad
        self.axes = [Motor(_servo(train, i), float(train.shift_rad[i])) for i in range(n)]

    def place(self, q_rad: Array, load_nm: Array) -> None:
        """Place the joints at rest with gears wound up so that they carry `load_nm` (n,) at the link angles `q_rad`
        (n,).
        """
        self.play = q_rad + load_nm / self._stiffness - self.cyclic(q_rad)
        self.theta, self.omega = self.play.copy(), np.zeros_like(q_rad)
        self.gear_nm = load_nm.copy()
        self.show()
        for axis in self.axes:
            axis.servo.reference_rad = axis.position_rad

    def rub(self, coulomb: Array, viscous: Array) -> None:
        """Let friction be so many times, (n,) each, what it was."""
        self._lost = self._lost * coulomb
        self._keep = 1.0 - viscous * (1.0 - self._keep)

    def cyclic(self, q_rad: Array) -> Array:
        """Angle (n,) [rad] that the gears add at rotor angles (n,)."""
        train = self.train
        return train.cyclic_rad * np.sin(train.cyclic_per_rad * q_rad + train.cyclic_phase_rad)

    def control(self, delay_s: Array, filter_share: float, tick_s: float) -> None:
        """Loops of all drives, one tick: motor torques from encoders.

        Parameters
        ----------
        delay_s : (n,) delay of each drive's reference [s]
        filter_share : of the new value in the drives' torque filter
        tick_s : control tick
        """
        positions, speeds, loads = self.theta.tolist(), self.omega.tolist(), self.gear_nm.tolist()
        torque = self.u_nm
        for i, axis in enumerate(self.axes):
            torque[i] = 0.0
            if axis.fed:
                servo = axis.servo
                delay = delay_s[i] * servo.reference_step_rad / tick_s
                torque[i] = servo.torque(positions[i] - axis.shift_rad + delay, speeds[i])
            elif not axis.free:
                speeds[i] = axis.sink(tick_s, loads[i])
            axis.fastest_rad_s = max(axis.fastest_rad_s, abs(speeds[i]))
        self.omega = np.array(speeds)
        self.shown_nm += (torque - self.shown_nm) * filter_share
        self._cycle = self.cyclic(self.theta)
        self._free = np.array([axis.free for axis in self.axes])

    def step(self, q_rad: Array, qd_rad_s: Array) -> Array:
        """One physics step of the rotors; returns the torque (n,) of the gear springs on the links [Nm]."""
        gear = self.gear_nm = self._stiffness * (self.play + self._cycle - q_rad) + self._damping * (
            self.omega - qd_rad_s
        )
        free = self.omega * self._keep + (self.u_nm - gear) * self._rate
        lost = self._lost
        self.omega = np.where(self._free, free - np.minimum(np.maximum(free, -lost), lost), self.omega)
        self.theta = self.theta + self.omega * self._step_s
        self.play = np.minimum(np.maximum(self.play, self.theta - self._half), self.theta + self._half)
        return gear

    def show(self) -> None:
        """Hand the encoders' angles and speeds and the gears' loads to the drives."""
        states = zip(self.axes, self.theta.tolist(), self.omega.tolist(), self.gear_nm.tolist(), strict=True)
        for axis, theta, omega, load in states:
            axis.position_rad, axis.omega_rad_s, axis.torque_nm = theta - axis.shift_rad, omega, load


def _servo(train: DriveTrain, i: int) -> ServoLoop:
    gains = ServoGains(
        position_1_s=(1.0 - FEEDFORWARD) / float(train.lag_s[i]),
        speed_nm_s_rad=SPEED_BANDWIDTH_RAD_S * float(train.rotor_kg_m2[i]),
        reset_time_s=RESET_S,
        feedforward=FEEDFORWARD,
        window_rad=WINDOW_RAD,
    )
    return ServoLoop(gains, 3.0 * float(train.rated_nm[i]), float(train.max_rad_s[i]))
