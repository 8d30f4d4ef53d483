"""Share of each limit of an arm that an excitation trajectory uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig
from gateway.excite.excitation import Excitation
from gateway.feedforward.identified import AxisConstants
from gateway.feedforward.load import FeedLoad
from gateway.model.kinematics import joint_axes_origins, link_frames
from gateway.model.regressor import regressor
from gateway.model.robot import Robot
from gateway.motion.drive_limits import dry_friction_nm, links_with_loads, possible_loads
from gateway.motion.workspace import TORQUE_SHARE, TORQUE_SHARE_BARE, Workspace

Floats = NDArray[np.float64]
KINDS = ("position", "speed", "acceleration", "jerk", "torque")
LOAD_ACCELERATION = "load acceleration"


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins of the limits: `range_rad` at both ends, and the usable share of each other limit."""

    range_rad: float
    speed: float
    acceleration: float
    jerk: float
    torque: float


#: Hard limits.
HELD = Margins(range_rad=0.0, speed=1.0, acceleration=1.0, jerk=1.0, torque=1.0)
#: Limits of planning. Moves between poses use the same share of the speed, rest poses the same distance.
PLANNED = Margins(range_rad=0.02, speed=0.95, acceleration=0.95, jerk=0.95, torque=0.97)


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """States of an arm at instants of one or several motions, arrays of shape (..., N).

    Attributes
    ----------
    q_rad, qd_rad_s, qdd_rad_s2, jerk_rad_s3 : arrays of shape (..., N)
    """

    q_rad: Floats
    qd_rad_s: Floats
    qdd_rad_s2: Floats
    jerk_rad_s3: Floats


def states_of(excitation: Excitation, step_s: float) -> States:
    """Return the states of one period, sampled every `step_s`; jerk is the difference quotient of the acceleration."""
    motion = excitation.motion(step_s)
    before = np.vstack([np.zeros_like(motion.qdd_rad_s2[:1]), motion.qdd_rad_s2[:-1]])
    return States(motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2, (motion.qdd_rad_s2 - before) / step_s)


