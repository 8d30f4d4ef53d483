"""Commands of the master, one per control cycle, and their arc length.

A path is stated once, at its reference speed; other speed settings run the same program faster or slower. Its hash is
that of the program, so a function that was learned at one speed setting is recognised as valid for the same path at
another. The arc length `s` includes rotation, `ds = sqrt(|dp|^2 + (rho dtheta)^2)`: straight-line distances would run
backwards on a curve, and a pure turn would have no length at all.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from gateway.errors import InputError
from gateway.pair.transform import Floats, inverse, log_rotation, pose

RHO_M = 0.25
#: Most commands of one pass: more than an hour at a control cycle of 4 ms.
MOST_COMMANDS = 1_000_000
HASH_DECIMALS = 7


@dataclass(frozen=True, slots=True, eq=False)
class PairPath:
    """Commands of the master gripper.

    Attributes
    ----------
    commands : array of shape (M, 4, 4)
        `B1_T_E1`, one per control cycle [m].
    dt_s : control cycle.
    s_m : array of shape (M,)
        Arc length along the path, never falling, 0 at the start.
    rho_m : lever of rotations in the arc length.
    hash : SHA-256 of the program (hexadecimal).
    speed : speed setting, 1 = as the program says.
    """

    commands: Floats
    dt_s: float
    s_m: Floats
    rho_m: float
    hash: str
    speed: float

    def __len__(self) -> int:
        return len(self.commands)

    @property
    def duration_s(self) -> float:
        """Time of one pass [s]."""
        return (len(self.commands) - 1) * self.dt_s

    @property
    def length_m(self) -> float:
        """Return the arc length at the end [m]."""
        return float(self.s_m[-1])

    def nearest(self, s_m: ArrayLike) -> np.ndarray:
        """Return the index of the command nearest to each arc length (n,) [m]; of equal ones the first."""
        arc_m = np.atleast_1d(np.asarray(s_m, dtype=float))
        right = np.clip(np.searchsorted(self.s_m, arc_m), 1, len(self.s_m) - 1)
        return np.where(arc_m - self.s_m[right - 1] <= self.s_m[right] - arc_m, right - 1, right)

    def uniform(self, count: int) -> np.ndarray:
        """Indices of `count` learning points, evenly spread over the arc length, start and end included."""
        if not 2 <= count < len(self):
            raise InputError(f"learning points must be at least 2 and fewer than the {len(self)} commands, got {count}")
        return np.unique(self.nearest(np.linspace(0.0, self.length_m, count)))

    def in_time(self, count: int) -> np.ndarray:
        """Indices of `count` learning points, evenly spread over the time: dense where the motion begins and ends."""
        if not 2 <= count < len(self):
            raise InputError(f"learning points must be at least 2 and fewer than the {len(self)} commands, got {count}")
        return np.unique(np.round(np.linspace(0, len(self) - 1, count)).astype(int))


@dataclass(frozen=True, slots=True, eq=False)
class PathProgram:
    """A path as it was stated, at speed setting 1; `at_speed` gives the commands to run."""

    poses: Floats
    dt_s: float
    rho_m: float = RHO_M

    def __post_init__(self) -> None:
        values = np.asarray(self.poses, dtype=float)
        if values.ndim != 3 or values.shape[1:] != (4, 4) or len(values) < 3:
            raise InputError(f"a path needs at least three poses (M, 4, 4), got {values.shape}")
        if not np.isfinite(values).all():
            raise InputError("a path has a pose that is not finite")
        if not self.dt_s > 0.0:
            raise InputError(f"the control cycle of a path must be positive, got {self.dt_s} s")

    @property
    def hash(self) -> str:
        """SHA-256 over control cycle and poses, rounded to 0.1 um and 0.1 urad."""
        rounded = np.round(np.asarray(self.poses)[:, :3, :], HASH_DECIMALS) + 0.0
        digest = hashlib.sha256(f"{self.dt_s:.9g} {self.rho_m:.9g} {len(rounded)}".encode())
        digest.update(np.ascontiguousarray(rounded, dtype="<f8").tobytes())
        return digest.hexdigest()

    def at_speed(self, speed: float, sync_s: float) -> PairPath:
        """Commands of the program at a speed setting, one per control cycle of `sync_s`.

        Raises
        ------
        InputError
            Speed or cycle not positive, or so fast that fewer than three commands are left.
        """
        if not (speed > 0.0 and sync_s > 0.0):
            raise InputError(f"speed setting and control cycle must be positive, got {speed} and {sync_s} s")
        poses = np.asarray(self.poses, dtype=float)
        time = np.arange(len(poses)) * self.dt_s
        cycles = time[-1] / (speed * sync_s) * (1.0 + 1e-12)
        if not cycles < MOST_COMMANDS:
            raise InputError(f"at speed setting {speed} the path takes {cycles:.3g} control cycles, too many to keep")
        count = int(np.floor(cycles)) + 1
        if count < 3:
            raise InputError(f"at speed setting {speed} the path has only {count} control cycles")
        at = np.minimum(np.arange(count) * (speed * sync_s), time[-1])
        if time[-1] - at[-1] > 1e-9 * time[-1]:
            at = np.append(at, time[-1])
        arc_m = arc_length(poses, self.rho_m)
        if abs(speed * sync_s - self.dt_s) < 1e-12 and len(at) == len(poses):
            return PairPath(poses, sync_s, arc_m, self.rho_m, self.hash, speed)
        turn = RotationSpline(time, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
        commands = pose(turn, CubicSpline(time, poses[:, :3, 3])(at))
        return PairPath(commands, sync_s, np.interp(at, time, arc_m), self.rho_m, self.hash, speed)


def arc_length(poses: ArrayLike, rho_m: float = RHO_M) -> Floats:
    """Return the arc length (M,) along poses (M, 4, 4), turning included [m]."""
    values = np.asarray(poses, dtype=float)
    step = np.linalg.norm(np.diff(values[:, :3, 3], axis=0), axis=1)
    turn = np.linalg.norm(log_rotation(np.swapaxes(values[:-1, :3, :3], -1, -2) @ values[1:, :3, :3]), axis=1)
    return np.concatenate([[0.0], np.cumsum(np.hypot(step, rho_m * turn))])


def master_commands(part_poses: ArrayLike, w_t_b1: ArrayLike, part_t_e1: ArrayLike) -> Floats:
    """Commands (M, 4, 4) of the master gripper that carry the part along its poses (M, 4, 4) in the world [m].

    Parameters
    ----------
    part_poses : array of shape (M, 4, 4)
    w_t_b1 : array of shape (4, 4)
        Base of the master in the world.
    part_t_e1 : array of shape (4, 4)
        Where gripper 1 holds the part, in the part's frame.
    """
    return inverse(w_t_b1) @ np.asarray(part_poses, dtype=float) @ np.asarray(part_t_e1, dtype=float)
