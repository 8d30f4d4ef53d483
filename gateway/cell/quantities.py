"""Numbers as the cell file may hold them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

#: Of a place, a direction or a turn: larger is a slip, and overflows further on.
_Component = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector3 = tuple[_Component, _Component, _Component]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
