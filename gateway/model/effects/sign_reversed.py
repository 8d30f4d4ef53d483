"""Effect: a drive reports torque with the wrong sign, so that friction seems to drive the joint."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="sign_reversed",
    words="a reversed torque sign",
    meaning="a drive reports torque with the wrong sign",
    mistake=("torque sign is reversed", "change torque_sign of this axis in the cell file, or check its wiring"),
)
