"""When a stopping axis comes to rest first, from its positions at the SYNCs; later oscillation does not count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

#: An axis is at rest once its speed is below this share of the speed with which it began to stop.
REST_SHARE: Final = 0.02
#: Change of the position [counts] between two SYNCs that an axis at rest may show.
QUANTUM_COUNTS: Final = 1.5
#: Largest true speed at which the counts of a motor can look at rest, over `QUANTUM_COUNTS` per SYNC: rounding.
_UNSEEN: Final = 5.0 / 3.0
#: Two times that differ by less are of the same SYNC [s].
_SAME_SYNC_S: Final = 1e-4


@dataclass(frozen=True, slots=True)
class Standstill:
    """Bounds of the time until rest [s], and the travel until then [counts].

    Attributes
    ----------
    low_s, high_s : float
    travel : float
        Largest travel at a SYNC.
    most : float
        Largest travel that an axis which is nowhere faster than at the SYNCs around can reach between two of them.
    speed_per_s : float
        Speed at the begin [counts/s].
    """

    low_s: float
    high_s: float
    travel: float
    most: float
    speed_per_s: float


@dataclass(frozen=True, slots=True)
class PositionTrack:
    """Positions of one motor during a test under power.

    Attributes
    ----------
    at_s : array of shape (K,)
        Monotonic time of each SYNC [s].
    count : array of shape (K,)
        Position [counts].
    enabled : array of shape (K,) of bool
        Whether the drive was in OPERATION ENABLED.
    """

    at_s: np.ndarray
    count: np.ndarray
    enabled: np.ndarray

    def until_rest(self, begin_s: float) -> Standstill | None:
        """Return when and where the motor is at rest first; None = it is not.

        That is the first instant at which the speed in the direction of the motion is below `REST_SHARE` of the speed
        at `begin_s`. The first interval between two SYNCs with a lower mean speed ends after it; the interval before
        begins before it. A speed below one count per SYNC is not seen: the upper bound allows for it.
        """
        first = self._index(begin_s)
        speed = np.diff(self.count) / np.diff(self.at_s)
        begin = float(np.median(speed[max(0, first - 3) : max(1, first)]))
        towards = speed * np.sign(begin)
        quantum = QUANTUM_COUNTS / float(np.median(np.diff(self.at_s)))
        unseen = _UNSEEN * quantum / abs(begin) if begin else 0.0
        floor = max(REST_SHARE * abs(begin), quantum)
        slow = np.flatnonzero(towards[first:] <= floor)
        if abs(begin) <= floor or not len(slow):
            return None
        last = first + int(slow[0])
        low_s = float(self.at_s[max(first, last - 1)] - begin_s)
        start = float(np.interp(begin_s, self.at_s, self.count))
        travel = (self.count[first : last + 2] - start) * np.sign(begin)
        high_s = float(self.at_s[last + 1] - begin_s) * (1.0 + unseen)
        fastest = float(np.abs(speed[max(0, first - 1) : last + 2]).max())
        peaks = (travel[:-1] + travel[1:] + fastest * np.diff(self.at_s[first : last + 2])) / 2.0
        farthest = float(travel.max())
        most = max(farthest, float(peaks[-2:].max())) + farthest * unseen**2
        return Standstill(max(0.0, low_s), high_s, farthest, most, abs(begin))

    def _index(self, at_s: float) -> int:
        """Return the index of the first SYNC at or after a time."""
        return min(int(np.searchsorted(self.at_s, at_s - _SAME_SYNC_S)), len(self.at_s) - 3)

    def left_enabled(self) -> tuple[float, float] | None:
        """Return the last SYNC in OPERATION ENABLED and the first one after it; None = it stayed enabled."""
        if not self.enabled.any() or self.enabled[-1]:
            return None
        last = int(np.flatnonzero(self.enabled)[-1])
        return float(self.at_s[last]), float(self.at_s[last + 1])

    def largest_drop(self) -> float | None:
        """Return the largest displacement [counts] while the axis was disabled between two times enabled."""
        enabled = np.flatnonzero(self.enabled)
        if not len(enabled):
            return None
        inside = np.arange(enabled[0], enabled[-1])
        held, most, found = float(self.count[enabled[0]]), 0.0, False
        for index in inside:
            if self.enabled[index]:
                held = float(self.count[index])
            else:
                found, most = True, max(most, abs(float(self.count[index]) - held))
        return most if found else None


def first_after(times_s: Sequence[float], at_s: float) -> float | None:
    """Return the first of the times at or after an instant."""
    return next((time_s for time_s in times_s if time_s >= at_s), None)
