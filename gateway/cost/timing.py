"""Fastest time law of a path within speed, acceleration and jerk limits, torque limits and load acceleration.

A straight joint motion has a speed, an acceleration and a deceleration of its own, each at most the limit of the cell.
They are chosen so that the motion is fastest while no axis exceeds its torque limit with the load that the planner
assumes. A timed path keeps its time law and is stretched as a whole.

Torque of every axis along a joint path as a function of the time law of the path.

The path is q(s). With the speed s' and the acceleration s'' along it

    tau = G(s) + A(s) s'' + B(s) s'^2,   A = M(q) dq/ds,   B = M(q) d2q/ds2 + C(q, dq/ds) dq/ds

(Bobrow, Dubowsky and Gibson 1985). G, A and B are computed once on a grid, so that many time laws are tried at little
cost. Friction, gear losses and rotors are those of `gateway.feedforward.law`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gateway.excite.limits import States, point_acceleration_m_s2
from gateway.feedforward.load import FeedLoad
from gateway.follow.settings import FeedModel
from gateway.identify.stated_effects import Stated, with_stated
from gateway.model.regressor import regressor
from gateway.model.visits import Gears
from gateway.motion.trajectory import Motion, MotionLimits, straight, straight_duration_s

Floats = NDArray[np.float64]
#: Postures of a straight motion at which the torque is computed.
GRID = 61
#: Shares of the limits that are tried: powers of the first number, so many; refined until neighbours are this close.
STEP, LEVELS, FINEST = 0.75, 14, 0.985
#: Smallest share of the speed of a timed path, and steps of the bisection.
LEAST_SHARE, STEPS = 0.01, 14
#: A limit counts as reached from this share on.
REACHED = 0.98
#: Setpoints are this far apart while laws are compared [s].
COARSE_S = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class JointPath:
    """Postures along a path, with derivatives by the path coordinate.

    Attributes
    ----------
    s : array of shape (n,)
        Path coordinate, increasing.
    q_rad, by_s, by_s2 : arrays of shape (n, N)
        Joint positions, first and second derivative.
    """

    s: Floats
    q_rad: Floats
    by_s: Floats
    by_s2: Floats


@dataclass(frozen=True, slots=True, eq=False)
class TimeLaw:
    """Path coordinate, speed and acceleration along the path, arrays of shape (m,)."""

    s: Floats
    speed: Floats
    acceleration: Floats


class PathTorque:
    """Motor torque and load acceleration along one path, for one load.

    Parameters
    ----------
    path : JointPath
    model : FeedModel
    load : FeedLoad or None
        None = unloaded arm.
    load_limit_m_s2 : float or None
        Largest acceleration of the load's centre of gravity.
    stated : tuple of (Term, array)
        Springs, cables and bodies on links that a result states.
    """

    def __init__(
        self,
        path: JointPath,
        model: FeedModel,
        load: FeedLoad | None,
        load_limit_m_s2: float | None = None,
        stated: tuple[Stated, ...] = (),
    ) -> None:
        self._path, self._model = path, model
        parts = with_stated(stated, path.q_rad, Gears.of(None, path.q_rad.shape[1]))
        parameters = model.links.copy()
        # a body on a link is stated by mass and first moment; its own inertia is not known
        parameters.reshape(-1, 10)[:, :4] += parts.link_extra.reshape(-1, 4)
        if load is not None:
            parameters[-10:] += load.parameters
        still, no_gravity = np.zeros_like(path.q_rad), np.zeros(3)
        robot = model.robot
        self._gravity = regressor(robot, path.q_rad, still, still, model.gravity_m_s2) @ parameters - parts.passive_nm
        self._by_acceleration = regressor(robot, path.q_rad, still, path.by_s, no_gravity) @ parameters
        self._by_speed2 = regressor(robot, path.q_rad, path.by_s, path.by_s2, no_gravity) @ parameters
        self._limit_m_s2 = None if load is None else load_limit_m_s2
        self._load_by_acceleration = self._load_by_speed2 = np.zeros((len(path.s), 3))
        if load is not None and load_limit_m_s2 is not None:
            straight = States(path.q_rad, still, path.by_s, still)
            curved = States(path.q_rad, path.by_s, path.by_s2, still)
            self._load_by_acceleration = point_acceleration_m_s2(robot, straight, load.com_m)
            self._load_by_speed2 = point_acceleration_m_s2(robot, curved, load.com_m)

    def motor_nm(self, law: TimeLaw) -> Floats:
        """Torque (m, N) [Nm] that the motors give, at the gear output, gear losses included."""
        at, speed2 = self._at(law.s), (law.speed**2)[:, None]
        rigid = at(self._gravity) + at(self._by_acceleration) * law.acceleration[:, None] + at(self._by_speed2) * speed2
        by_s = at(self._path.by_s)
        turning = by_s * law.speed[:, None]
        turning_rate = by_s * law.acceleration[:, None] + at(self._path.by_s2) * speed2
        coupling = self._model.coupling
        force, rate = rigid @ np.linalg.inv(coupling), turning @ coupling.T
        side = np.where(rate != 0.0, np.sign(rate), np.sign(by_s))
        force = force + self._model.friction_nm(force, rate, side)
        driving, efficiency = np.sign(force) * side, self._model.terms("efficiency")
        lost = np.where(driving > 0.0, 1.0 / efficiency, np.where(driving < 0.0, efficiency, 1.0))
        return force * lost + self._model.terms("rotor_kg_m2") * (turning_rate @ coupling.T)

    def torque_shares(self, law: TimeLaw) -> Floats:
        """Motor torque (m, N) over the torque limit of the axis, signed."""
        return self.motor_nm(law) / (self._model.terms("limit_nm") * np.abs(self._model.terms("ratio")))

    def load_shares(self, law: TimeLaw) -> Floats:
        """Acceleration (m,) of the load's centre of gravity over its limit; 0 where there is none."""
        if self._limit_m_s2 is None:
            return np.zeros(len(law.s))
        at = self._at(law.s)
        moved = at(self._load_by_acceleration) * law.acceleration[:, None]
        moved = moved + at(self._load_by_speed2) * (law.speed**2)[:, None]
        return np.linalg.norm(moved, axis=1) / self._limit_m_s2

    def _at(self, s: Floats) -> Callable[[Floats], Floats]:
        """Linear interpolation of grid values (n, k) at path coordinates (m,)."""
        row = np.clip(np.searchsorted(self._path.s, s) - 1, 0, len(self._path.s) - 2)
        share = ((s - self._path.s[row]) / (self._path.s[row + 1] - self._path.s[row]))[:, None]
        return lambda values: values[row] + share * (values[row + 1] - values[row])


