"""Frames of several durand nodes over one python-can bus, in one thread with one timer queue."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from itertools import count

import can
from durand.network import NetworkABC
from durand.scheduler import AbstractScheduler

Callback = Callable[[int, bytes], None]
#: First byte of an SDO answer to an upload: expedited, with and without a size; the size bits.
EXPEDITED, EXPEDITED_MASK, SIZE_BITS = 0x42, 0xE2, 0x0D


def expedited_as(first: int) -> Callable[[bytes], bytes]:
    """SDO answers of a drive whose expedited ones all have this first byte."""
    return lambda data: bytes([first]) + data[1:] if data[0] & EXPEDITED_MASK == EXPEDITED else data


#: A drive that answers every object with four bytes, filled up with zeros.
zero_extended = expedited_as(0x43)
#: A drive that does not indicate how many of the four bytes are data (CiA 301 7.2.4.3.6, s = 0).
no_size = expedited_as(0x42)


class Timers(AbstractScheduler):
    """Timer queue of the process; durand's services and the drives put their delayed calls here."""

    def __init__(self) -> None:
        self._queue: list[list] = []
        self._number = count()

    def add(self, delay, callback, args=(), kwargs=None):
        entry = [time.monotonic() + delay, next(self._number), callback, args, kwargs or {}]
        heapq.heappush(self._queue, entry)
        return entry

    def cancel(self, entry) -> None:
        entry[2] = None

    @property
    def lock(self):
        raise NotImplementedError("there is one thread")

    def run_due(self) -> float:
        """Call what is due; seconds until the next call, at most 0.05."""
        while self._queue:
            wait_s = self._queue[0][0] - time.monotonic()
            if wait_s > 0.0:
                return min(wait_s, 0.05)
            _, _, callback, args, kwargs = heapq.heappop(self._queue)
            if callback is not None:
                callback(*args, **kwargs)
        return 0.05


class NodeNetwork(NetworkABC):
    """Network of one node: its callbacks by identifier, and the form of its SDO answers."""

    def __init__(self, bus: can.BusABC, node_id: int, answer: Callable[[bytes], bytes]) -> None:
        self._bus, self._answer, self._answer_id = bus, answer, 0x580 + node_id
        self.callbacks: dict[int, Callback] = {}

    def add_subscription(self, cob_id: int, callback: Callback) -> None:
        self.callbacks[cob_id] = callback

    def remove_subscription(self, cob_id: int, callback: Callback | None = None) -> None:
        self.callbacks.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        data = self._answer(bytes(msg)) if cob_id == self._answer_id else bytes(msg)
        frame = can.Message(arbitration_id=cob_id, data=data, is_extended_id=False)
        while True:
            try:
                return self._bus.send(frame, timeout=0.1)
            except can.CanOperationError:  # the transmit queue of SocketCAN is full
                time.sleep(0.001)
