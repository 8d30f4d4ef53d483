"""Relation between the grippers as a function of the arc length of the path (CN104379308 eqs. (5) to (16)).

Between two knots the position is linear and the rotation is about a fixed axis: `P(rate) = P_k + dP_k rate`, `R(rate) =
R_k Rot(k, a rate)` with `dR_k = R_k^T R_(k+1)`, which meets both knots exactly. (The printed pair, eq. (8) `dR = R_k
inv(R_(k+1))` with eq. (15) `R_k dR`, misses the second one.) Before the first knot and behind the last one the function
keeps its value.

A function in a file has units, frames, source, speed and date. It belongs to one path in one cell; for any other it is
refused. `SpeedTable` holds functions for several speed settings, and gives the one for a setting in between (embodiment
3). Printed, the increments inside a segment are interpolated and the knots are kept, so the function jumps at every
knot. Here every knot is interpolated, `P(x) = P_a + lam (P_b - P_a)`, `R(x) = R_a Rot(lam log(R_a^T R_b))` with `lam =
(x - a)/(b - a)`: continuous, and the same for the increments (eqs. (19), (20)).
"""

from __future__ import annotations

import math
import warnings
from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import InputError
from gateway.pair.transform import Floats, cross_matrix, exp_rotation, log_rotation, pose
from gateway.result.pair import FUNCTION_KIND, KNOT_UNITS, SCHEMA, FunctionKnot, StoredFunction
from gateway.result.values import check_kind, decoded, json_object, matrix, numbers, text_of

LARGEST_TURN_RAD = math.pi - 1e-3
ORTHONORMAL = 1e-6
#: Largest arc length and position of a function [m].
LARGEST = 1e6


class TransformFunction:
    """Knots of the relation with interpolation between them; immutable.

    Parameters
    ----------
    s_m : array of shape (N,)
        Arc length along the path at the knots [m], strictly rising.
    position_m : array of shape (N, 3)
    rotation : array of shape (N, 3, 3)

    Raises
    ------
    InputError
        Wrong shapes, values that are not finite, knots out of order, matrices that are no rotations, or a turn of
        half a revolution between two knots (its axis is not determined).
    """

    __slots__ = ("_angle", "_cross", "_double", "_knots", "_list", "_step", "position_m", "rotation", "s_m")

    def __init__(self, s_m: ArrayLike, position_m: ArrayLike, rotation: ArrayLike) -> None:
        arc_m, place, turn = (np.array(value, dtype=float) for value in (s_m, position_m, rotation))
        if arc_m.ndim != 1 or len(arc_m) < 1 or place.shape != (len(arc_m), 3) or turn.shape != (len(arc_m), 3, 3):
            raise InputError(
                "a transform function needs N arc lengths (N,), positions (N, 3) and rotations (N, 3, 3), got"
                f" {arc_m.shape}, {place.shape}, {turn.shape}"
            )
        if not all(np.isfinite(value).all() for value in (arc_m, place, turn)):
            raise InputError("a transform function has a value that is not finite")
        if any(np.abs(value).max() > LARGEST for value in (arc_m, place, turn)):
            raise InputError(f"a transform function has a value beyond {LARGEST:g}")
        if np.any(np.diff(arc_m) <= 0.0):
            first_bad = int(np.argmax(np.diff(arc_m) <= 0.0))
            raise InputError(
                f"knots of the transform function are out of order: knot {first_bad + 2} at "
                f"{arc_m[first_bad + 1]:.6g} m is not behind knot {first_bad + 1} at {arc_m[first_bad]:.6g} m"
            )
        deviation = np.abs(np.swapaxes(turn, -1, -2) @ turn - np.eye(3)).max(axis=(1, 2))
        wrong = (deviation > ORTHONORMAL) | (np.linalg.det(turn) < 0.0)
        if wrong.any():
            raise InputError(f"knot {int(np.argmax(wrong)) + 1} of the transform function holds no rotation matrix")
        for value in (arc_m, place, turn):
            value.setflags(write=False)
        self.s_m, self.position_m, self.rotation = arc_m, place, turn
        turn = log_rotation(np.swapaxes(self.rotation[:-1], -1, -2) @ self.rotation[1:])
        self._angle = np.linalg.norm(turn, axis=1)
        if np.any(self._angle > LARGEST_TURN_RAD):
            worst = int(np.argmax(self._angle))
            raise InputError(
                f"knots {worst + 1} and {worst + 2} of the transform function differ by half a turn: teach points of"
                " one gripped part differ by milliradians, so one of them is wrong"
            )
        cross = cross_matrix(turn / np.where(self._angle > 0.0, self._angle, 1.0)[:, None])
        self._step = np.diff(self.position_m, axis=0)
        self._cross = self.rotation[:-1] @ cross
        self._double = self._cross @ cross
        self._knots = pose(self.rotation, self.position_m)
        self._list = self.s_m.tolist()

    @property
    def knots(self) -> Floats:
        """Relation (N, 4, 4) at the knots [m]."""
        return self._knots.copy()

    def __len__(self) -> int:
        return len(self._list)

    def at(self, s_m: float) -> Floats:
        """Return the relation (4, 4) at one arc length [m]; scalar version, called every SYNC."""
        arc_m = self._list
        segment = bisect_right(arc_m, s_m) - 1
        result = self._knots[max(segment, 0)].copy()
        if segment < 0 or segment >= len(arc_m) - 1:
            return result
        rate = (s_m - arc_m[segment]) / (arc_m[segment + 1] - arc_m[segment])
        angle = rate * self._angle[segment]
        result[:3, :3] += math.sin(angle) * self._cross[segment] + (1.0 - math.cos(angle)) * self._double[segment]
        result[:3, 3] += rate * self._step[segment]
        return result

    def many(self, s_m: ArrayLike) -> Floats:
        """Return relations (n, 4, 4) at arc lengths (n,) [m]."""
        arc_m = np.asarray(s_m, dtype=float)
        segment = np.searchsorted(self.s_m, arc_m, side="right") - 1
        inside = (segment >= 0) & (segment < len(self) - 1)
        result = self._knots[np.clip(segment, 0, len(self) - 1)]
        if not inside.any():
            return result
        k = segment[inside]
        rate = (arc_m[inside] - self.s_m[k]) / (self.s_m[k + 1] - self.s_m[k])
        angle = rate * self._angle[k]
        turned = np.sin(angle)[:, None, None] * self._cross[k] + (1.0 - np.cos(angle))[:, None, None] * self._double[k]
        result[inside, :3, :3] += turned
        result[inside, :3, 3] += rate[:, None] * self._step[k]
        return result


