"""Values of a JSON file as annotated types: dataclasses, tuples, mappings, numbers; null is an unknown number."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from typing import Any

from gateway.errors import InputError


def decode(kind: Any, value: Any, where: str) -> Any:
    """A value as an annotated type.

    Parameters
    ----------
    kind : type
        Dataclass, tuple of one type, mapping, union with None, or scalar.
    value : Any
        As `json` gives it.
    where : str
        Path of the value, for messages.

    Raises
    ------
    InputError
        It is of another kind; its path is named.
    """
    if kind is Any:
        return value
    if dataclasses.is_dataclass(kind):
        return _record(typing.cast(type, kind), value, where)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        return (
            None if value is None else decode(next(item for item in arguments if item is not type(None)), value, where)
        )
    if origin is tuple:
        if not isinstance(value, list):
            raise InputError(f"{where}: expected a list, got {kind_of(value)}")
        return tuple(decode(arguments[0], item, f"{where}[{index}]") for index, item in enumerate(value))
    if origin is Mapping:
        if not isinstance(value, dict):
            raise InputError(f"{where}: expected an object, got {kind_of(value)}")
        return {key: decode(arguments[1], item, f"{where}.{key}") for key, item in value.items()}
    return _scalar(kind, value, where)


def _scalar(kind: type, value: Any, where: str) -> Any:
    if kind is float:
        if value is None:
            return math.nan
        if isinstance(value, int | float) and not isinstance(value, bool):
            return _number(value, where)
        raise InputError(f"{where}: expected a number or null, got {kind_of(value)}")
    if kind is int and isinstance(value, bool) or not isinstance(value, kind):
        raise InputError(f"{where}: expected {kind.__name__}, got {kind_of(value)}")
    return value


def _number(value: int | float, where: str) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise InputError(f"{where}: a number that is too large to hold") from error


def _record(kind: type, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected an object, got {kind_of(value)}")
    hints = typing.get_type_hints(kind)
    arguments = {}
    for item in dataclasses.fields(kind):
        if item.name in value:
            arguments[item.name] = decode(hints[item.name], value[item.name], _join(where, item.name))
        elif item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING:
            raise InputError(f"{where}: the key '{item.name}' is missing")
    return kind(**arguments)


def _join(where: str, key: str) -> str:
    return f"{where}: {key}" if ": " not in where else f"{where}.{key}"


def kind_of(value: Any) -> str:
    """A value in words, for messages."""
    return "null" if value is None else f"{type(value).__name__} {value!r}"[:80]