#: Of the limits of speed, acceleration and deceleration.
Shares = tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TimedSegment:
    """A motion from rest to rest as it is planned.

    Attributes
    ----------
    law : TimeLaw
    duration_s : float
    limited_by : str
        "torque of J2", "speed of J1", "acceleration of J3", "jerk of J1", "load acceleration", "time law of the file";
        several with commas.
    """

    law: TimeLaw
    duration_s: float
    limited_by: str


def line_path(start_rad: Floats, end_rad: Floats) -> JointPath:
    """Return the straight line between two postures, s from 0 to 1."""
    s = np.array([place / (GRID - 1) for place in range(GRID)])
    moved = end_rad - start_rad
    return JointPath(s, start_rad + s[:, None] * moved, np.tile(moved, (GRID, 1)), np.zeros((GRID, len(moved))))


def timed_path(start_rad: Floats, motion: Motion) -> JointPath:
    """Return a path with a time law, s the planned time."""
    still = np.zeros_like(start_rad)
    s = motion.period_s * np.arange(len(motion) + 1, dtype=np.float64)
    parts = [
        np.vstack([first, rows])
        for first, rows in ((start_rad, motion.q_rad), (still, motion.qd_rad_s), (still, motion.qdd_rad_s2))
    ]
    return JointPath(np.array(s), *parts)