def constant_function(e1_t_e2: ArrayLike) -> TransformFunction:
    """The one fixed relation (4, 4) of the comparison example, as a function with a single knot."""
    fixed = np.asarray(e1_t_e2, dtype=float)
    return TransformFunction([0.0], fixed[None, :3, 3], fixed[None, :3, :3])


def function_of_knots(s_m: ArrayLike, knots: ArrayLike) -> TransformFunction:
    """Return the function through the poses (N, 4, 4) at the arc lengths (N,) [m]."""
    values = np.asarray(knots, dtype=float)
    return TransformFunction(s_m, values[:, :3, 3], values[:, :3, :3])


def sampled(function: TransformFunction, s_m: ArrayLike) -> TransformFunction:
    """Return the same function with knots at other arc lengths (N,) [m]; exact at these."""
    return function_of_knots(s_m, function.many(s_m))


def closed(function: TransformFunction, end_m: float) -> TransformFunction:
    """Close the function of a path that ends where it starts: repeat the first knot at the path's end [m].

    Raises
    ------
    InputError
        The end is not beyond the last knot.
    """
    s_m = np.append(function.s_m, end_m + function.s_m[0])
    knots = function.knots
    return function_of_knots(s_m, np.concatenate([knots, knots[:1]]))


def stored_function(function: TransformFunction, **origin: Any) -> StoredFunction:
    """Build a stored function from a transform function and its origin, the other fields of `StoredFunction`."""
    knots = zip(function.s_m, function.position_m, function.rotation, strict=True)
    return StoredFunction(
        knots=tuple(FunctionKnot(float(way), numbers(place), matrix(turn)) for way, place, turn in knots), **origin
    )


def transform_of(stored: StoredFunction) -> TransformFunction:
    """Return the transform function of a stored function.

    Raises
    ------
    InputError
        Knots out of order, matrices that are no rotations.
    """
    return TransformFunction(*([getattr(knot, key) for knot in stored.knots] for key in KNOT_UNITS))


