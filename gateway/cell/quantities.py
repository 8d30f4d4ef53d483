"""Number types of the cell file."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds a control character: write printable text")
    return text


#: A name that reaches terminals, pages and files.
PlainName = Annotated[str, AfterValidator(_printable)]
#: Of a place, a direction or a turn: larger is a slip, and overflows further on.
_Component = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector3 = tuple[_Component, _Component, _Component]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
