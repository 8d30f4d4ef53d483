"""Check postures, paths and start postures of an arm for joint limits, collisions and torque limits; pure functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gateway.cell.config import ArmConfig
from gateway.errors import ConfigError, PlanRefused, WrongPlace
from gateway.identify.links import body_parameters, link_values
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor, regressor
from gateway.model.robot import Robot
from gateway.motion.clearance import PATH_RESOLUTION_M, Space, space_of
from gateway.motion.joint_path import angles, path_points, path_positions, postures_at

#: Share of each torque limit for holding the arm, and for holding the unloaded arm at rest poses: the rest is for the
#: load.
TORQUE_SHARE = 0.9
TORQUE_SHARE_BARE = 0.5
#: Number of postures per batch.
BLOCK = 20_000
#: Largest distance outside the joint range from which an arm may move back, and the margin inside it [rad].
MOST_OUTSIDE_RAD = 0.35
INWARD_MARGIN_RAD = 0.02
#: Half-width of a friction band as a share of the torque limit, until a recording has measured it.
BAND_SHARE = 0.013
#: Acceleration that the torque limit of a motor gives to its own rotor, at the joint; assumed [rad/s2].
ROTOR_ACCELERATION_RAD_S2 = 30.0
#: Share of each torque limit for holding and accelerating the arm: the rest is for friction and errors of the masses.
TORQUE_SHARE_MOVING = 0.95
#: Least and largest share of each torque limit for accelerating it: a larger jump of the torque counts as a contact.
TORQUE_SHARE_ACCELERATING = (0.02, 0.2)
#: Speed of that motion: share of the speed limit, and upper limit [rad/s].
INWARD_SHARE = 0.1
INWARD_SPEED_RAD_S = 0.05
#: By how much a velocity may be rounded down in a URDF.
ROUNDED = 1e-3
TOO_CLOSE = f"the arm passes an obstacle at less than {500 * PATH_RESOLUTION_M:g} mm"
#: A motion out of a violation is searched with one joint: step and largest motion [rad].
_STEP_RAD: Final = 0.02
_MOST_RAD: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Refusal:
    """Reason why a path is refused.

    Attributes
    ----------
    row : float
        Position on the path as a row index: 2.5 is halfway from the third to the fourth posture.
    q_rad : array of shape (N,)
        Posture there.
    reason : str
    """

    row: float
    q_rad: np.ndarray
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """Limits of one arm, and its collision model.

    Attributes
    ----------
    robot : Robot
    gravity_m_s2 : array of shape (3,)
    lower_rad, upper_rad : arrays of shape (N,)
        The tighter of the limits of cell file and robot model.
    speed_rad_s, acceleration_rad_s2, jerk_rad_s3 : arrays of shape (N,)
    torque_nm : array of shape (N,)
        Joint-side torque limit of the motors, without gear losses.
    efficiency : array of shape (N,)
    following_error_rad : array of shape (N,)
    points_m : array of shape (p, 3)
        Points in the last link: the flange and the points of the load.
    space : Space
        Collision model: bodies of links and load, and the obstacles.
    links : array of shape (4 N,) or None
        Mass and first moment of every link; None = not known, torque is then not checked.
    max_load : array of shape (4,) or None
        Mass [kg] and first moment [kg m] of the heaviest load in the last link.
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
    points_m: np.ndarray
    space: Space
    links: np.ndarray | None
    max_load: np.ndarray | None

    @property
    def rest_share(self) -> float:
        """Share of the torque limits that rest poses may use."""
        return TORQUE_SHARE_BARE if self.max_load is None else TORQUE_SHARE

    def with_clearance(self) -> Workspace:
        """Return a copy with extra clearance between bodies, for planning."""
        return replace(self, space=self.space.with_clearance())

    def draw(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Draw random postures (count, N) [rad] inside the joint limits, within half a turn of their middle."""
        middle, half = (self.upper_rad + self.lower_rad) / 2, (self.upper_rad - self.lower_rad) / 2
        return middle + np.minimum(half, np.pi) * random.uniform(-1, 1, (count, self.robot.axes))

    def violations(
        self, q_rad: np.ndarray, margin_rad: float = 0.0, torque_share: float = TORQUE_SHARE
    ) -> list[tuple[str, np.ndarray]]:
        """Return the violations of each posture.

        Parameters
        ----------
        q_rad : array of shape (n, N)
        margin_rad : float
            Distance to keep from every joint limit.
        torque_share : float
            Share of each torque limit that holding the posture may take.

        Returns
        -------
        list of (words, bool array of shape (n,))
            One entry per joint limit, collision pair and torque limit.
        """
        return [
            *self._outside(q_rad, margin_rad),
            *self.space.touches(q_rad),
            *self._overloaded(q_rad, torque_share),
        ]

    def _outside(self, q_rad: np.ndarray, margin_rad: float) -> list[tuple[str, np.ndarray]]:
        """Return texts and masks (n,) for every joint limit."""
        outside = ~((q_rad >= self.lower_rad + margin_rad) & (q_rad <= self.upper_rad - margin_rad))
        return [
            (
                f"joint {i + 1} outside [{self.lower_rad[i]:.3f}, {self.upper_rad[i]:.3f}] rad"
                + (f" less {margin_rad:.3f} rad for the approach" if margin_rad else ""),
                outside[:, i],
            )
            for i in range(self.robot.axes)
        ]

    def _overloaded(self, q_rad: np.ndarray, torque_share: float) -> list[tuple[str, np.ndarray]]:
        """Return texts and masks (n,) for every torque limit."""
        torque = self.holding_torque(q_rad)
        if torque is None:
            return []
        usable = self.torque_nm * torque_share
        words = "holding torque of joint {} above {:.0%} of its limit"
        return [(words.format(i + 1, torque_share), torque[:, i] > usable[i]) for i in range(len(usable))]

    def feasible(self, q_rad: np.ndarray, margin_rad: float = 0.0, torque_share: float = TORQUE_SHARE) -> np.ndarray:
        """Return True for each posture that violates no limit: bool array of shape (n,)."""
        found = [*self._outside(q_rad, margin_rad), *self._overloaded(q_rad, torque_share)]
        good = ~np.any([mask for _, mask in found], axis=0)
        good[good] = ~self.space.touching(q_rad[good])
        return good

    def why_not(self, q_rad: np.ndarray, torque_share: float = TORQUE_SHARE) -> str | None:
        """Return the first violation of one posture (N,); None = feasible."""
        found = self.violations(q_rad[None], torque_share=torque_share)
        return next((words for words, mask in found if mask[0]), None)

    def holding_torque(self, q_rad: np.ndarray) -> np.ndarray | None:
        """Return the largest motor-driven torque (n, N) [Nm] to hold a posture, unloaded or with the heaviest load."""
        if self.links is None:
            return None
        rows = gravity_regressor(self.robot, q_rad, self.gravity_m_s2)
        torque = np.abs(rows @ self.links)
        if self.max_load is not None:
            torque = np.maximum(torque, np.abs(rows @ self.links + rows[:, :, LOAD_COLUMNS] @ self.max_load))
        return torque / self.efficiency

    def moving_share(self, q_rad: np.ndarray, qd_rad_s: np.ndarray, qdd_rad_s2: np.ndarray) -> float:
        """Return the largest share of the usable torque that speeds and accelerations (n, N) take along a path.

        Usable is what holding the arm leaves of `TORQUE_SHARE_MOVING`, within `TORQUE_SHARE_ACCELERATING`. The heaviest
        load is mounted. A link of unknown inertia takes none; 0 where the masses are not known.
        """
        holding = self.holding_torque(q_rad)
        if holding is None:
            return 0.0
        body = np.nan_to_num(link_values(self.robot)).ravel()
        if self.max_load is not None:
            body[-10:] += body_parameters(self.max_load[0], self.max_load[1:] / self.max_load[0], np.zeros((3, 3)))
        carried = np.abs(regressor(self.robot, q_rad, qd_rad_s, qdd_rad_s2, np.zeros(3)) @ body)
        moving = carried / self.efficiency + np.abs(qdd_rad_s2) * self.torque_nm / ROTOR_ACCELERATION_RAD_S2
        least, most = np.array(TORQUE_SHARE_ACCELERATING)[:, None] * self.torque_nm
        return float((moving / np.clip(TORQUE_SHARE_MOVING * self.torque_nm - holding, least, most)).max(initial=0.0))

    def path_clear(self, start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
        """Return True for each straight motion from start (n, N) to end (n, N) that violates no limit: bool (n,).

        Collisions and joint limits are checked along the whole path, the holding torque at points `PATH_STEP_RAD`
        apart.
        """
        clear = ~(self._out_of_range(start_rad) | self._out_of_range(end_rad))
        if self.links is not None:
            self._refuse_torque(clear, start_rad, end_rad)
        rows = np.flatnonzero(clear)
        clear[rows] = np.isnan(self.space.blocked_at(start_rad[rows], end_rad[rows]))
        return clear

    def _out_of_range(self, q_rad: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of postures with a joint outside its range, or a value that is not finite."""
        return ~np.all((q_rad >= self.lower_rad) & (q_rad <= self.upper_rad), axis=1)

    def _refuse_torque(self, clear: np.ndarray, start_rad: np.ndarray, end_rad: np.ndarray) -> None:
        """Remove from `clear` (n,) the motions that exceed the torque limit at any point."""
        rows = np.flatnonzero(clear)
        paths = [path_points(start_rad[row], end_rad[row]) for row in rows]
        owner = np.repeat(rows, [len(path) for path in paths])
        q_rad = np.concatenate([np.empty((0, self.robot.axes)), *paths])
        for first in range(0, len(q_rad), BLOCK):
            torque = self.holding_torque(q_rad[first : first + BLOCK])
            if torque is not None:
                over = (torque > TORQUE_SHARE * self.torque_nm).any(axis=1)
                clear[owner[first : first + BLOCK][over]] = False

    def refused_on(self, path_rad: np.ndarray) -> Refusal | None:
        """Return the first violation on a path of postures (n, N) with straight joint motions between them.

        Collisions and joint limits are checked along the whole path, the holding torque at points `PATH_STEP_RAD`
        apart.
        """
        broken = ~np.isfinite(path_rad).all(axis=1)
        if broken.any():
            row = int(np.argmax(broken))
            return Refusal(row, path_rad[row], "a joint angle is not a finite number")
        outside = self._out_of_range(path_rad)
        if outside.any():  # joint ranges hold between two rows where they hold at both
            row = int(np.argmax(outside))
            return Refusal(row, path_rad[row], self.why_not(path_rad[row]) or TOO_CLOSE)
        places = path_positions(path_rad)
        first = np.inf
        for begin in range(0, len(places), BLOCK):
            bad = ~self.feasible(postures_at(path_rad, places[begin : begin + BLOCK]))
            if bad.any():
                first = float(places[begin + int(np.argmax(bad))])
                break
        last = int(min(np.ceil(first), len(path_rad) - 1))
        meets = self.space.blocked_at(path_rad[:last], path_rad[1 : last + 1])
        if not np.isnan(meets).all():
            row = int(np.argmax(~np.isnan(meets)))
            first = min(first, row + float(meets[row]))
        if not np.isfinite(first):
            return None
        q_rad = postures_at(path_rad, np.array([first]))[0]
        return Refusal(first, q_rad, self.why_not(q_rad) or TOO_CLOSE)

    def why_not_path(self, q_rad: np.ndarray) -> str | None:
        """Return the first violation on a sampled path (n, N) with its posture; None = feasible."""
        refusal = self.refused_on(q_rad)
        return None if refusal is None else f"at {angles(refusal.q_rad)}: {refusal.reason}"

    def path_into_range(self, q_rad: np.ndarray) -> np.ndarray | None:
        """Return the nearest posture (N,) inside the joint range for an arm outside it; None if the arm is inside.

        Joints outside move to `INWARD_MARGIN_RAD` inside, the others do not move. The straight path is checked.

        Raises
        ------
        PlanRefused
            A joint is too far outside, or a collision or torque limit prevents the path.
        """
        if not self._out_of_range(q_rad[None])[0]:
            return None
        beyond = np.maximum(np.maximum(self.lower_rad - q_rad, q_rad - self.upper_rad), 0.0)
        far = ~(beyond <= MOST_OUTSIDE_RAD)
        if far.any():
            joint = int(np.argmax(far))
            raise PlanRefused(
                f"joint {joint + 1} is {beyond[joint]:.3f} rad outside [{self.lower_rad[joint]:.3f}, "
                f"{self.upper_rad[joint]:.3f}] rad, more than {MOST_OUTSIDE_RAD} rad: its encoder or zero_offset_rad "
                "may be wrong; check them, or jog the joint back with the drive's own tool"
            )
        margin = np.minimum(INWARD_MARGIN_RAD, (self.upper_rad - self.lower_rad) / 2)
        target = np.where(beyond > 0, np.clip(q_rad, self.lower_rad + margin, self.upper_rad - margin), q_rad)
        reason = widened(self, q_rad).why_not_path(np.array([q_rad, target]))
        if reason is not None:
            raise PlanRefused(
                f"on the path of joint {', '.join(map(str, np.flatnonzero(beyond > 0) + 1))} back into its range, "
                f"{reason}; move the arm clear by hand or jog it with the drive's own tool"
            )
        return target

    def inward_speed_rad_s(self) -> np.ndarray:
        """Return the speed (N,) of the motion back into the joint range."""
        return np.minimum(INWARD_SHARE * self.speed_rad_s, INWARD_SPEED_RAD_S)

    def travel_time(self, start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
        """Estimate [s] of the time of straight motions (..., N): slowest axis at full speed plus its ramp."""
        step = np.abs(end_rad - start_rad)
        ramp = self.speed_rad_s / self.acceleration_rad_s2
        return (step / self.speed_rad_s).max(axis=-1) + ramp.max()


def workspace_of(arm: ArmConfig, robot: Robot) -> Workspace:
    """Return the limits and the collision model of a configured arm.

    Raises
    ------
    ConfigError
        The joint limits of the cell file and of the robot model do not overlap, or a speed limit is above the velocity
        of the robot model.
    """
    limits = np.array([axis.position_limit_rad for axis in arm.axis])
    lower, upper = np.maximum(limits[:, 0], robot.lower_rad), np.minimum(limits[:, 1], robot.upper_rad)
    for joint in np.flatnonzero(lower >= upper):
        raise ConfigError(
            f"arm '{arm.name}', axis {joint + 1}: position_limit_rad {limits[joint].tolist()} and the limits "
            f"[{robot.lower_rad[joint]:.3f}, {robot.upper_rad[joint]:.3f}] rad of the robot model do not overlap"
        )
    speed_rad_s = np.array([axis.speed_limit_rad_s for axis in arm.axis])
    stated = robot.velocity_rad_s > 0.0  # NaN: not stated
    for joint in np.flatnonzero(stated & (speed_rad_s > (1.0 + ROUNDED) * robot.velocity_rad_s)):
        raise ConfigError(
            f"arm '{arm.name}', axis {joint + 1}: speed_limit_rad_s {speed_rad_s[joint]:g} is above the velocity "
            f"{robot.velocity_rad_s[joint]:g} rad/s of the robot model; lower it, or correct the URDF by the data sheet"
        )
    flange = np.zeros(3) if robot.flange is None else robot.flange[:3, 3]
    load_com = flange if arm.max_load_com_m is None else np.array(arm.max_load_com_m)
    known = np.isfinite(arm.link_std) and bool(np.isfinite(robot.mass_kg).all() and np.isfinite(robot.com_m).all())
    moments = np.column_stack([robot.mass_kg, robot.mass_kg[:, None] * robot.com_m]).ravel()
    return Workspace(
        robot=robot,
        gravity_m_s2=np.array(arm.gravity_m_s2),
        lower_rad=lower,
        upper_rad=upper,
        speed_rad_s=speed_rad_s,
        acceleration_rad_s2=np.array([axis.acceleration_rad_s2 for axis in arm.axis]),
        jerk_rad_s3=np.array([axis.jerk_rad_s3 for axis in arm.axis]),
        torque_nm=np.array([axis.torque_limit_nm for axis in arm.axis]),
        efficiency=np.array([axis.gear_efficiency.value for axis in arm.axis]),
        following_error_rad=np.array([axis.following_error_limit_rad for axis in arm.axis]),
        points_m=np.vstack([flange, *arm.load_points_m]),
        space=space_of(arm, robot, lower, upper),
        links=moments if known else None,
        max_load=None if arm.max_load_kg is None else arm.max_load_kg * np.concatenate([[1.0], load_com]),
    )


def inside_from(workspace: Workspace, q_rad: np.ndarray, arm: str) -> np.ndarray | None:
    """Return the nearest posture (N,) [rad] inside the joint range; None if the arm is inside.

    Raises
    ------
    PlanRefused
        The arm is in a posture that is not allowed, and no command of this program may move it from there.
    """
    where = f"arm '{arm}' is at {angles(q_rad)}"
    try:
        inside = workspace.path_into_range(q_rad)
    except PlanRefused as refused:
        raise PlanRefused(f"{where}: {refused}") from refused
    begin_rad = q_rad if inside is None else inside
    reason = workspace.why_not(begin_rad)
    if reason is not None:
        out = "" if inside is not None else smallest_exit(workspace, begin_rad)
        raise PlanRefused(
            f"{where}: {reason}; move it clear by hand or jog it with the drive's own tool{out}, or correct the cell"
            " file if there is no obstacle; no command of servo-gateway moves it from this posture"
        )
    return inside


def smallest_exit(workspace: Workspace, q_rad: np.ndarray) -> str:
    """Return a text with the smallest single-joint motion to an allowed posture; empty if there is none."""
    axes = workspace.robot.axes
    signs = np.concatenate([np.eye(axes), -np.eye(axes)])
    sizes = np.arange(_STEP_RAD, _MOST_RAD + _STEP_RAD / 2, _STEP_RAD)
    turns = (sizes[:, None, None] * signs).reshape(-1, axes)
    free = workspace.feasible(q_rad + turns)
    if not free.any():
        return ""
    turn = turns[int(np.argmax(free))]
    joint = int(np.argmax(np.abs(turn)))
    by = f"joint {joint + 1} by {turn[joint]:+.2f} rad"
    return f" (with the geometry of the cell file, {by} is the smallest motion out)"


def refuse_start(workspace: Workspace, q_rad: np.ndarray, arm: str) -> None:
    """Refuse a start posture from which the joints may not move in both directions.

    Raises
    ------
    WrongPlace
        The arm is outside its joint range.
    PlanRefused
        Its posture is not allowed.
    """
    if inside_from(workspace, q_rad, arm) is not None:
        reason = workspace.why_not(q_rad)
        raise WrongPlace(
            f"arm '{arm}' is in a posture from which its joints may not move in both directions: {reason}", arm
        )


def widened(workspace: Workspace, q_rad: np.ndarray) -> Workspace:
    """Return the limits widened to the posture of an arm outside its joint range, so that it may move back."""
    lower, upper = np.minimum(workspace.lower_rad, q_rad), np.maximum(workspace.upper_rad, q_rad)
    return replace(workspace, lower_rad=lower, upper_rad=upper)
