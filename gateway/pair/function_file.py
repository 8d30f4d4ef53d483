"""A transform function and its file, with units, frames, source, speed, date, and what it is valid for.

A function belongs to one path in one cell; for any other it is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gateway.errors import InputError
from gateway.pair.transform_function import TransformFunction
from gateway.result.pair import FUNCTION_KIND, KNOT_UNITS, SCHEMA, FunctionKnot, StoredFunction
from gateway.result.values import check_kind, decoded, json_object, matrix, numbers, text_of


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
    check_kind(data, SCHEMA, FUNCTION_KIND, where)
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
