"""Effect: the positive direction of a joint differs from the robot model, in position and in torque."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="joint_reversed",
    words="a joint with reversed direction",
    meaning="the positive direction of a joint is opposite to the robot model, in position and torque",
    mistake=(
        "position and torque have the opposite sign of the robot model",
        "change position_sign and torque_sign of this axis in the cell file, or change the signs of its columns",
    ),
)
