"""What all tables of the cell file are made of: frozen, no unknown key, no number that is none."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

#: Of a place, a direction or a turn: larger is a slip, and overflows further on.
_Component = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector3 = tuple[_Component, _Component, _Component]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Strict(BaseModel):
    """A table of the cell file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