@dataclass(frozen=True, slots=True, eq=False)
class MovingLimits:
    """Limits of one arm for a motion.

    Attributes
    ----------
    workspace : Workspace
    middle_rad, half_rad : arrays of shape (N,)
        Range of each joint.
    speed_rad_s, acceleration_rad_s2, jerk_rad_s3, torque_nm : arrays of shape (N,)
    bodies : array of shape (10 N, k) or None
        Parameters of the links without and with every load that may be mounted; None = links not known, torque not
        checked.
    lost : array of shape (N,)
        Motor torque divided by transmitted torque, without Coulomb and viscous friction.
    rotor_kg_m2, coulomb_nm, viscous_nm_s_rad : arrays of shape (N,)
        At the joint; 0 where not known.
    load_point_m : array of shape (3,)
        Centre of gravity of the load in the last link.
    load_acceleration_m_s2 : float
        Largest acceleration of the load; infinite where the cell file gives none.
    unchecked : tuple of str
        Parts of the torque that are not known and not checked.
    """

    workspace: Workspace
    middle_rad: Floats
    half_rad: Floats
    speed_rad_s: Floats
    acceleration_rad_s2: Floats
    jerk_rad_s3: Floats
    torque_nm: Floats
    bodies: Floats | None
    lost: Floats
    rotor_kg_m2: Floats
    coulomb_nm: Floats
    viscous_nm_s_rad: Floats
    load_point_m: Floats
    load_acceleration_m_s2: float
    unchecked: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of `shares`, such as "speed of J3" and "load acceleration"."""
        axes = range(1, self.workspace.robot.axes + 1)
        return (*(f"{kind} of J{axis}" for kind in KINDS for axis in axes), LOAD_ACCELERATION)

    def shares(self, states: States, rigid: Floats | None = None) -> Floats:
        """Return the share of each limit at every instant; a value above 1 violates it.

        Parameters
        ----------
        states : States
            Arrays of shape (n, N).
        rigid : array of shape (n, N, 10 N), optional
            Full regressor at these states, if already computed.

        Returns
        -------
        array of shape (n, 5 N + 1)
            Columns as `names`.
        """
        torque = self._torque_nm(states, rigid)
        load = np.zeros((len(states.q_rad), 1))
        if np.isfinite(self.load_acceleration_m_s2):
            robot = self.workspace.robot
            load[:, 0] = np.linalg.norm(point_acceleration_m_s2(robot, states, self.load_point_m), axis=1)
            load /= self.load_acceleration_m_s2
        return np.hstack(
            [
                np.abs(states.q_rad - self.middle_rad) / self.half_rad,
                np.abs(states.qd_rad_s) / self.speed_rad_s,
                np.abs(states.qdd_rad_s2) / self.acceleration_rad_s2,
                np.abs(states.jerk_rad_s3) / self.jerk_rad_s3,
                torque / self.torque_nm,
                load,
            ]
        )

    def _torque_nm(self, states: States, rigid: Floats | None) -> Floats:
        """Return the largest motor torque (n, N) [Nm, at the joint] without or with a load; 0 if unknown."""
        if self.bodies is None:
            return np.zeros_like(states.q_rad)
        if rigid is None:
            workspace = self.workspace
            q, qd, qdd = states.q_rad, states.qd_rad_s, states.qdd_rad_s2
            rigid = regressor(workspace.robot, q, qd, qdd, workspace.gravity_m_s2)
        carried = np.abs(rigid @ self.bodies).max(axis=2) * self.lost
        friction = self.coulomb_nm + self.viscous_nm_s_rad * np.abs(states.qd_rad_s)
        return carried + friction + self.rotor_kg_m2 * np.abs(states.qdd_rad_s2)


def moving_limits(
    arm: ArmConfig,
    workspace: Workspace,
    known: Sequence[AxisConstants],
    margins: Margins = HELD,
    load: FeedLoad | None = None,
) -> MovingLimits:
    """Return the limits of a configured arm for a motion.

    Parameters
    ----------
    arm : ArmConfig
    workspace : Workspace
    known : sequence of AxisConstants, one per axis
        Rotors and friction.
    margins : Margins
    load : FeedLoad, optional
        Load to be mounted; the rated and the heaviest load of the cell if absent.

    Notes
    -----
    `TORQUE_SHARE` of the torque limit is usable if the load is known, else `TORQUE_SHARE_BARE`: the rest is reserved
    for an unknown load, as at rest.
    """
    loads = possible_loads(workspace, arm) if load is None else (load,)
    bodies = links_with_loads(workspace, arm, loads)
    unchecked = () if bodies is not None else ("torque: mass, centre of mass or inertia of a link is not known",)
    rotors = [axis.rotor_kg_m2 for axis in known]
    missing = ", ".join(f"J{joint}" for joint, rotor in enumerate(rotors, start=1) if rotor is None)
    if missing:
        unchecked = (*unchecked, f"rotor inertia of {missing}: neither identified nor stated in the cell file")
    share = margins.torque * (TORQUE_SHARE if loads else TORQUE_SHARE_BARE)
    most = arm.load_acceleration_m_s2
    return MovingLimits(
        workspace=workspace,
        middle_rad=(workspace.upper_rad + workspace.lower_rad) / 2,
        half_rad=np.maximum((workspace.upper_rad - workspace.lower_rad) / 2 - margins.range_rad, 1e-9),
        speed_rad_s=margins.speed * workspace.speed_rad_s,
        acceleration_rad_s2=margins.acceleration * workspace.acceleration_rad_s2,
        jerk_rad_s3=margins.jerk * workspace.jerk_rad_s3,
        torque_nm=share * workspace.torque_nm,
        bodies=bodies,
        rotor_kg_m2=np.array([0.0 if rotor is None else rotor.value for rotor in rotors]),
        lost=np.array([1.0 + axis.load_friction for axis in known]) / workspace.efficiency,
        coulomb_nm=dry_friction_nm(arm, known),
        viscous_nm_s_rad=np.array(
            [0.0 if one is None else one.value for one in (axis.viscous_nm_s_rad for axis in known)]
        ),
        load_point_m=loads[-1].com_m if loads else workspace.points_m[0],
        load_acceleration_m_s2=np.inf if most is None else margins.acceleration * most,
        unchecked=unchecked,
    )


def point_acceleration_m_s2(robot: Robot, states: States, point_m: Floats) -> Floats:
    """Return the acceleration (n, 3) [m/s2] of a point (3,) [m] of the last link, base frame, without gravity.

    Computed from link to link, starting at the base (Featherstone 2008, section 2.2).
    """
    axes, origins = joint_axes_origins(robot, states.q_rad)
    last = link_frames(robot, states.q_rad)[:, -1]
    ends = np.concatenate([origins[:, 1:], (last[:, :3, :3] @ point_m + last[:, :3, 3])[:, None]], axis=1)
    turning, turning_rate = np.zeros((len(axes), 3)), np.zeros((len(axes), 3))
    found = np.zeros((len(axes), 3))
    for joint in range(robot.axes):
        spin = axes[:, joint] * states.qd_rad_s[:, joint, None]
        turning_rate = turning_rate + axes[:, joint] * states.qdd_rad_s2[:, joint, None] + np.cross(turning, spin)
        turning = turning + spin
        arm = ends[:, joint] - origins[:, joint]
        found = found + np.cross(turning_rate, arm) + np.cross(turning, np.cross(turning, arm))
    return found
