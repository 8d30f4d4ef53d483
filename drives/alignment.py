"""Assign a TPDO to its SYNC when an earlier TPDO of the same node is missing.

TPDOs carry no SYNC number, but each node responds in order. A missing TPDO may still be in transit, and would be taken
for the answer to the next SYNC. Its frames are not assigned until as many have come as SYNCs were sent, or until three
SYNCs in a row have brought exactly one frame each, as soon as usual: then the missing one is lost.

In lockstep simulated time does not pass while a second frame is waited for, so a frame that stays alone is assigned.
The missing one counts as lost after more SYNCs, because they are sent faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

#: SYNCs in a row with exactly one frame, in the usual time, after which a missing frame counts as lost: in real time,
#: and in lockstep, where they take half a second.
_AS_USUAL: Final = 3
_AS_USUAL_LOCKSTEP: Final = 200
#: What the usual time of an answer is multiplied with, and what is added, for an answer to be as soon as usual.
_SLOW: Final = 4.0
_SLACK_S: Final = 0.001
#: In lockstep: shortest time in which a second frame of an unassigned TPDO is waited for [s].
_SECOND_S: Final = 0.002
#: Share of a new row in the usual time.
_NEW: Final = 0.1


@dataclass(slots=True)
class _Unassigned:
    """State of one TPDO whose frames cannot be assigned to a SYNC at present.

    Attributes
    ----------
    owed : int
        SYNCs since the first unanswered one, less the frames that have come.
    came : int
        Frames since the last SYNC.
    usual : bool
        Whether all of these came as soon as usual.
    in_a_row : int
        SYNCs in a row with exactly one frame as soon as usual.
    """

    owed: int
    came: int = 0
    usual: bool = True
    in_a_row: int = 0


class Alignment:
    """Tracks for each TPDO whether its next frame responds to the last SYNC.

    Parameters
    ----------
    lockstep : bool
    """

    def __init__(self, *, lockstep: bool = False) -> None:
        #: By slot, those of which it is not known.
        self.unassigned: dict[int, _Unassigned] = {}
        self._usual_s: float | None = None
        self._lost_after = _AS_USUAL_LOCKSTEP if lockstep else _AS_USUAL

    @property
    def second_s(self) -> float:
        """Return how long a second frame is waited for in lockstep [s]."""
        return max(_SECOND_S, _SLOW * (self._usual_s or 0.0))

    def learn(self, row_s: float) -> None:
        """Record the time from a SYNC until all its TPDOs were received [s]."""
        self._usual_s = row_s if self._usual_s is None else self._usual_s + _NEW * (row_s - self._usual_s)

    def came(self, slot: int, after_s: float) -> None:
        """Record a frame of an unassigned TPDO and its time after the last SYNC [s] (negative = before it)."""
        state = self.unassigned[slot]
        state.came += 1
        state.usual &= 0.0 <= after_s <= _SLOW * (self._usual_s or 0.0) + _SLACK_S

    def end(self, frames: Sequence[object | None]) -> None:
        """Evaluate the responses to the last SYNC, delayed ones included, before the next SYNC is sent."""
        for slot, state in tuple(self.unassigned.items()):
            state.owed += 1 - state.came
            state.in_a_row = state.in_a_row + 1 if state.came == 1 and state.usual else 0
            if state.owed <= 0 or state.in_a_row >= self._lost_after:
                del self.unassigned[slot]
            else:
                state.came, state.usual = 0, True
        if None in frames:
            for slot, data in enumerate(frames):
                if data is None and slot not in self.unassigned:
                    self.unassigned[slot] = _Unassigned(owed=1)
