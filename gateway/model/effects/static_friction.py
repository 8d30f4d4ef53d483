"""Effect: static friction that differs between the two directions; one-sided visits are its evidence."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect, Over

EFFECT: Final = Effect(
    name="static_friction",
    words="friction that differs by direction",
    meaning="friction at rest differs between the two directions",
    parameters=("bias_nm",),
    over=Over.TORQUE,
)
