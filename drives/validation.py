"""Files that people write, read through pydantic: what their tables have in common, and problems in words."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, ValidationError


class Strict(BaseModel):
    """A table of a file: frozen, no unknown key, no number that is none."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def problems_in_words(error: ValidationError) -> str:
    """Every problem with its key: `arm.0.name: is missing; ..`."""
    lines = []
    for problem in error.errors(include_url=False):
        key = ".".join(str(part) for part in problem["loc"]) or "file"
        message = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            message = "unknown key; remove it or correct its spelling (units are part of the name)"
        elif problem["type"] == "missing":
            message = "is missing; nothing is assumed in its place"
        lines.append(f"{key}: {message}")
    return "; ".join(lines)
