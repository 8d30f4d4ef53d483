"""Whether an axis is at rest, and how far it sinks in its brake, from the positions that its drive reports."""

from __future__ import annotations

import math
from typing import Final

#: An axis is at rest when its motor has stayed within so many revolutions for so long [s]: a braked axis shakes while
#: others are stopped.
STILL_REVOLUTIONS: Final = 0.003
STILL_S: Final = 0.05
#: The same as a share of what the motor travelled in that time at its largest speed: less with a low gear ratio.
_STILL_SHARE: Final = 0.2
#: It is not made smaller than a tenth, or than the counts by which a standing axis flickers.
_LEAST_SHARE, _LEAST_COUNTS = 0.1, 4.0
#: Rounding of a sum of SYNC periods [s].
_TIME_TOLERANCE_S: Final = 1e-9
#: A brake holds where its axis did not sink in this time with the voltage off [s].
BRAKE_WATCH_S: Final = 0.3


class Standstill:
    """Test of rest of one axis; a new one has seen nothing, and the axis is not at rest.

    Parameters
    ----------
    turn_count : float
        Position counts of one motor revolution.

    Attributes
    ----------
    moving_s : float
        Time at which the axis last left the range in which it counts as at rest [s].
    """

    def __init__(self, turn_count: float) -> None:
        self.moving_s = 0.0
        self._most_count = abs(turn_count) * STILL_REVOLUTIONS
        self._least_count = max(_LEAST_SHARE * self._most_count, _LEAST_COUNTS)
        self._allowed_count = self._least_count
        self._seen_s, self._last_count = -math.inf, 0
        self._low, self._high = math.inf, -math.inf

    def see(self, time_s: float, count: int) -> None:
        """Process a position [counts] and its time [s], which does not decrease."""
        if self._allowed_count < self._most_count and count != self._last_count and time_s > self._seen_s > -math.inf:
            # not less than one step: at a slow SYNC an axis that flickers is at rest as well
            step = abs(count - self._last_count) * max(_STILL_SHARE * STILL_S / (time_s - self._seen_s), 1.0)
            self._allowed_count = max(self._allowed_count, min(step, self._most_count))
        if count < self._low:
            self._low = count
        if count > self._high:
            self._high = count
        if self._high - self._low > self._allowed_count or self._seen_s == -math.inf:
            self._low = self._high = count
            self.moving_s = time_s
        self._seen_s, self._last_count = time_s, count

    def at_rest(self, since_s: float = -math.inf) -> bool:
        """Return whether the axis is at rest, by positions from a moment on [s]."""
        return self._seen_s - max(self.moving_s, since_s) >= STILL_S - _TIME_TOLERANCE_S


class BrakeDrop:
    """Movement of one axis since its drive last held it: how far it sank in its brake.

    Parameters
    ----------
    held_count : int or None
        Position at which the drive holds the axis [counts]; None = the first one that is seen.

    Attributes
    ----------
    moved_count, most_count : int
        Distance from the last held position, now and at most [counts].
    off_syncs : int
        SYNCs at which the axis was seen with the voltage off.
    """

    def __init__(self, held_count: int | None) -> None:
        self.moved_count = self.most_count = self.off_syncs = 0
        self._held_count = held_count

    def see(self, count: int, *, is_held: bool, is_off: bool) -> None:
        """Process a position [counts], whether the drive holds the axis there, and whether the voltage is off."""
        if is_held or self._held_count is None:
            self._held_count = count
        self.moved_count = abs(count - self._held_count)
        self.most_count = max(self.most_count, self.moved_count)
        self.off_syncs += is_off
