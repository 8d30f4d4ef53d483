"""Texts of validation errors of TOML files: the allowed form of a key, and the error of its value."""

from __future__ import annotations

import difflib
import json
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from drives.toml_lines import KeyPath

#: Fields of a table that is written within braces.
_SHORT: Final = 3
#: Least likeness of a key that is suggested, and the most keys that are listed instead.
_NEAR: Final = 0.6
_LISTED: Final = 10
#: Longest text of a value that is shown.
_SHOWN: Final = 40

_LIMITS: Final = {
    "greater_than": ("gt", "must be more than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}


@dataclass(frozen=True, slots=True)
class FieldPlace:
    """Target of a key path in a model: the part of the path that the model defines, the allowed type, and the field."""

    path: KeyPath
    kind: Any
    info: FieldInfo | None


def field_at(model: type[BaseModel], path: KeyPath) -> FieldPlace:
    """Return the target of a key path; it ends at the union members that pydantic appends."""
    kind: Any = model
    info: FieldInfo | None = None
    for length, part in enumerate(path):
        inner, inside = _inner_type(kind, part)
        if inner is None:
            return FieldPlace(path[:length], kind, info)
        kind, info = inner, inside or info
    return FieldPlace(path, kind, info)


def _inner_type(kind: Any, part: str | int) -> tuple[Any, FieldInfo | None]:
    for each in _alternatives(kind):
        origin, arguments = typing.get_origin(each), typing.get_args(each)
        if isinstance(each, type) and issubclass(each, BaseModel):
            if part in each.model_fields:
                info = each.model_fields[str(part)]
                return info.annotation, info
        elif origin is tuple and isinstance(part, int):
            many = len(arguments) == 2 and arguments[1] is Ellipsis
            if many or part < len(arguments):
                return arguments[0 if many else part], None
        elif origin is dict and isinstance(part, str):
            return arguments[1], None
    return None, None


def _alternatives(kind: Any) -> list[Any]:
    """Return the types that a value may have, without None and without constraints."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _alternatives(arguments[0])
    if origin in (types.UnionType, typing.Union):
        return [each for argument in arguments if argument is not type(None) for each in _alternatives(argument)]
    return [kind]


def written(kind: Any, stated: Any = None) -> str:
    """Return an example in TOML of a value of a type, with the given values: `{ value = 101, source = "..." }`."""
    first = _alternatives(kind)[0]
    origin, arguments = typing.get_origin(first), typing.get_args(first)
    if isinstance(first, type) and issubclass(first, BaseModel):
        return _table(first, stated)
    if origin is Literal:
        return " or ".join(json.dumps(argument) for argument in arguments)
    if origin is tuple:
        many = len(arguments) == 2 and arguments[1] is Ellipsis
        parts = [written(argument) for argument in (arguments[:1] if many else arguments)]
        return f"[{', '.join([*parts, '...'] if many else parts)}]"
    if origin is dict:
        return f"{{ NAME = {written(arguments[1])} }}"
    return {int: "INTEGER", float: "NUMBER", bool: "true", str: '"..."'}.get(first, '"..."')


def _table(model: type[BaseModel], stated: Any) -> str:
    values = stated if isinstance(stated, Mapping) else {}
    cells = []
    for key, info in model.model_fields.items():
        if not info.is_required() and key not in values:
            continue
        value = values.get(key)
        if value is None and not cells and isinstance(stated, int | float | str):
            value = stated
        cells.append(f"{key} = {written(info.annotation) if value is None else _shown(value)}")
    return f"{{ {', '.join(cells)} }}"


def _is_short(kind: Any) -> bool:
    """Return whether a type is written as an inline table."""
    first = _alternatives(kind)[0]
    return isinstance(first, type) and issubclass(first, BaseModel) and len(first.model_fields) <= _SHORT


def _is_table(kind: Any) -> bool:
    """Return whether a type is written as a table with its own header."""
    first = _alternatives(kind)[0]
    if typing.get_origin(first) in (tuple, dict):
        return _is_table(typing.get_args(first)[-1 if typing.get_origin(first) is dict else 0])
    return isinstance(first, type) and issubclass(first, BaseModel) and not _is_short(first)


def _header(path: KeyPath, kind: Any) -> str:
    """Return the table header of a path, e.g. `[[arm.axis]]`."""
    name = ".".join(str(part) for part in path if isinstance(part, str))
    origin = typing.get_origin(_alternatives(kind)[0])
    return f"[[{name}]]" if origin is tuple else f"[{name}.NAME]" if origin is dict else f"[{name}]"


def _shown(value: Any) -> str:
    text = "{ .. }" if isinstance(value, dict) else json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}.."


def problem_text(model: type[BaseModel], data: Mapping[str, Any], path: KeyPath, detail: Mapping[str, Any]) -> str:
    """Return the text of one problem: the key, its error, and what to write."""
    kind = detail["type"]
    if kind == "missing" and isinstance(path[-1], int):
        path = path[:-1]
        kind = "too_short"
        detail = {"type": kind, "ctx": {"min_length": len(typing.get_args(field_at(model, path).kind))}}
    key = str(path[-1]) if path else "file"
    if kind == "extra_forbidden":
        return _unknown(model, path)
    if kind == "value_error":
        return str(detail["msg"]).removeprefix("Value error, ")
    place, above = field_at(model, path), field_at(model, path[:-1])
    owner = ""
    if path[:-1] and _is_short(above.kind) and isinstance(path[-1], str):
        name = next(str(part) for part in reversed(path[:-1]) if isinstance(part, str))
        if kind == "missing":
            return f"{name}: {key} is missing: write {name} = {written(above.kind, _stated(data, path[:-1]))}"
        owner = f"{name}: "
    if isinstance(path[-1] if path else "", int):
        key = "".join(f"[{part}]" if isinstance(part, int) else part for part in _tail(path))
    if kind == "missing":
        return f"{key} is missing{_meaning(place.info)}: write {_assignment(path, place, None)}"
    if kind == "string_pattern_mismatch" and place.info is not None:
        form = place.info.description or "see the reference"
        return f"{key} = {_shown(_stated(data, path))} is of no known form: {form}"
    stated = _stated(data, path)
    wrong = f"{key} = {_shown(stated)} {_wrong(detail, place.kind)}"
    return f"{owner}{wrong}: write {_assignment(_tail(path), place, stated)}"


def _tail(path: KeyPath) -> KeyPath:
    """Return the last key of a path with the indices behind it."""
    start = max((number for number, part in enumerate(path) if isinstance(part, str)), default=0)
    return path[start:]


def _assignment(path: KeyPath, place: FieldPlace, stated: Any) -> str:
    if _is_table(place.kind):
        return f"a table {_header(path, place.kind)}"
    value = written(place.kind, stated)
    bounds = place.info.metadata if place.info else ()
    limits = [str(getattr(each, name)) for name in ("ge", "le") for each in bounds if hasattr(each, name)]
    if value == "INTEGER" and len(limits) == 2:
        value = " to ".join(limits)
    return value if isinstance(path[-1], int) else f"{path[-1]} = {value}"


def _stated(data: Mapping[str, Any], path: KeyPath) -> Any:
    value: Any = data
    for part in path:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def _meaning(info: FieldInfo | None) -> str:
    return f" ({info.description})" if info is not None and info.description else ""


def _unknown(model: type[BaseModel], path: KeyPath) -> str:
    key = str(path[-1])
    above = [each for each in _alternatives(field_at(model, path[:-1]).kind) if isinstance(each, type)]
    known = [name for each in above if issubclass(each, BaseModel) for name in each.model_fields]
    near = difflib.get_close_matches(key, known, n=1, cutoff=_NEAR)
    listed = f", or write one of {', '.join(known)}" if len(known) <= _LISTED else "; the reference lists what is known"
    advice = f"write {near[0]}" if near else f"remove it{listed}"
    return f"{key}: unknown key (units are part of the name): {advice}"


def _wrong(detail: Mapping[str, Any], kind: Any) -> str:
    problem, ctx = detail["type"], detail.get("ctx", {})
    if problem in _LIMITS:
        key, words = _LIMITS[problem]
        return f"{words} {ctx[key]:g}"
    if problem in ("too_short", "string_too_short"):
        return f"is too short, at least {ctx.get('min_length', 1)} are needed"
    if problem == "too_long":
        return f"is too long, at most {ctx['max_length']} are allowed"
    if problem == "finite_number":
        return "is not a finite number"
    if problem == "literal_error":
        return "is not an allowed value"
    return f"is no {' and no '.join(dict.fromkeys(map(_name, _alternatives(kind))))}"


def _name(kind: Any) -> str:
    origin = typing.get_origin(kind)
    if origin is tuple:
        return "list"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "table"
    if origin is Literal:
        return "word that is known"
    return {int: "integer", float: "number", bool: "true or false", str: "text in quotes"}.get(kind, "table")


def placeholder(kind: Any, info: FieldInfo | None) -> Any:
    """Return a valid dummy value, inserted only so that further checks can run."""
    first = _alternatives(kind)[0]
    origin, arguments = typing.get_origin(first), typing.get_args(first)
    if isinstance(first, type) and issubclass(first, BaseModel):
        fields = first.model_fields.items()
        return {key: placeholder(each.annotation, each) for key, each in fields if each.is_required()}
    if origin is Literal:
        return arguments[0]
    if origin is tuple:
        many = len(arguments) == 2 and arguments[1] is Ellipsis
        return [placeholder(arguments[0], None)] * 2 if many else [*range(1 - len(arguments), 1)]
    if origin is dict:
        return {"a": placeholder(arguments[1], None)}
    if first is int:
        # the largest that is allowed: unlikely to be the node id of another axis
        return next((each.le for each in (info.metadata if info else ()) if hasattr(each, "le")), 1)
    return {float: 1.0, bool: False}.get(first, "exact")
