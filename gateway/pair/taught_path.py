"""Taught points of a path, and their file (CN104379308 embodiment 1, fig. 5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import InputError
from gateway.pair.transform import Floats
from gateway.pair.transform_function import TransformFunction, function_of_knots
from gateway.result.pair import POINTS_KIND, SCHEMA, TaughtPathFile, TaughtPoint
from gateway.result.values import check_kind, decoded, json_object, json_text, matrix, numbers, text_of

AFRESH = "teach again without --resume"


def taught_point(
    index: int, s_m: float, relation: Floats, correction: Floats, forces: tuple[ArrayLike, ArrayLike]
) -> TaughtPoint:
    """Build a taught point from arrays.

    Parameters
    ----------
    index : of the command on the path, from 0
    s_m : arc length
    relation : array of shape (4, 4), gripper 2 in gripper 1
    correction : array of shape (6,), of the slave, its base [m, rad]
    forces : force [N] and moment [Nm] of every sweep
    """
    return TaughtPoint(
        command=index + 1,
        s_m=s_m,
        relation=matrix(relation),
        correction_m=numbers(correction[:3]),
        correction_rad=numbers(correction[3:]),
        force_n=numbers(forces[0]),
        moment_nm=numbers(forces[1]),
    )


@dataclass(slots=True)
class TaughtPath:
    """Points taught so far, for one path of one cell.

    Attributes
    ----------
    laws_s : array of shape (J, 2)
        T and tau [s] of `e + tau e' = T u'`, by which each joint of both arms followed its setpoints, NaN where
        unknown; None = not estimated.
    """

    path_hash: str
    cell_hash: str
    points: list[TaughtPoint] = field(default_factory=list)
    laws_s: Floats | None = None

    def update_laws(self, laws_s: Floats) -> None:
        """Take the present estimates of T and tau (J, 2) [s]; values that are no longer estimated are kept."""
        before = np.full(laws_s.shape, math.nan) if self.laws_s is None else self.laws_s
        self.laws_s = np.where(np.isnan(laws_s), before, laws_s)

    def function(self, start: Floats) -> TransformFunction:
        """Function through the points; `start` (4, 4) while there is none."""
        if not self.points:
            return function_of_knots([0.0], start[None])
        ordered = sorted(self.points, key=lambda point: point.s_m)
        return function_of_knots([point.s_m for point in ordered], np.array([point.relation for point in ordered]))

    def to_json(self) -> str:
        """Return the JSON text of the file."""
        rows = [] if self.laws_s is None else self.laws_s.tolist()
        laws = tuple(None if math.isnan(lag_s) else (lag_s, tau_s) for lag_s, tau_s in rows)
        points = tuple(self.points)
        return json_text(
            TaughtPathFile(path_hash=self.path_hash, cell_hash=self.cell_hash, points=points, servo_law_s=laws)
        )


def taught_path_from_json(text: str, where: str) -> TaughtPath:
    """Read taught points.

    Raises
    ------
    InputError
        Not such a file, or a key is missing or of the wrong kind.
    """
    try:
        data = json_object(text, where)
        check_kind(data, SCHEMA, POINTS_KIND, where)
        stored = decoded(TaughtPathFile, data, where)
    except InputError as error:
        raise InputError(f"{error}; {AFRESH}") from error
    unknown = (math.nan, math.nan)
    laws = np.array([unknown if law is None else law for law in stored.servo_law_s]) if stored.servo_law_s else None
    return TaughtPath(stored.path_hash, stored.cell_hash, list(stored.points), laws)


def read_taught_path(path: Path, path_hash: str, cell_hash: str) -> TaughtPath:
    """Taught points of a file, if it is for this path of this cell.

    Raises
    ------
    InputError
        It cannot be read, or is for another one.
    """
    taught_path = taught_path_from_json(text_of(path, AFRESH), str(path))
    if (taught_path.path_hash, taught_path.cell_hash) != (path_hash, cell_hash):
        raise InputError(f"{path}: its points were taught on another path or in another cell; {AFRESH}")
    return taught_path
