"""A prepared trajectory of both arms, and its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.pair.balance import ForceBalance
from gateway.pair.calibration import PathWrenches
from gateway.pair.internal_force import InternalForce
from gateway.pair.joint_targets import ExternalTorque, JointFollower
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats

Pair = tuple[Floats, Floats]
#: From the index of a command and both filtered wrenches (None before the first) to both gripper commands.
Commander = Callable[[int, Floats | None, Floats | None], Pair]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTrajectory:
    """A trajectory with everything precomputed for it.

    Attributes
    ----------
    path : PairPath
        Of the master.
    joints, followers : joint angles (M, N) of each arm by the nominal relation, and followers for targets near them
    torques, maps, balance : external torques, wrenches along the trajectory, and the internal force from both
    speed_rad_s, acceleration_rad_s2 : arrays of shape (M, J), both arms' joints in one row
        Of the nominal trajectories.
    free_nm : torque (M, N) of each arm in a free motion
    """

    path: PairPath
    joints: Pair
    followers: tuple[JointFollower, JointFollower]
    torques: tuple[ExternalTorque, ExternalTorque]
    maps: PathWrenches
    balance: ForceBalance
    speed_rad_s: Floats
    acceleration_rad_s2: Floats
    free_nm: Pair

    def targets(self, m: int, commands: Pair) -> Pair:
        """Joint targets of both arms for the gripper commands of index m."""
        first, second = self.followers
        return first.joints(m, commands[0]), second.joints(m, commands[1])


@dataclass(frozen=True, slots=True, eq=False)
class Streamed:
    """Result of a trajectory.

    Attributes
    ----------
    force : array of shape (M, 6)
        Internal wrench about the part's centre, world axes, low-passed [N, Nm].
    internal_force : InternalForce or None
        The same after completion, with its covariance; None without a common part.
    gaps_m : array of shape (M, n)
        Distances less the demanded ones [m], NaN where a cycle had no value; n = 0 without sensors.
    complete : every epoch was complete
    evaluation_s : mean time that one command took to compute
    """

    force: Floats
    internal_force: InternalForce | None
    gaps_m: Floats
    complete: bool
    evaluation_s: float
