"""Simulated drives without a thread of their own: they run while a caller waits for their frames.

The frames are the same as on `virtual`; what falls away is the handing over from thread to thread, which on a busy
machine takes longer than everything else.
"""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import can
from can.interfaces import BACKENDS

from sim.server import BusServer

INTERFACE = "virtual"
#: Between two looks at a bus on which nothing goes on [s].
PAUSE_S = 0.0005

_served: dict[str, BusServer] = {}


class InlineBus(can.BusABC):
    """The gateway's end of a bus; the drives work while it receives."""

    def __init__(self, channel: Any = None, **_options: Any) -> None:
        super().__init__(channel=channel)
        self.channel_info = f"inline {channel}"
        self._server = _served[channel]
        self._come: deque[can.Message] = deque()
        self._gone: deque[can.Message] = deque()
        send = self._answer
        self._server.bus.send = send  # type: ignore[method-assign]
        for arm in self._server.arms:
            arm.send = send

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """To the drives, which take it when this end receives."""
        self._gone.append(copy.copy(msg))

    def _answer(self, msg: can.Message, timeout: float | None = None) -> None:
        self._come.append(copy.copy(msg))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame; the drives work until there is one."""
        until = None
        while not self._come:
            if self._work() or self._come:
                continue
            now = time.monotonic()
            until = now + (timeout or 0.0) if until is None else until
            if now >= until:
                return None
            time.sleep(PAUSE_S)
        message = self._come.popleft()
        message.timestamp = time.time()
        return message

    def _work(self) -> bool:
        """Let the drives take one frame, or keep their time if none came; whether one did."""
        server, message = self._server, self._gone.popleft() if self._gone else None
        server.serve(message)
        return message is not None


@contextmanager
def inline(servers: Sequence[BusServer], channels: Sequence[str]) -> Iterator[None]:
    """Serve buses from the thread that opens the other ends of their channels and receives there."""
    plain, BACKENDS[INTERFACE] = BACKENDS[INTERFACE], (__name__, InlineBus.__name__)
    _served.update(zip(channels, servers, strict=True))
    try:
        for server in servers:
            for node in server.nodes:
                node.boot()
        yield
    finally:
        BACKENDS[INTERFACE] = plain
        for channel, server in zip(channels, servers, strict=True):
            del _served[channel]
            for node in server.nodes:
                node.remove_network()
            server.bus.shutdown()
