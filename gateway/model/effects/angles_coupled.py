"""Effect: the reported angle of a joint includes that of the previous joint, as in controllers of parallel linkages."""

from __future__ import annotations

from typing import Final

from gateway.model.effect import Effect

EFFECT: Final = Effect(
    name="angles_coupled",
    words="coupled joint angles",
    meaning="the angle of the second joint is reported with that of the first added or subtracted",
    parameters=("sign",),
    mistake=(
        "the angle of the second joint is reported with that of the first added or subtracted",
        "write the angle between the two links into its column",
    ),
)
