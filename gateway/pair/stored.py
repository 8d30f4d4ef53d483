"""A transform function as a file: JSON with units, frames, source, speed, date, and what it is valid for.

A function belongs to one path in one cell; for any other it is refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.errors import InputError
from gateway.pair.function import TransformFunction

SCHEMA = 1
KIND = "servo-gateway transform function"
UNITS = {"s_m": "m", "position_m": "m", "rotation": "1"}
FRAMES = {"from": "gripper of the master (E1)", "to": "gripper of the slave (E2)"}
#: Largest speed setting that a function may have been learned at.
FASTEST = 1e3
STAGES = ("first", "second")


@dataclass(frozen=True, slots=True, eq=False)
class StoredFunction:
    """A function and its origin.

    Attributes
    ----------
    function : TransformFunction
    path_hash, cell_hash : what it is valid for (hexadecimal)
    stage : "first" (taught) or "second" (learned)
    learn_source : "taught", "command", "measured" or "master_measured"
    speed : speed setting of the path it was learned at, 0 = at rest
    date : ISO 8601
    embodiment : name of the row it was learned with
    cycles : cycles it was learned from
    """

    function: TransformFunction
    path_hash: str
    cell_hash: str
    stage: str
    learn_source: str
    speed: float
    date: str
    embodiment: str = ""
    cycles: int = 0


def to_json(stored: StoredFunction) -> str:
    """Text of the file."""
    function = stored.function
    document = {
        "kind": KIND,
        "schema": SCHEMA,
        "units": UNITS,
        "frames": FRAMES,
        "interpolation": "straight line; turn about a fixed axis",
        "stage": stored.stage,
        "learn_source": stored.learn_source,
        "speed": stored.speed,
        "date": stored.date,
        "embodiment": stored.embodiment,
        "cycles": stored.cycles,
        "path_hash": stored.path_hash,
        "cell_hash": stored.cell_hash,
        "knots": [
            {"s_m": way, "position_m": place, "rotation": turn}
            for way, place, turn in zip(
                function.s_m.tolist(), function.position_m.tolist(), function.rotation.tolist(), strict=True
            )
        ],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def read_stored(path: Path) -> StoredFunction:
    """Read the file of a function.

    Raises
    ------
    InputError
        It cannot be read, or as `from_json`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; teach or learn it again") from error
    return from_json(text, str(path))


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
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not readable as JSON: {error}") from error
    if not isinstance(document, dict) or document.get("kind") != KIND:
        raise InputError(f"{where}: is no stored transform function")
    if document.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema {document.get('schema')!r}, this program reads {SCHEMA}")
    if document.get("units") != UNITS:
        raise InputError(f"{where}: units {document.get('units')!r}, expected {UNITS}")
    stage = _text(document, "stage", where)
    if stage not in STAGES:
        raise InputError(f"{where}: stage '{stage}' is neither of {', '.join(STAGES)}")
    return StoredFunction(
        function=_function(document, where),
        path_hash=_text(document, "path_hash", where),
        cell_hash=_text(document, "cell_hash", where),
        stage=stage,
        learn_source=_text(document, "learn_source", where),
        speed=_speed(document, where),
        date=_text(document, "date", where),
        embodiment=_text(document, "embodiment", where) if document.get("embodiment") else "",
        cycles=int(document["cycles"]) if isinstance(document.get("cycles"), int) else 0,
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


def _function(document: Mapping[str, Any], where: str) -> TransformFunction:
    knots = document.get("knots")
    if not isinstance(knots, list) or not knots or not all(isinstance(knot, dict) for knot in knots):
        raise InputError(f"{where}: knots are missing")
    try:
        columns = [[knot[key] for knot in knots] for key in UNITS]
        return TransformFunction(*columns)
    except KeyError as error:
        raise InputError(f"{where}: a knot has no {error}") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from error


def _text(document: Mapping[str, Any], key: str, where: str) -> str:
    value = document.get(key)
    if not isinstance(value, str) or not value.isprintable() or not value:
        raise InputError(f"{where}: {key} is missing")
    return value


def _speed(document: Mapping[str, Any], where: str) -> float:
    value = document.get("speed")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= FASTEST:
        raise InputError(f"{where}: speed must be a number, not negative, got {value!r}")
    return float(value)


def _short(digest: str) -> str:
    return digest[:12]
