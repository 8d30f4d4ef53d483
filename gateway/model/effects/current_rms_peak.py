"""Effect: an rms current was interpreted as a peak value or the reverse: a factor of sqrt 2, rare for a wrong
constant.
"""

from __future__ import annotations

import math
from typing import Final

from gateway.model.effect import Effect

#: Reported divided by true current.
FACTOR: Final = math.sqrt(2.0)
#: Largest relative distance of a scale from that factor, and largest distance in standard deviations.
TOLERANCE: Final = 0.05
WITHIN: Final = 3.0


def is_rms_peak(scale: float, std: float) -> bool:
    """Return True if a torque scale (true divided by stored) agrees with this error within its standard deviation."""
    near = min(abs(scale * factor - 1.0) for factor in (FACTOR, 1.0 / FACTOR))
    return near < min(TOLERANCE, WITHIN * std / scale)


EFFECT: Final = Effect(
    name="current_rms_peak",
    words="rms and peak current confused",
    meaning="an rms value is used as a peak value or the reverse",
    parameters=("factor",),
    mistake=(
        "current is wrong by a factor of sqrt 2: an rms value is used as a peak value or the reverse",
        "check current_reference and torque_constant_per of the drive profile",
    ),
)
