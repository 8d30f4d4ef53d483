"""What a value of a TOML file has to be, in words, from the type that its model states."""

from __future__ import annotations

import types
import typing
from typing import Any, Literal

from pydantic import BaseModel


def kind_in_words(kind: Any) -> str:
    """What a value has to be."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return kind_in_words(arguments[0])
    if origin is Literal:
        return " or ".join(f"`{each!r}`".replace("'", '"') for each in arguments)
    if origin in (types.UnionType, typing.Union):
        return " or ".join(kind_in_words(each) for each in arguments if each is not type(None))
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return f"list: {kind_in_words(arguments[0])}"
        return f"{len(arguments)} x {kind_in_words(arguments[0])}"
    if origin is dict:
        return f"by name: {kind_in_words(arguments[1])}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        fields = [key for key, info in kind.model_fields.items() if info.is_required()]
        return f"table ({', '.join(fields)})" if len(kind.model_fields) <= 3 else "table"
    return {int: "integer", float: "number", str: "text", bool: "true or false"}[kind]
