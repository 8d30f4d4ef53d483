"""Points of a path that were taught, and their file (CN104379308 embodiment 1, fig. 5)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gateway.errors import InputError
from gateway.pair.function import TransformFunction, function_of_knots
from gateway.pair.transform import Floats

SCHEMA = 1
KIND = "servo-gateway taught points"


@dataclass(frozen=True, slots=True, eq=False)
class TaughtPoint:
    """One point.

    Attributes
    ----------
    index : of the command on the path
    s_m : way
    relation : array of shape (4, 4), gripper 2 in gripper 1 by the adjusted commands
    correction : array of shape (6,), of the slave at this point, its base [m, rad]
    forces_n, moments_nm : of every sweep, the last one below the set value
    """

    index: int
    s_m: float
    relation: Floats
    correction: Floats
    forces_n: tuple[float, ...]
    moments_nm: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "command": self.index + 1,
            "s_m": self.s_m,
            "relation": self.relation.tolist(),
            "correction_m": self.correction[:3].tolist(),
            "correction_rad": self.correction[3:].tolist(),
            "force_n": list(self.forces_n),
            "moment_nm": list(self.moments_nm),
        }


@dataclass(slots=True)
class Lesson:
    """Points taught so far, for one path of one cell."""

    path_hash: str
    cell_hash: str
    points: list[TaughtPoint] = field(default_factory=list)

    def function(self, start: Floats) -> TransformFunction:
        """Function through the points; `start` (4, 4) while there is none."""
        if not self.points:
            return function_of_knots([0.0], start[None])
        ordered = sorted(self.points, key=lambda point: point.s_m)
        return function_of_knots([point.s_m for point in ordered], np.array([point.relation for point in ordered]))

    def to_json(self) -> str:
        """Text of the file."""
        body = {
            "kind": KIND,
            "schema": SCHEMA,
            "path_hash": self.path_hash,
            "cell_hash": self.cell_hash,
            "units": {"relation": "m", "correction_m": "m", "correction_rad": "rad"},
            "points": [point.as_json() for point in self.points],
        }
        return json.dumps(body, indent=1, allow_nan=False) + "\n"


def lesson_from_json(text: str, where: str) -> Lesson:
    """Read taught points.

    Raises
    ------
    InputError
        Not such a file, or a key is missing.
    """
    try:
        body = json.loads(text)
        if body["kind"] != KIND or body["schema"] != SCHEMA:
            raise InputError(f"{where}: holds no taught points of schema {SCHEMA}")
        points = [_point(point) for point in body["points"]]
        return Lesson(str(body["path_hash"]), str(body["cell_hash"]), points)
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: is no file of taught points: {error}; teach again without --resume") from error


def _point(point: Mapping[str, Any]) -> TaughtPoint:
    """One point of the file; ValueError, KeyError, TypeError or OverflowError where it is none."""
    command = point["command"]
    if not isinstance(command, int) or isinstance(command, bool) or command < 1:
        raise ValueError(f"command {command!r} is no number of a command")
    correction, forces, moments = (
        np.array(value, dtype=float)
        for value in ([*point["correction_m"], *point["correction_rad"]], point["force_n"], point["moment_nm"])
    )
    relation = np.array(point["relation"], dtype=float).reshape(4, 4)
    way = float(point["s_m"])
    if correction.shape != (6,) or forces.ndim != 1 or moments.ndim != 1:
        raise ValueError(f"command {command}: a correction has six numbers, forces and moments are lists")
    if not all(np.isfinite(value).all() for value in (correction, forces, moments, relation, way)):
        raise ValueError(f"command {command}: a value is not finite")
    if not np.array_equal(relation[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"command {command}: the relation is no pose")
    return TaughtPoint(command - 1, way, relation, correction, tuple(forces.tolist()), tuple(moments.tolist()))


def read_lesson(path: Path, path_hash: str, cell_hash: str) -> Lesson:
    """Taught points of a file, if it is for this path of this cell.

    Raises
    ------
    InputError
        It cannot be read, or is for another one.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; teach again without --resume") from error
    lesson = lesson_from_json(text, str(path))
    if (lesson.path_hash, lesson.cell_hash) != (path_hash, cell_hash):
        raise InputError(
            f"{path}: its points were taught on another path or in another cell; teach again without --resume"
        )
    return lesson