def fastest_line(
    start_rad: Floats, end_rad: Floats, limits: MotionLimits, period_s: float, assumed: PathTorque
) -> TimedSegment | None:
    """Return the fastest straight motion with the load of `assumed`; None where the torque does not suffice.

    The shares of speed, acceleration and deceleration are searched on a grid that is refined about the best ones. A
    search along one share at a time ends in local minima: a slower start moves the deceleration to other postures.
    """

    def within(shares: Shares) -> MotionLimits:
        speed, rise, fall = shares
        acceleration = limits.acceleration_rad_s2
        return MotionLimits(speed * limits.speed_rad_s, rise * acceleration, limits.jerk_rad_s3, fall * acceleration)

    def kept(shares: Shares) -> bool:
        law = _along(start_rad, end_rad, straight(start_rad, end_rad, within(shares), COARSE_S))
        return bool((np.abs(assumed.torque_shares(law)) <= 1.0).all() and (assumed.load_shares(law) <= 1.0).all())

    def first_kept(grid: Iterable[Shares]) -> Shares | None:
        return next(
            filter(kept, sorted(grid, key=lambda at: straight_duration_s(start_rad, end_rad, within(at)))), None
        )

    full = (1.0, 1.0, 1.0)
    levels: list[float] = (STEP ** np.arange(LEVELS)).tolist()
    best: Shares | None = full
    if not kept(full):
        # a load that can be held all along can be moved slowly
        slowest = levels[-1], levels[-1], levels[-1]
        best = first_kept(product(levels, repeat=3)) if kept(slowest) else None
    if best is None:
        return None
    step = STEP if best != full else 1.0
    while step < FINEST:
        around = np.array([step, np.sqrt(step), 1.0, 1.0 / np.sqrt(step), 1.0 / step])
        best = first_kept(product(*(np.unique(np.minimum(share * around, 1.0)).tolist() for share in best))) or best
        step = np.sqrt(step)
    motion = straight(start_rad, end_rad, within(best), min(period_s, COARSE_S))
    law = _along(start_rad, end_rad, motion)
    return TimedSegment(law, motion.duration_s, _limit_of_line(motion, law, limits, assumed))


def _along(start_rad: Floats, end_rad: Floats, motion: Motion) -> TimeLaw:
    line = (end_rad - start_rad) / float((end_rad - start_rad) @ (end_rad - start_rad))
    return TimeLaw((motion.q_rad - start_rad) @ line, motion.qd_rad_s @ line, motion.qdd_rad_s2 @ line)


def _limit_of_line(motion: Motion, law: TimeLaw, limits: MotionLimits, assumed: PathTorque) -> str:
    """Name the limits that a straight motion reaches: torque and load acceleration, else speed, acceleration, jerk."""
    torque = np.abs(assumed.torque_shares(law)).max(axis=0)
    reached = {f"torque of J{axis}": float(share) for axis, share in enumerate(torque, start=1)}
    reached["load acceleration"] = float(assumed.load_shares(law).max())
    names = [name for name, share in reached.items() if share >= REACHED]
    if names:
        return ", ".join(names)
    used = [
        (kind, np.abs(values).max(axis=0) / limit)
        for kind, values, limit in (
            ("speed", motion.qd_rad_s, limits.speed_rad_s),
            ("acceleration", motion.qdd_rad_s2, limits.acceleration_rad_s2),
        )
    ]
    for kind, shares in used:
        if shares.max() >= REACHED:
            return f"{kind} of J{int(np.argmax(shares)) + 1}"
    return f"jerk of J{int(np.argmax(used[1][1])) + 1}"


def stretched(path: JointPath, assumed: PathTorque) -> TimedSegment | None:
    """Return a timed path, slowed down as a whole until it keeps the limits; None where the torque does not suffice."""

    def law(rate: float) -> TimeLaw:
        return TimeLaw(path.s, np.full_like(path.s, rate), np.zeros_like(path.s))

    def used(rate: float) -> Floats:
        at = law(rate)
        return np.append(np.abs(assumed.torque_shares(at)).max(axis=0), assumed.load_shares(at).max())

    # the largest rate that keeps the limits, by bisection of its logarithm
    rate, high = 1.0 if (used(1.0) <= 1.0).all() else LEAST_SHARE, 1.0
    for _ in range(STEPS if rate < 1.0 else 0):
        middle = float(np.sqrt(rate * high))
        rate, high = (middle, high) if (used(middle) <= 1.0).all() else (rate, middle)
    shares = used(rate)
    if (shares > 1.0).any():
        return None
    most = int(np.argmax(shares))
    name = f"torque of J{most + 1}" if most < path.q_rad.shape[1] else "load acceleration"
    return TimedSegment(law(rate), float(path.s[-1]) / rate, name if rate < 1.0 else "time law of the file")
