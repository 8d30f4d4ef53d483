"""Record of the frames on a bus during a test, with the monotonic time at which each was on the bus."""

from __future__ import annotations

import time
from dataclasses import dataclass
from types import TracebackType
from typing import Final

from drives.bus import EMCY_BASE, Bus, Frame

#: Half-width of the error of a time stamp [s]: by the kernel or the sender, and where the adapter gives none.
STAMP_S: Final = 0.0001
UNSTAMPED_S: Final = 0.001
#: A time stamp that is older than this was taken by another clock [s].
_OLDEST_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class SeenFrame:
    """A frame and the monotonic time [s] of its time stamp; of a frame that was sent, when that was done."""

    can_id: int
    data: bytes
    at_s: float


class FrameRecord:
    """Frames received and sent while open, in their order.

    Parameters
    ----------
    bus : Bus
    """

    def __init__(self, bus: Bus) -> None:
        self.frames: list[SeenFrame] = []
        self.resolution_s = STAMP_S if bus.stamped else UNSTAMPED_S
        self._bus = bus

    def __enter__(self) -> FrameRecord:
        self._bus.add_tap(self._take)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._bus.remove_tap(self._take)

    def _take(self, frame: Frame, received: bool) -> None:
        now_s, age_s = time.monotonic(), time.time() - frame.timestamp
        back_s = age_s if received and self._bus.stamped and 0.0 < age_s < _OLDEST_S else 0.0
        self.frames.append(SeenFrame(frame.arbitration_id, bytes(frame.data), now_s - back_s))

    def of(self, can_id: int, since_s: float = 0.0) -> list[SeenFrame]:
        """Return the frames with an id since a time."""
        return [frame for frame in self.frames if frame.can_id == can_id and frame.at_s >= since_s]

    def emergencies(self, node_id: int, since_s: float = 0.0) -> list[SeenFrame]:
        """Return the emergency messages of a node."""
        return self.of(EMCY_BASE + node_id, since_s)
