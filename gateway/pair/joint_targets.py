"""Convert gripper commands to joint targets and joint torques to wrenches, precomputed for a path.

Dry friction at reversals (presliding) is here too: its direction, and the torque offset that compensates it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from gateway.data.visit import ArmSample
from gateway.errors import PlanRefused
from gateway.pair.inverse import SINGULAR, turns
from gateway.pair.pair_cell import PairArm
from gateway.pair.transform import Floats, correction_between

#: SYNCs closer than this share of a period give no usable acceleration.
SHORT_PERIODS = 0.5
#: Largest distance of a command from the prepared path; further away the prepared Jacobians no longer hold.
LARGEST_OFFSET = 0.03


class JointFollower:
    """Joint targets of one arm for gripper commands close to a prepared path.

    Parameters
    ----------
    arm : PairArm
    q_rad : array of shape (M, N)
        Joint angles of the prepared path.

    Attributes
    ----------
    jacobian : array of shape (M, 6, N)
    """

    def __init__(self, arm: PairArm, q_rad: Floats) -> None:
        self.arm = arm
        self.q_rad = q_rad
        self.poses, self.jacobian = arm.chain.poses(q_rad)
        self._inverse = turns(self.jacobian, np.eye(6))

    def joints(self, m: int, command: Floats) -> Floats:
        """Joint angles (N,) [rad] for a command (4, 4) near pose m of the path: two Newton steps, exact to micrometres.

        Raises
        ------
        PlanRefused
            The command deviates more than 30 mm or 30 mrad from the path.
        """
        away = correction_between(command, self.poses[m])
        if np.abs(away).max() > LARGEST_OFFSET:
            raise PlanRefused(
                f"arm '{self.arm.config.name}', command {m + 1}: it is {1e3 * np.abs(away).max():.0f} mm or mrad off"
                " the nominal path; the function or a correction diverges: teach again"
            )
        q = self.q_rad[m] + self._inverse[m] @ away
        rest = correction_between(command, self.arm.chain.poses(q[None])[0][0])
        return q + self._inverse[m] @ rest


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """Observations of one arm at one SYNC; arrays of shape (N,).

    Attributes
    ----------
    external_nm : joint torque that a free motion with the cell's constants does not need
    turned : direction of dry friction, from -1 to 1; between them it is not settled
    speed_rad_s, acceleration_rad_s2 : of the joints, measured
    """

    external_nm: Floats
    turned: Floats
    speed_rad_s: Floats
    acceleration_rad_s2: Floats


class ExternalTorque:
    """External joint torques of one arm: measured torque less that of its own motion along a path.

    Readings of the drives belong to the posture at sampling time: one cycle and the servo lag behind the command.
    Friction is that of the measured motion.

    Parameters
    ----------
    arm : PairArm
    follower : JointFollower
    dt_s : control cycle
    lag_s : servo lag

    Attributes
    ----------
    arm : PairArm
    delay : array of shape (M,)
        Command (not rounded) at which the arm is when command m is sent.
    q_rad, speed_rad_s, acceleration_rad_s2 : arrays of shape (M, N)
        Of the nominal motion, with that delay.
    jacobian : array of shape (M, 6, N)
    """

    def __init__(self, arm: PairArm, follower: JointFollower, dt_s: float, lag_s: float) -> None:
        self.arm = arm
        every = np.arange(len(follower.q_rad))
        self.delay = np.maximum(every - (1.0 + lag_s / dt_s), 0.0)
        self.q_rad = q = np.stack([np.interp(self.delay, every, column) for column in follower.q_rad.T], axis=1)
        self.speed_rad_s = qd = np.gradient(q, dt_s, axis=0) * (self.delay > 0.0)[:, None]
        self.acceleration_rad_s2 = np.gradient(qd, dt_s, axis=0)
        still = np.zeros_like(q)
        self._still = arm.model_torque(q, still, still)
        self._product = arm.model_torque(q, qd, still) - self._still
        self._dt_s = dt_s
        self._mass = arm.mass_matrix(q)
        self.jacobian = arm.chain.poses(q)[1]
        least = np.linalg.svd(self.jacobian, compute_uv=False)[:, -1]
        if least.min() < SINGULAR:
            raise PlanRefused(
                f"arm '{arm.config.name}', command {int(np.argmin(least)) + 1}: the force is not observable, smallest"
                f" singular value {least.min():.3f}, at least {SINGULAR} is needed; move the path or the base"
            )
        self.reset()

    def reset(self) -> None:
        """Reset the history."""
        self._last: ArmSample | None = None
        self._before: ArmSample | None = None
        self._presliding = Presliding(self.arm.axes, self._dt_s)

    def update(self, m: int, sample: ArmSample, rate: float = 1.0) -> Shown | None:
        """Take in what was measured at the SYNC of command m; what the SYNC before it showed.

        Only now is the acceleration there available from the encoders. With commanded accelerations the loop would
        react to the torque of its own corrections. None for an incomplete sample, and for SYNCs that were delayed and
        then followed each other too soon.

        `rate` is how fast time passes along the path.
        """
        before, last = self._before, self._last
        self._before, self._last = (last, sample) if sample.complete else (None, None)
        turned = self._presliding.turned
        if not sample.complete:
            return None
        if last is not None:
            self._presliding.move(sample.q_rad - last.q_rad)
        if last is None or before is None:
            return None
        at = max(m - 1, 0)
        # by the instants of the SYNCs: at 4 ms, one that is 0.1 ms off feigns an acceleration of six times the speed
        first_s, second_s = last.time_s - before.time_s, sample.time_s - last.time_s
        if min(first_s, second_s) < SHORT_PERIODS * self._dt_s:
            return None
        first, second = (last.q_rad - before.q_rad) / first_s, (sample.q_rad - last.q_rad) / second_s
        speed = (sample.q_rad - before.q_rad) / (first_s + second_s)
        acceleration = 2.0 * (second - first) / (first_s + second_s)
        rubbing = self.arm.coulomb_nm * turned + self.arm.viscous_nm_s_rad * speed
        free = self._still[at] + rate**2 * self._product[at] + self._mass[at] @ acceleration
        return Shown(last.joint_torque_nm - free - rubbing, turned, speed, acceleration)


#: Angle by which a joint has to turn until dry friction has reached two thirds of its full size [rad].
PRESLIDING_RAD = 5e-5
#: The same for the torque that makes up for it, sooner: the gear is wound up before the joint turns [rad].
OFFSET_RAD = 1e-5
#: A joint slower than this is at rest [rad/s]. It may hold its friction, or the drive releases it, by an integrator or
#: by trembling: no more than this share is counted on, after this time [s].
REST_SPEED_RAD_S, REST_SHARE, LET_GO_S = 2e-4, 0.5, 0.1


def dahl(turned: Floats, moved_rad: Floats, over_rad: float) -> Floats:
    """Return the share of dry friction (n,), from -1 to 1, after displacements (n,) [rad]: Dahl's model.

    Over a displacement d towards s it moves by the share `1 - exp(-d/over_rad)` of the difference to s.
    """
    towards = np.sign(moved_rad)
    return towards - (towards - turned) * np.exp(-np.abs(moved_rad) / over_rad)


class Presliding:
    """Direction of dry friction of n joints, from their displacement since the last reversal.

    The speed of a joint does not matter: friction stays constant until the joint is at rest. Then half of it is
    uncertain.

    Parameters
    ----------
    joints : n
    dt_s : between two moves

    Attributes
    ----------
    turned : array of shape (n,)
        From -1 to 1; 0 = direction unknown.
    """

    def __init__(self, joints: int, dt_s: float) -> None:
        self.turned = np.zeros(joints)
        self._at_rest_rad, self._lost = REST_SPEED_RAD_S * dt_s, 1.0 - math.exp(-dt_s / LET_GO_S)

    def move(self, moved_rad: Floats) -> None:
        """Update with the displacements (n,) [rad] of the joints."""
        turned, displacement = dahl(self.turned, moved_rad, PRESLIDING_RAD), np.abs(moved_rad)
        surplus = turned - np.clip(turned, -REST_SHARE, REST_SHARE)
        self.turned = turned - np.where(displacement < self._at_rest_rad, self._lost * surplus, 0.0)


class FrictionOffset:
    """Joint torque of the cell's friction constants, for the targets that the servos reach at this cycle.

    A joint that comes to rest keeps its offset, because friction keeps its direction until the targets reverse.

    Parameters
    ----------
    arm : PairArm
    dt_s : control cycle
    lag_s : by which the axes follow their setpoints
    """

    def __init__(self, arm: PairArm, dt_s: float, lag_s: float) -> None:
        self._arm, self._dt_s = arm, dt_s
        self._targets: deque[Floats] = deque(maxlen=2 + round(lag_s / dt_s))
        self._turned = np.zeros_like(arm.coulomb_nm)

    def at(self, q_rad: Floats) -> Floats:
        """Torque (N,) [Nm] beside the next targets (N,) [rad]; zero before the first move."""
        self._targets.append(q_rad)
        if len(self._targets) < 2:
            return np.zeros_like(q_rad)
        displacement = self._targets[1] - self._targets[0]
        self._turned = dahl(self._turned, displacement, OFFSET_RAD)
        return self._arm.coulomb_nm * self._turned + self._arm.viscous_nm_s_rad * displacement / self._dt_s
