"""From gripper commands to joint targets and from joint torques to wrenches, prepared for a whole path."""

from __future__ import annotations

import math

import numpy as np

from gateway.data.sample import ArmSample
from gateway.errors import PlanRefused
from gateway.pair.cell import PairArm
from gateway.pair.force import dead_band
from gateway.pair.inverse import SINGULAR
from gateway.pair.transform import Floats, correction_between

#: Joint speed at which dry friction has nearly reached its full size [rad/s].
FRICTION_SPEED_RAD_S = 0.01
#: SYNCs that follow each other sooner than this share of a period do not tell an acceleration.
SHORT_PERIODS = 0.5
#: How far a command may lie from the prepared path; further away the prepared Jacobians no longer hold.
LARGEST_OFFSET = 0.03


class JointFollower:
    """Joint targets of one arm for gripper commands close to a prepared path.

    Parameters
    ----------
    arm : PairArm
    q_rad : array of shape (M, 6)
        Joint angles of the prepared path.

    Attributes
    ----------
    jacobian : array of shape (M, 6, 6)
    """

    def __init__(self, arm: PairArm, q_rad: Floats) -> None:
        self.arm = arm
        self.q_rad = q_rad
        self.poses, self.jacobian = arm.chain.poses(q_rad)
        self._inverse = np.linalg.inv(self.jacobian)

    def joints(self, m: int, command: Floats) -> Floats:
        """Joint angles (6,) [rad] for a command (4, 4) near pose m of the path: two Newton steps, exact to micrometres.

        Raises
        ------
        PlanRefused
            The command lies more than 30 mm or 30 mrad off the path.
        """
        away = correction_between(command, self.poses[m])
        if np.abs(away).max() > LARGEST_OFFSET:
            raise PlanRefused(
                f"arm '{self.arm.config.name}', command {m + 1}: it lies {1e3 * np.abs(away).max():.0f} mm or mrad off"
                " the nominal path; the function or a correction has run away"
            )
        q = self.q_rad[m] + self._inverse[m] @ away
        rest = correction_between(command, self.arm.chain.poses(q[None])[0][0])
        return q + self._inverse[m] @ rest


class WrenchFromTorque:
    """Wrench on one gripper from the torques of its arm along a path (CN104379308 [0063]).

    What the drives report belongs to where the arm was when it was sampled: one cycle and the servos' lag behind the
    command. Next to standstill dry friction may have any value inside its band, so the band is a dead band there.

    Parameters
    ----------
    arm : PairArm
    follower : JointFollower
    dt_s : control cycle
    lag_s : servo lag
    cutoff_hz : of the low-pass

    Attributes
    ----------
    count : commands of the path
    """

    def __init__(self, arm: PairArm, follower: JointFollower, dt_s: float, lag_s: float, cutoff_hz: float) -> None:
        self.count = len(follower.q_rad)
        self._share = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt_s)
        late = np.maximum(np.arange(len(follower.q_rad)) - (1.0 + lag_s / dt_s), 0.0)
        every = np.arange(len(late))
        q = np.stack([np.interp(late, every, column) for column in follower.q_rad.T], axis=1)
        moving = (late > 0.0)[:, None]
        qd = np.gradient(q, dt_s, axis=0) * moving
        turned = np.tanh(qd / FRICTION_SPEED_RAD_S)
        free = arm.model_torque(q, qd, np.zeros_like(q))
        self._known = free + arm.coulomb_nm * turned + arm.viscous_nm_s_rad * qd
        self._still = arm.model_torque(q, np.zeros_like(q), np.zeros_like(q))
        self._product = free - self._still
        self._dt_s, self._coulomb, self._viscous = dt_s, arm.coulomb_nm, arm.viscous_nm_s_rad
        self._mass = arm.mass_matrix(q)
        self._band = arm.coulomb_nm * (1.0 - np.abs(turned))
        jacobian = arm.chain.poses(q)[1]
        least = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
        if least.min() < SINGULAR:
            raise PlanRefused(
                f"arm '{arm.config.name}', command {int(np.argmin(least)) + 1}: the force is not observable, smallest"
                f" singular value {least.min():.3f}, at least {SINGULAR} is needed; move the path or the base"
            )
        self._map = -np.linalg.inv(np.swapaxes(jacobian, 1, 2))
        self.wrench: Floats | None = None
        #: External joint torque (6,) [Nm] of the SYNC before, not filtered.
        self.external_nm: Floats | None = None
        self._last: ArmSample | None = None
        self._before: ArmSample | None = None

    def reset(self) -> None:
        """Forget the filter's state."""
        self.wrench = self.external_nm = self._last = self._before = None

    def wrench_of(self, external_nm: Floats, m: int = 0) -> Floats:
        """Wrench (6,) of an external joint torque (6,) [Nm] at command m, friction already out of it."""
        return self._map[m] @ external_nm

    def _expected(self, at: int, rate: float, speed_rad_s: Floats) -> tuple[Floats, Floats]:
        """Torque (6,) of a free motion without its acceleration, and what is left of the friction band (6,).

        While time along the path is slowed down the arm lags behind it: friction is that of the speed (6,) it has.
        """
        if rate == 1.0:
            return self._known[at], self._band[at]
        turned = np.tanh(speed_rad_s / FRICTION_SPEED_RAD_S)
        known = self._still[at] + rate**2 * self._product[at] + self._coulomb * turned + self._viscous * speed_rad_s
        return known, self._coulomb * (1.0 - np.abs(turned))

    def update(self, m: int, sample: ArmSample, rate: float = 1.0) -> None:
        """Take in what was measured at the SYNC of command m; an incomplete sample leaves the last wrench, and so do
        SYNCs that were held up and then followed each other too soon.

        `rate` is how fast time passes along the path.

        The wrench is that of the SYNC before: only now the acceleration there is known from the encoders. With that of
        the commands in its place the loop would answer the torque by which its own corrections move the arm.
        """
        before, last = self._before, self._last
        self._before, self._last = (last, sample) if sample.complete else (None, None)
        self.external_nm = None
        if not sample.complete or last is None or before is None:
            return
        at = max(m - 1, 0)
        # by the instants of the SYNCs: at 4 ms, one that is 0.1 ms off feigns an acceleration of six times the speed
        first_s, second_s = last.time_s - before.time_s, sample.time_s - last.time_s
        if min(first_s, second_s) < SHORT_PERIODS * self._dt_s:
            return
        first, second = (last.q_rad - before.q_rad) / first_s, (sample.q_rad - last.q_rad) / second_s
        inertia = self._mass[at] @ (2.0 * (second - first) / (first_s + second_s))
        known, band = self._expected(at, rate, (sample.q_rad - before.q_rad) / (first_s + second_s))
        rest = self.external_nm = last.joint_torque_nm - known - inertia
        external = dead_band(rest, band)
        fresh = self._map[at] @ external
        self.wrench = fresh if self.wrench is None else self.wrench + self._share * (fresh - self.wrench)
