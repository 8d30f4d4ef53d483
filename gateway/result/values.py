"""JSON files of the program: conversion of values, and errors that name the key.

NaN means "unknown" and is null in the file. A field marked `SILENT` is omitted from the file if it is empty.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, TypeAdapter, ValidationError, WithJsonSchema
from pydantic_core import ErrorDetails

from gateway.errors import InputError

NAN: Final = math.nan
Model = TypeVar("Model")


def _nan_if_null(value: Any) -> Any:
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        return math.inf
    return NAN if value is None else value


def _not_infinite(value: float) -> float:
    if math.isinf(value):
        raise ValueError("a number that is too large to hold")
    return value


#: A number, or NaN = unknown, which is null in the file.
Number = Annotated[
    float, BeforeValidator(_nan_if_null), AfterValidator(_not_infinite), WithJsonSchema({"type": ["number", "null"]})
]
Numbers = tuple[Number, ...]
Matrix = tuple[Numbers, ...]


def three(values: Numbers) -> Numbers:
    """Return the values if they are three numbers; raise ValueError otherwise."""
    if len(values) != 3:
        raise ValueError(f"three numbers are needed, got {len(values)}")
    return values


#: A place or its standard deviation.
Vector = Annotated[Numbers, AfterValidator(three)]


def check_lengths(**lists: Sequence[object]) -> None:
    """Check that lists of one table have equal lengths; an empty list counts as absent.

    Raises
    ------
    ValueError
        Names the lists with their lengths.
    """
    lengths = {name: len(values) for name, values in lists.items() if len(values)}
    if len(set(lengths.values())) > 1:
        raise ValueError("lists of one length are needed: " + ", ".join(f"{k} has {n}" for k, n in lengths.items()))


def numbers(values: ArrayLike) -> Numbers:
    """Return the plain numbers of an array of shape (n,)."""
    return tuple(np.asarray(values, dtype=float).tolist())


def matrix(values: ArrayLike) -> Matrix:
    """Return the plain rows of an array of shape (n, m)."""
    return tuple(tuple(row) for row in np.asarray(values, dtype=float).tolist())


# -- out ---------------------------------------------------------------------------------------------------------------


def plain_values(value: Any) -> Any:
    """Return plain values for JSON: dataclasses as dictionaries, arrays as lists, NaN and infinity as None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = ((item, plain_values(getattr(value, item.name))) for item in dataclasses.fields(value))
        return {
            item.name: plain
            for item, plain in items
            if not item.metadata.get("silent") or (plain is not None and plain not in ("", [], {}))
        }
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_values(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(value: Any) -> str:
    """Return the JSON text of a model, one value per line."""
    return json.dumps(plain_values(value), indent=1, allow_nan=False) + "\n"


def schema_of(model: type) -> dict[str, Any]:
    """Return the JSON schema of a model's file."""
    schema = plain_values(_adapter(model).json_schema())
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


# -- in ----------------------------------------------------------------------------------------------------------------


def text_of(path: Path, advice: str) -> str:
    """Return the text of a file.

    Raises
    ------
    InputError
        It cannot be read; `advice` says what to do.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; {advice}") from error


def json_object(text: str, where: str) -> dict[str, Any]:
    """Parse a JSON text that must be one object.

    Raises
    ------
    InputError
        Not JSON, or not an object.
    """
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{where}:{error.lineno}: not valid JSON: {error.msg}; name a JSON file") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: contains a number or a nesting that is too large: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{where}: one JSON object is expected, this is {_kind_of(data)}")
    return data


def check_kind(data: Mapping[str, Any], schema: int, where: str, *kinds: str) -> None:
    """Raise an error if a file has another version or is of none of these kinds; a result alone has no kind.

    Raises
    ------
    InputError
        Says which is expected.
    """
    held = data.get("kind")
    if held not in (kinds or (None,)):
        wanted = f"a file of kind {' or '.join(map(repr, kinds))}" if kinds else "a result of `estimate` or `diagnose`"
        raise InputError(f"{where}: is not {wanted}" + ("" if held is None else f", but of kind {held!r}"))
    if data.get("schema") != schema:
        raise InputError(f"{where}: schema: this version reads schema {schema}, the file says {data.get('schema')!r}")


def decoded(model: type[Model], data: Mapping[str, Any], where: str) -> Model:
    """Return a model from plain values; unknown keys are ignored.

    Raises
    ------
    InputError
        A key is missing or of the wrong kind: named with its path.
    """
    try:
        return _adapter(model).validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        raise InputError(f"{where}: {_path(problem['loc'])}{_in_words(problem)}") from error


@cache
def _adapter(model: type[Model]) -> TypeAdapter[Model]:
    return TypeAdapter(model)


def _path(place: tuple[int | str, ...]) -> str:
    """Return the key path, such as `loads[0].mass_kg: `."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    return f"{text}: " if text else ""


_EXPECTED = {
    "float_type": "a number or null",
    "string_type": "text",
    "int_type": "an integer",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "dict_type": "an object",
    "dataclass_type": "an object",
}


def _in_words(problem: ErrorDetails) -> str:
    kind, stated = problem["type"], problem["input"]
    if kind == "missing":
        return "the key is missing"
    if kind == "literal_error":
        return f"{stated!r} is not {problem['ctx']['expected'] if 'ctx' in problem else 'one of the words'}"
    if kind in _EXPECTED:
        return f"expected {_EXPECTED[kind]}, got {_kind_of(stated)}"
    return problem["msg"].removeprefix("Value error, ")


def _kind_of(value: Any) -> str:
    """Return the name of the type of a value, for messages."""
    return "null" if value is None else f"{type(value).__name__} {value!r}"[:80]
