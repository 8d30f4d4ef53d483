"""Two-mass joints as arrays: rotor and encoder on one side, gear spring, link on the other.

All quantities are at the gear output. The gear's backlash is a play between rotor and spring, its cyclic error an angle
added to the spring deflection; the encoder measures neither, nor the wind-up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


class PairAxis:
    """Interface of a simulated drive to its motor, the same as for a single arm.

    Attributes
    ----------
    free : brake open
    fed : and motor fed
    slip_rad_s : speed at which the closed brake lets the axis sink; 0 = it holds
    fall_rad_s2 : acceleration with which the axis falls once its brake is to hold it again; 0 = the brake holds
    falls : the brake was to hold the axis and does not
    fastest_rad_s : largest speed of the rotor since `fastest_rad_s` was set to 0
    position_rad, omega_rad_s : encoder, cell's zero offset taken off
    servo : loops
    """

    __slots__ = (
        "fall_rad_s2",
        "fastest_rad_s",
        "fed",
        "free",
        "index",
        "motors",
        "omega_rad_s",
        "position_rad",
        "servo",
        "shift_rad",
        "slip_rad_s",
    )

    def __init__(self, motors: Motors, index: int, servo: ServoLoop, shift_rad: float) -> None:
        self.motors, self.index, self.servo, self.shift_rad = motors, index, servo, shift_rad
        self.free = self.fed = False
        self.position_rad = self.omega_rad_s = 0.0
        self.slip_rad_s = self.fall_rad_s2 = self.fastest_rad_s = 0.0

    @property
    def falls(self) -> bool:
        """See the class."""
        return self.fall_rad_s2 > 0.0 and bool(self.motors.fall[self.index])

    def release(self) -> None:
        """Power the motor and open the brake; the reference is the present position, the gear's load is taken over."""
        if not self.fed:
            self.servo.reset(self.position_rad)
            self.free = self.fed = True
            self.motors.live[self.index] = 1.0
            self.motors.fall[self.index] = self.motors.fallen[self.index] = 0.0

    def coast(self) -> None:
        """Cut the motor power and leave the brake open."""
        if self.fed:
            self.fed = False
            self.servo.reset(self.position_rad)

    def lock(self) -> None:
        """Close the brake and cut the motor."""
        if self.free:
            self.free = self.fed = False
            self.motors.live[self.index] = 0.0
            self.motors.omega[self.index] = self.omega_rad_s = 0.0
            self.motors.fall[self.index] = -np.copysign(self.fall_rad_s2, self.motors.gear_nm[self.index])
            self.servo.reset(self.position_rad)


class Motors:
    """State of n rotors.

    Parameters
    ----------
    train : DriveTrain
    shift_rad : (n,) joint angle at which the drives' positions are zero
    max_rad_s : (n,) speed limit of the drives
    step_s : physics step

    Attributes
    ----------
    theta, omega : (n,) rotor angle [rad] and speed [rad/s]
    play : (n,) angle behind the backlash [rad]
    u_nm : (n,) motor torque
    shown_nm : (n,) motor torque behind the drive's filter
    gear_nm : (n,) torque of the gear spring on the link
    live : (n,) 1 = brake open
    fall, fallen : (n,) acceleration and speed of axes that fall in their brakes
    """

    def __init__(self, train: DriveTrain, shift_rad: Array, max_rad_s: Array, step_s: float) -> None:
        self.train = train
        n = len(train.rotor_kg_m2)
        self.theta, self.omega, self.play = np.zeros(n), np.zeros(n), np.zeros(n)
        self.u_nm, self.shown_nm, self.gear_nm, self.live = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.fall, self.fallen = np.zeros(n), np.zeros(n)
        self._step_s = step_s
        self._rate = step_s / train.rotor_kg_m2
        self._lost = train.coulomb_nm * self._rate
        self._keep = 1.0 - train.viscous_nm_s_rad * self._rate
        self._half = 0.5 * train.backlash_rad
        self._stiffness, self._damping = train.stiffness_nm_rad, train.damping_nm_s_rad
        self.axes = [PairAxis(self, i, _servo(train, i, float(max_rad_s[i])), float(shift_rad[i])) for i in range(n)]

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
        positions, speeds = self.theta.tolist(), self.omega.tolist()
        torque = self.u_nm
        for i, axis in enumerate(self.axes):
            axis.fastest_rad_s = max(axis.fastest_rad_s, abs(speeds[i]))
            if axis.fed:
                servo = axis.servo
                delay = delay_s[i] * servo.reference_step_rad / tick_s
                torque[i] = servo.torque(positions[i] - axis.shift_rad + delay, speeds[i])
            else:
                torque[i] = 0.0
                self.fallen[i] = self.fallen[i] + self.fall[i] * tick_s if axis.falls else 0.0
        self.shown_nm += (torque - self.shown_nm) * filter_share
        self._cycle = self.cyclic(self.theta)
        slip = np.array([axis.slip_rad_s for axis in self.axes])
        self._sink = (self.fallen - slip * np.sign(self.gear_nm)) * (1.0 - self.live)

    def step(self, q_rad: Array, qd_rad_s: Array) -> Array:
        """One physics step of the rotors; returns the torque (n,) of the gear springs on the links [Nm]."""
        gear = self.gear_nm = self._stiffness * (self.play + self._cycle - q_rad) + self._damping * (
            self.omega - qd_rad_s
        )
        free = self.omega * self._keep + (self.u_nm - gear) * self._rate
        lost = self._lost
        self.omega = (free - np.minimum(np.maximum(free, -lost), lost)) * self.live + self._sink
        self.theta = self.theta + self.omega * self._step_s
        self.play = np.minimum(np.maximum(self.play, self.theta - self._half), self.theta + self._half)
        return gear

    def show(self) -> None:
        """Hand the encoders' angles and speeds to the drives."""
        for axis, theta, omega in zip(self.axes, self.theta.tolist(), self.omega.tolist(), strict=True):
            axis.position_rad, axis.omega_rad_s = theta - axis.shift_rad, omega


def _servo(train: DriveTrain, i: int, max_rad_s: float) -> ServoLoop:
    gains = ServoGains(
        position_1_s=(1.0 - FEEDFORWARD) / float(train.lag_s[i]),
        speed_nm_s_rad=SPEED_BANDWIDTH_RAD_S * float(train.rotor_kg_m2[i]),
        reset_time_s=RESET_S,
        feedforward=FEEDFORWARD,
        window_rad=WINDOW_RAD,
    )
    return ServoLoop(gains, 3.0 * float(train.rated_nm[i]), max_rad_s)
