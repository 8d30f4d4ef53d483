"""Limit of idle connections: connections without a request are closed, so that the page stays available."""

from __future__ import annotations

import asyncio
import resource
from typing import Any, Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

#: A connection without a complete request for so long is closed [s].
REQUEST_S: Final = 2.0
#: Connections that may wait at once; for a further one the oldest of them is closed.
MOST_WAITING: Final = 64
#: Descriptors that the process needs for other things.
_OTHERS: Final = 64


def most_connections(wanted: int) -> int:
    """Return the number of connections that may be open at once, limited by file descriptors."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(8, wanted if limit == resource.RLIM_INFINITY else min(wanted, limit - _OTHERS - 2 * MOST_WAITING))


class PunctualProtocol(H11Protocol):
    """HTTP of uvicorn, with a time limit for the first request, and for each further one by `timeout_keep_alive`."""

    #: Connections without a request so far, oldest first.
    waiting: Final[dict[PunctualProtocol, asyncio.TimerHandle]] = {}

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the time limit of the first request."""
        super().connection_made(transport)
        if len(self.waiting) >= MOST_WAITING:
            next(iter(self.waiting)).let_go()
        self.waiting[self] = self.loop.call_later(REQUEST_S, self.let_go)

    def data_received(self, data: bytes) -> None:
        """Process received data; a complete request ends the time limit."""
        super().data_received(data)
        cycle: Any = self.cycle  # None until a request is complete
        if cycle is not None:
            self._asked()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Pass the connection to the WebSocket protocol, which has its own limits."""
        self._asked()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """End the time limit."""
        self._asked()
        super().connection_lost(exc)

    def let_go(self) -> None:
        """Close the connection at once."""
        self._asked()
        self.transport.abort()

    def _asked(self) -> None:
        timer: Any = self.waiting.pop(self, None)
        if timer is not None:
            timer.cancel()
