"""An rms value was taken for a peak value or the reverse: a factor of sqrt 2 that a wrong constant seldom has."""

from __future__ import annotations

import math
from typing import Final

from gateway.model.effect import Effect

#: Reported over true current.
FACTOR: Final = math.sqrt(2.0)
#: How near a scale has to be to it, and in its own standard deviations.
TOLERANCE: Final = 0.05
WITHIN: Final = 3.0


def is_rms_peak(scale: float, std: float) -> bool:
    """Whether a scale of the torque (true over stored) with its standard deviation is this mistake."""
    near = min(abs(scale * factor - 1.0) for factor in (FACTOR, 1.0 / FACTOR))
    return near < min(TOLERANCE, WITHIN * std / scale)


EFFECT: Final = Effect(
    name="current_rms_peak",
    words="rms and peak current confused",
    meaning="an rms value was taken for a peak value or the reverse",
    parameters=("factor",),
    mistake=(
        "current is off by a factor of sqrt 2: an rms value was taken for a peak value or the reverse",
        "check current_reference and torque_constant_per of the drive profile",
    ),
)
