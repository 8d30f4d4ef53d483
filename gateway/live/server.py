"""Server of the page and its socket, reachable only from this computer."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Final

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.live.guard import Door
from gateway.live.page_content import Show
from gateway.report.page import Head, page

#: Backlog of a slow browser before messages are dropped [frames].
BEHIND: Final = 4
#: Events and poses stored for a slow browser.
WORDS: Final = 400
STOP: Final = "stop"
#: No external content, no embedding in other pages, no referrer.
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
STATIC: Final = {
    "arm.js": ("arm.js", "text/javascript"),
    "charts.js": ("charts.js", "text/javascript"),
    "live.js": ("live.js", "text/javascript"),
    "live.css": ("live.css", "text/css"),
}
REFUSED, GONE = 1008, 1001


class Viewer:
    """One open page with its unsent content; frames that it does not receive in time are dropped."""

    def __init__(self, past: Iterable[str]) -> None:
        self._words: deque[str] = deque(past, maxlen=WORDS)
        self._frames: deque[str] = deque(maxlen=BEHIND)
        self._wake = asyncio.Event()
        self._wake.set()

    def put(self, texts: Iterable[str]) -> None:
        """Queue content; does not block."""
        for text in texts:
            (self._frames if text.startswith('{"frame"') else self._words).append(text)
        self._wake.set()

    async def next(self) -> str:
        """Return the next content to send: messages before frames."""
        while not self._words and not self._frames:
            self._wake.clear()
            await self._wake.wait()
        return self._words.popleft() if self._words else self._frames.popleft()

    @property
    def behind(self) -> bool:
        """Return whether unsent content remains."""
        return bool(self._words or self._frames)


class Pages:
    """All open pages.

    Parameters
    ----------
    show : Show
    stop : callable
        Called each time the button is pressed.
    """

    def __init__(self, show: Show, stop: Callable[[], None]) -> None:
        self.show = show
        self._stop = stop
        self._viewers: set[Viewer] = set()

    def notify(self) -> None:
        """Queue new content for every page."""
        news = self.show.news()
        if news:
            for viewer in self._viewers:
                viewer.put(news)

    @property
    def behind(self) -> bool:
        """Return whether a page has unsent content."""
        return any(viewer.behind for viewer in self._viewers)

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it is closed."""
        await socket.accept()
        viewer = Viewer(self.show.past())
        self._viewers.add(viewer)
        sending = asyncio.create_task(_send(socket, viewer))
        try:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError, KeyError):
                while True:
                    if await socket.receive_text() == STOP:
                        self._stop()
        finally:
            self._viewers.discard(viewer)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await sending


async def _send(socket: WebSocket, viewer: Viewer) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.send_text(await viewer.next())


class _Guarded:
    """Middleware that refuses requests without access and adds headers to answers."""

    def __init__(self, app: ASGIApp, door: Door) -> None:
        self._app, self._door = app, door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._door.refused(HTTPConnection(scope))
        if not refusal:
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await PlainTextResponse(refusal + "\n", 403, HEADERS)(scope, receive, send)
        else:
            await WebSocket(scope, receive, send).close(REFUSED, refusal[:100])


def live_app(pages: Pages, door: Door) -> ASGIApp:
    """Return the application: `/` the page, `/static/..` its files, `/feed` the data."""

    async def shown(_request: Request) -> Response:
        return Response(page_text(door.token), headers=HEADERS, media_type="text/html")

    async def static(request: Request) -> Response:
        known = STATIC.get(request.path_params["name"])
        if known is None:
            return PlainTextResponse("This part of the page does not exist; open the printed address.\n", 404, HEADERS)
        content = files("gateway.live").joinpath("static", known[0]).read_bytes()
        return Response(content, headers=HEADERS, media_type=known[1])

    routes = [
        Route("/", shown),
        Route("/static/{name}", static),
        WebSocketRoute("/feed", pages.serve),
    ]
    return _Guarded(Starlette(routes=routes), door)


def page_text(token: str) -> str:
    """Return the HTML text of the page; all its requests carry the token of its address."""
    return page("live.html.j2", Head("Live", "Live", ()), token=token)
