"""The zero of a joint is a quarter or half a turn from that of the robot model, as other conventions have it."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="zero_convention",
    words="another zero convention",
    meaning="the zero of a joint is a multiple of 90 degrees from that of the robot model",
    parameters=("offset_rad",),
    mistake=(
        "the zero of this joint is a multiple of 90 degrees from that of the robot model",
        "correct `zero_offset_rad` in the cell file, or the angles of this joint in the table",
    ),
)
