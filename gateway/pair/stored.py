"""A transform function and its file, with units, frames, source, speed, date, and what it is valid for.

A function belongs to one path in one cell; for any other it is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gateway.errors import InputError
from gateway.pair.function import TransformFunction
from gateway.result.pair import FUNCTION_KIND, KNOT_UNITS, SCHEMA, FunctionFile, FunctionKnot, Stage
from gateway.result.values import check_kind, decoded, json_object, json_text, matrix, numbers, text_of


@dataclass(frozen=True, slots=True, eq=False)
class StoredFunction:
    """A function and its origin, in the words of `gateway.result.pair.FunctionFile`."""

    function: TransformFunction
    path_hash: str
    cell_hash: str
    stage: Stage
    learn_source: str
    speed: float
    date: str
    embodiment: str = ""
    cycles: int = 0


def to_json(stored: StoredFunction) -> str:
    """Text of the file."""
    function = stored.function
    knots = zip(function.s_m, function.position_m, function.rotation, strict=True)
    return json_text(
        FunctionFile(
            stage=stored.stage,
            learn_source=stored.learn_source,
            speed=stored.speed,
            date=stored.date,
            embodiment=stored.embodiment,
            cycles=stored.cycles,
            path_hash=stored.path_hash,
            cell_hash=stored.cell_hash,
            knots=tuple(FunctionKnot(float(way), numbers(place), matrix(turn)) for way, place, turn in knots),
        )
    )


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
        Not such a file, a key missing or of the wrong kind, knots out of order, matrices that are no rotations.
    """
    data = json_object(text, where)
    check_kind(data, SCHEMA, FUNCTION_KIND, where)
    file = decoded(FunctionFile, data, where)
    if file.units != KNOT_UNITS:
        raise InputError(f"{where}: units {file.units!r}, expected {KNOT_UNITS}")
    columns = [[getattr(knot, key) for knot in file.knots] for key in KNOT_UNITS]
    try:
        function = TransformFunction(*columns)
    except (InputError, ValueError) as error:
        raise InputError(f"{where}: {error}") from error
    return StoredFunction(
        function=function,
        path_hash=file.path_hash,
        cell_hash=file.cell_hash,
        stage=file.stage,
        learn_source=file.learn_source,
        speed=file.speed,
        date=file.date,
        embodiment=file.embodiment,
        cycles=file.cycles,
    )


def refuse_foreign(stored: StoredFunction, path_hash: str, cell_hash: str, where: str) -> None:
    """Make sure that a stored function is for this path and this cell.

    Raises
    ------
    InputError
        Says which of both differs, and what to do.
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
