"""Numbers of the cell file, and the text that states a relative standard deviation."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from gateway.errors import ConfigError

#: Of a place, a direction or a turn: larger is a slip, and overflows further on.
_Component = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector3 = tuple[_Component, _Component, _Component]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds a control character: write printable text")
    return text


#: A name that reaches terminals, pages and files.
PlainName = Annotated[str, AfterValidator(_printable)]


def relative_std(text: str) -> float | None:
    """Return the standard deviation of `S` or `prior:S`, `exact` (0) or `ignore` (infinite); None for other text."""
    named = {"exact": 0.0, "ignore": math.inf}
    if text in named:
        return named[text]
    try:
        std = float(text.removeprefix("prior:"))
    except ValueError:
        return None
    return std if math.isfinite(std) and (std > 0 or text == "0") else None


def parse_inertials(text: str) -> float:
    """Return the relative standard deviation of the link inertials that `S`, `prior:S`, `exact` or `ignore` states.

    Raises
    ------
    ConfigError
        Anything else.
    """
    std = relative_std(text)
    if std is None:
        raise ConfigError(f"inertials '{text}': use a relative standard deviation such as 0.05, 0 or exact, or ignore")
    return std


def inertials_text(std: float) -> str:
    """Return the text that `parse_inertials` reads as this standard deviation."""
    return "exact" if std == 0 else f"prior:{std:g}" if math.isfinite(std) else "ignore"
