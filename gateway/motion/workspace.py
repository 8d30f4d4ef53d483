"""Where the arm may stand and move: joint limits, keep-out boxes, torque limits. Pure and vectorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.config import ArmConfig
from gateway.errors import ConfigError
from gateway.model.kinematics import link_frames
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot

#: Share of each torque limit that holding the arm may take; bare at rest poses, the rest is left to an unknown load.
TORQUE_SHARE = 0.9
TORQUE_SHARE_BARE = 0.5
#: Largest joint step between two checked points of a path.
PATH_STEP_RAD = 0.05
#: Points between two joint origins that are checked against the boxes.
POINTS_PER_LINK = 3
BOX_TOLERANCE_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """Limits of one arm.

    Attributes
    ----------
    robot : Robot
    gravity_m_s2 : array of shape (3,)
    lower_rad, upper_rad : arrays of shape (6,)
        The tighter of the cell's and the robot's own limits.
    speed_rad_s, acceleration_rad_s2, jerk_rad_s3 : arrays of shape (6,)
    torque_nm : array of shape (6,)
        Joint-side limit of what the motors give, gear losses not included.
    efficiency : array of shape (6,)
    following_error_rad : array of shape (6,)
    boxes_m : array of shape (k, 2, 3)
        Lower and upper corners of the keep-out boxes, base frame.
    points_m : array of shape (p, 3)
        Points in link 6 that stay out of the boxes: the flange and the corners of the load.
    links : array of shape (24,) or None
        Mass and first moment of every link; None = not known, torque is then not checked.
    max_load : array of shape (4,) or None
        Mass [kg] and first moment [kg m] of the heaviest load in link 6.
    """

    robot: Robot
    gravity_m_s2: np.ndarray
    lower_rad: np.ndarray
    upper_rad: np.ndarray
    speed_rad_s: np.ndarray
    acceleration_rad_s2: np.ndarray
    jerk_rad_s3: np.ndarray
    torque_nm: np.ndarray
    efficiency: np.ndarray
    following_error_rad: np.ndarray
    boxes_m: np.ndarray
    points_m: np.ndarray
    links: np.ndarray | None
    max_load: np.ndarray | None

    @property
    def rest_share(self) -> float:
        """Share of the torque limits that rest poses may use."""
        return TORQUE_SHARE_BARE if self.max_load is None else TORQUE_SHARE

    def violations(
        self, q_rad: np.ndarray, margin_rad: float = 0.0, torque_share: float = TORQUE_SHARE
    ) -> list[tuple[str, np.ndarray]]:
        """What stands against each posture.

        Parameters
        ----------
        q_rad : array of shape (n, 6)
        margin_rad : float
            Distance to keep from every joint limit.
        torque_share : float
            Share of each torque limit that holding the posture may take.

        Returns
        -------
        list of (words, bool array of shape (n,))
            One entry per joint limit, box and torque limit.
        """
        outside = (q_rad < self.lower_rad + margin_rad) | (q_rad > self.upper_rad - margin_rad)
        found = [
            (
                f"joint {i + 1} outside [{self.lower_rad[i]:.3f}, {self.upper_rad[i]:.3f}] rad"
                + (f" less {margin_rad:.3f} rad for the approach" if margin_rad else ""),
                outside[:, i],
            )
            for i in range(6)
        ]
        points = body_points(self.robot, q_rad, self.points_m)
        for number, (low, high) in enumerate(self.boxes_m, start=1):
            inside = (points > low + BOX_TOLERANCE_M) & (points < high - BOX_TOLERANCE_M)
            found.append((f"a point of the arm or load in keep_out box {number}", inside.all(axis=2).any(axis=1)))
        torque = self.holding_torque(q_rad)
        if torque is not None:
            usable = self.torque_nm * torque_share
            words = "holding torque of joint {} above {:.0%} of its limit"
            found += [(words.format(i + 1, torque_share), torque[:, i] > usable[i]) for i in range(6)]
        return found

    def feasible(self, q_rad: np.ndarray, margin_rad: float = 0.0, torque_share: float = TORQUE_SHARE) -> np.ndarray:
        """Whether the arm may be there: bool array of shape (n,)."""
        return ~np.any([mask for _, mask in self.violations(q_rad, margin_rad, torque_share)], axis=0)

    def why_not(self, q_rad: np.ndarray, torque_share: float = TORQUE_SHARE) -> str | None:
        """First thing that stands against one posture (6,); None = feasible."""
        found = self.violations(q_rad[None], torque_share=torque_share)
        return next((words for words, mask in found if mask[0]), None)

    def holding_torque(self, q_rad: np.ndarray) -> np.ndarray | None:
        """Largest motor-driven torque (n, 6) [Nm] that holding the posture takes, bare or with the heaviest load."""
        if self.links is None:
            return None
        rows = gravity_regressor(self.robot, q_rad, self.gravity_m_s2)
        torque = np.abs(rows @ self.links)
        if self.max_load is not None:
            torque = np.maximum(torque, np.abs(rows @ self.links + rows[:, :, 20:24] @ self.max_load))
        return torque / self.efficiency

    def path_clear(self, start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
        """Whether straight joint motions from start (n, 6) to end (n, 6) stay feasible: bool array of shape (n,)."""
        span = np.abs(end_rad - start_rad).max(axis=1)
        clear = np.ones(len(span), dtype=bool)
        for path in range(len(span)):
            along = path_points(start_rad[path], end_rad[path])
            clear[path] = bool(self.feasible(along).all())
        return clear

    def travel_time(self, start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
        """Estimate [s] of the time of straight motions (..., 6): slowest axis at full speed plus its ramp."""
        step = np.abs(end_rad - start_rad)
        ramp = self.speed_rad_s / self.acceleration_rad_s2
        return (step / self.speed_rad_s).max(axis=-1) + ramp.max()


def path_points(start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
    """Points (k, 6) of a straight joint motion, at most `PATH_STEP_RAD` apart, both ends included."""
    count = int(np.ceil(np.abs(end_rad - start_rad).max() / PATH_STEP_RAD)) + 2
    return start_rad + np.linspace(0.0, 1.0, count)[:, None] * (end_rad - start_rad)


def body_points(robot: Robot, q_rad: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Points of the arm beyond link 1 in the base frame [m].

    Parameters
    ----------
    robot : Robot
    q_rad : array of shape (n, 6)
    points_m : array of shape (p, 3)
        Further points in link 6.

    Returns
    -------
    array of shape (n, points, 3)
        Origins of joints 3 to 6, points along the links between them and from joint 2, and the points of link 6.
        Base and link 1 cannot be moved out of a box and are left out.
    """
    frames = link_frames(robot, q_rad)
    origins = frames[:, 1:, :3, 3]
    carried = frames[:, 5, None, :3, 3] + np.einsum("nij,pj->npi", frames[:, 5, :3, :3], points_m)
    ends = np.concatenate([origins[:, 1:], carried[:, :1]], axis=1)
    share = np.arange(1, POINTS_PER_LINK + 1) / (POINTS_PER_LINK + 1)
    between = origins[:, :, None] + share[:, None] * (ends - origins)[:, :, None]
    between = between.reshape(len(q_rad), origins.shape[1] * POINTS_PER_LINK, 3)
    return np.concatenate([origins[:, 1:], between, carried], axis=1)


