"""Effect: the zero of a joint differs by a quarter or half turn from the robot model, as in other conventions."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="zero_convention",
    words="another zero convention",
    meaning="the zero of a joint differs from the robot model by a multiple of 90 degrees",
    parameters=("offset_rad",),
    mistake=(
        "the zero of this joint differs from the robot model by a multiple of 90 degrees",
        "correct `zero_offset_rad` in the cell file, or the angles of this joint in the table",
    ),
)
