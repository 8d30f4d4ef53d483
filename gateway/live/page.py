"""Live page of a command: port, separate process, and feed for the motion loop."""

from __future__ import annotations

import contextlib
import secrets
import socket
import subprocess
from types import TracebackType
from typing import Final, Self

from drives.child_process import start_module
from gateway.errors import ENDING_SIGNALS, ConfigError
from gateway.live.feed import Feed
from gateway.live.guard import HOST, Door
from gateway.live.wire import Hello, pair_of_sockets, pieces

#: Default port of the page, and number of further ports tried.
PORT: Final = 8460
FURTHER: Final = 20
PROGRAM: Final = "gateway.live.page_process"
#: Time limit for the process to end after the final message [s].
PATIENCE_S: Final = 3.0


class LivePage:
    """A page that is served in a `with` block, whose end it reports to the browsers.

    Parameters
    ----------
    title : str
        Title of the page.
    port : int or None
        Port; None = `PORT`, or the next free one.
    stops : bool
        Whether the stop button of the page is connected.

    Attributes
    ----------
    feed : Feed
    address : str
        Address for the browser.
    process : subprocess.Popen
        What serves the page.

    Raises
    ------
    ConfigError
        The port is taken, or none is free.
    """

    def __init__(self, title: str, port: int | None = None, *, stops: bool = True) -> None:
        listener = _listener(port)
        door = Door(listener.getsockname()[1], secrets.token_urlsafe(16))
        here, there = pair_of_sockets()
        with listener, there:
            self.process = start_module(PROGRAM, ENDING_SIGNALS, (there.fileno(), listener.fileno()))
        self.address = door.address
        self.feed = Feed(here)
        for piece in pieces(Hello(door.port, door.token, title, stops)):
            here.send(piece)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Report the end of the command to every page, and end the process."""
        what = "." if error is None else f": {str(error) or type(error).__name__}"
        with contextlib.suppress(Exception):
            self.feed.close(f"The command has ended{what}")
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def _listener(port: int | None) -> socket.socket:
    """Return a socket that accepts connections from this computer only."""
    wanted = range(PORT, PORT + FURTHER) if port is None else (port,)
    for number in wanted:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((HOST, number))
            listener.listen(128)
        except OSError as error:
            listener.close()
            if port is not None:
                what = error.strerror or str(error)
                raise ConfigError(f"--port {port}: {what}; choose another one, or omit --port") from error
            continue
        listener.setblocking(False)
        return listener
    raise ConfigError(f"no port from {PORT} to {PORT + FURTHER - 1} is free for the live page; choose one with --port")
