"""The process of the page: `python -m gateway.live.page_process CHANNEL LISTENER`, started by `LivePage` alone.

It reads the channel at the rate of a screen, not at every SYNC, with lower priority than the motion loop. When the
other end is closed, it reports this to every open page and ends.

Connections without a request are closed, so that the page stays available.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import socket
import sys
from typing import Any, Final

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from drives.realtime import leave_real_time
from gateway.live.guard import Door
from gateway.live.page_content import Show
from gateway.live.server import Pages, live_app
from gateway.live.wire import ALIVE, ASK, MOST_BYTES, STOP, Hello, Unpacker

#: Between two frames of the page [s].
FRAME_S: Final = 1.0 / 30.0
#: Time limit for sending the final message to pages [s].
FAREWELL_S: Final = 1.0
#: Below the programs that a person works with, far below what moves.
NICE: Final = 5
#: Pages that may be open; further ones are refused by the server.
MOST_PAGES: Final = 200
GONE: Final = "The command ended without a final message; the drives stop when its heartbeat is missing."


class Channel:
    """Page end of the channel to the motion loop."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._unpacker = Unpacker()
        self.gone = False

    def drain(self, show: Show) -> None:
        """Read and process all received messages, and answer heartbeat requests.

        This runs in the event loop that receives the presses of the button: if it is blocked, no answer is sent.
        """
        while not self.gone:
            try:
                datagram = self._end.recv(MOST_BYTES)
            except BlockingIOError:
                return
            except ConnectionResetError:
                # the other end was closed with an answer unread (Linux unix(7)): what it has sent is still to be read
                continue
            except OSError:
                datagram = b""
            if not datagram:
                self.gone = True
                return
            if datagram == ASK:
                self.send(ALIVE)
                continue
            message = self._unpacker.take(datagram)
            if message is not None:
                show.take(message)

    def send(self, datagram: bytes) -> None:
        """Send a press of the stop button, or the answer to a heartbeat request."""
        with contextlib.suppress(OSError):
            self._end.send(datagram)


async def first_word(end: socket.socket) -> Hello | None:
    """Return the first message; None if the other end is closed."""
    unpacker = Unpacker()
    loop = asyncio.get_running_loop()
    while datagram := await loop.sock_recv(end, MOST_BYTES):
        message = unpacker.take(datagram)
        if isinstance(message, Hello):
            return message
    return None


def config_of(app: ASGIApp) -> uvicorn.Config:
    """Return the configuration of the web server."""
    return uvicorn.Config(
        app,
        http=PunctualProtocol,
        ws="websockets-sansio",
        ws_max_size=1024,
        limit_concurrency=most_connections(2 * MOST_PAGES),
        backlog=MOST_WAITING,
        timeout_keep_alive=int(REQUEST_S),
        lifespan="off",
        access_log=False,
        log_level="critical",
        server_header=False,
        timeout_graceful_shutdown=1,
    )


async def run(end: socket.socket, listener: socket.socket) -> None:
    """Serve the page until the other end is closed or sends the final message."""
    hello = await first_word(end)
    if hello is None:
        return
    show, channel = Show(hello), Channel(end)
    pages = Pages(show, lambda: channel.send(STOP))
    server = uvicorn.Server(config_of(live_app(pages, Door(hello.port, hello.token))))
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    parent = os.getppid()
    while not show.over and not serving.done():
        await asyncio.sleep(FRAME_S)
        channel.drain(show)
        if not show.over and (channel.gone or os.getppid() != parent):
            show.end(GONE)
        pages.notify()
    until_s = asyncio.get_running_loop().time() + FAREWELL_S
    while pages.behind and asyncio.get_running_loop().time() < until_s:
        await asyncio.sleep(FRAME_S)
    server.should_exit = True
    await serving


def main(arguments: list[str]) -> None:
    """Serve the page."""
    leave_real_time()
    with contextlib.suppress(OSError):
        os.nice(NICE)
    channel, listener = (socket.socket(fileno=int(number)) for number in arguments)
    channel.setblocking(False)
    asyncio.run(run(channel, listener))


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


if __name__ == "__main__":
    main(sys.argv[1:])