def workspace_of(arm: ArmConfig, robot: Robot) -> Workspace:
    """Limits of a configured arm.

    Raises
    ------
    ConfigError
        The cell's joint limits and those of the robot model have nothing in common.
    """
    limits = np.array([axis.position_limit_rad for axis in arm.axis])
    lower, upper = np.maximum(limits[:, 0], robot.lower_rad), np.minimum(limits[:, 1], robot.upper_rad)
    for joint in np.flatnonzero(lower >= upper):
        raise ConfigError(
            f"arm '{arm.name}', axis {joint + 1}: position_limit_rad {limits[joint].tolist()} and the limits "
            f"[{robot.lower_rad[joint]:.3f}, {robot.upper_rad[joint]:.3f}] rad of the robot model do not overlap"
        )
    flange = np.zeros(3) if robot.flange is None else robot.flange[:3, 3]
    load_com = flange if arm.max_load_com_m is None else np.array(arm.max_load_com_m)
    known = arm.inertials != "ignore" and bool(np.isfinite(robot.mass_kg).all() and np.isfinite(robot.com_m).all())
    moments = np.column_stack([robot.mass_kg, robot.mass_kg[:, None] * robot.com_m]).ravel()
    return Workspace(
        robot=robot,
        gravity_m_s2=np.array(arm.gravity_m_s2),
        lower_rad=lower,
        upper_rad=upper,
        speed_rad_s=np.array([axis.speed_limit_rad_s for axis in arm.axis]),
        acceleration_rad_s2=np.array([axis.acceleration_rad_s2 for axis in arm.axis]),
        jerk_rad_s3=np.array([axis.jerk_rad_s3 for axis in arm.axis]),
        torque_nm=np.array([axis.torque_limit_nm for axis in arm.axis]),
        efficiency=np.array([axis.gear_efficiency.value for axis in arm.axis]),
        following_error_rad=np.array([axis.following_error_limit_rad for axis in arm.axis]),
        boxes_m=np.array([(box.min_m, box.max_m) for box in arm.keep_out]).reshape(-1, 2, 3),
        points_m=np.vstack([flange, *arm.load_points_m]),
        links=moments if known else None,
        max_load=None if arm.max_load_kg is None else arm.max_load_kg * np.concatenate([[1.0], load_com]),
    )
