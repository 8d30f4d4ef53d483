"""A joint is counted the other way than in the robot model, in position and in torque."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="joint_reversed",
    words="a joint counted the other way",
    meaning="a joint turns the other way than in the robot model, in position and torque",
    mistake=(
        "position and torque are counted the other way than in the robot model",
        "turn position_sign and torque_sign of this axis in the cell file, or change the signs of its columns",
    ),
)