def read_stored(path: Path) -> StoredFunction:
    """Read the file of a function.

    Raises
    ------
    InputError
        It cannot be read, or as `from_json`.
    """
    return from_json(text_of(path, "teach or learn it again"), str(path))


def from_json(text: str, where: str) -> StoredFunction:
    """Read a stored function.

    Parameters
    ----------
    text : str
    where : str
        Name of the file, for messages.

    Raises
    ------
    InputError
        Not such a file, a key missing or of the wrong type, knots out of order, or invalid rotation matrices.
    """
    data = json_object(text, where)
    check_kind(data, SCHEMA, where, FUNCTION_KIND)
    stored = decoded(StoredFunction, data, where)
    if stored.units != KNOT_UNITS:
        raise InputError(f"{where}: units {stored.units!r}, expected {KNOT_UNITS}")
    try:
        transform_of(stored)
    except (InputError, ValueError) as error:
        raise InputError(f"{where}: {error}") from error
    return stored


def refuse_foreign(stored: StoredFunction, path_hash: str, cell_hash: str, where: str) -> None:
    """Refuse a stored function of another path or cell.

    Raises
    ------
    InputError
        States which of both differs, and what to do.
    """
    if stored.cell_hash != cell_hash:
        raise InputError(
            f"{where}: was made in another cell ({_short(stored.cell_hash)}, this one is {_short(cell_hash)}): bases,"
            " arms or grips differ; teach this cell"
        )
    if stored.path_hash != path_hash:
        raise InputError(
            f"{where}: is valid for another path ({_short(stored.path_hash)}, this one is {_short(path_hash)}); the"
            " path was changed since, teach or learn it again"
        )


def _short(digest: str) -> str:
    return digest[:12]


#: Furthest extrapolation, in units of the last interval beyond its start.
LARGEST_SHARE = 1.3


class ExtrapolationWarning(UserWarning):
    """Warning about a speed setting outside the stored ones."""


class SpeedTable:
    """Transform functions by speed setting; 0 is the one taught at rest.

    Parameters
    ----------
    functions : mapping of float to TransformFunction
        At least two settings, none negative, all for the same path.

    Raises
    ------
    InputError
    """

    def __init__(self, functions: Mapping[float, TransformFunction]) -> None:
        if len(functions) < 2:
            raise InputError(f"a speed table needs functions for at least two speed settings, got {len(functions)}")
        if any(not (np.isfinite(speed) and speed >= 0.0) for speed in functions):
            raise InputError(f"speed settings must be finite and not negative, got {sorted(functions)}")
        self._functions = dict(sorted(functions.items()))
        self.speeds = tuple(self._functions)

    def at(self, speed: float) -> TransformFunction:
        """Function for a speed setting; straight between neighbours, beyond the last one up to 1.3 intervals.

        Raises
        ------
        InputError
            Speed negative or not finite.

        Warns
        -----
        ExtrapolationWarning
            Outside the stored settings: lag grows with the speed, but centrifugal force with its square.
        """
        if not (np.isfinite(speed) and speed >= 0.0):
            raise InputError(f"a speed setting must be finite and not negative, got {speed}")
        upper = int(np.clip(np.searchsorted(self.speeds, speed), 1, len(self.speeds) - 1))
        slow, fast = self.speeds[upper - 1], self.speeds[upper]
        share = (speed - slow) / (fast - slow)
        if not 0.0 <= share <= 1.0:
            warnings.warn(
                f"speed setting {speed} is outside the stored ones ({self.speeds[0]} to {self.speeds[-1]}):"
                f" extrapolated{', clipped' if not 0.0 <= share <= LARGEST_SHARE else ''}",
                ExtrapolationWarning,
                stacklevel=2,
            )
        return between(self._functions[slow], self._functions[fast], float(np.clip(share, 0.0, LARGEST_SHARE)))


def between(slow: TransformFunction, fast: TransformFunction, share: float) -> TransformFunction:
    """Interpolate between two functions by a share, on the knots of both."""
    arc_m = np.union1d(slow.s_m, fast.s_m)
    a, b = slow.many(arc_m), fast.many(arc_m)
    turn = log_rotation(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3])
    place = a[:, :3, 3] + share * (b[:, :3, 3] - a[:, :3, 3])
    return function_of_knots(arc_m, pose(a[:, :3, :3] @ exp_rotation(share * turn), place))
