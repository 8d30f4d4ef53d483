"""The live page as a command sees it: a port, a process of its own, and the feed that an arm's motion is handed to."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

from gateway.errors import ENDING_SIGNALS, ConfigError
from gateway.live.feed import Feed
from gateway.live.guard import HOST, Door
from gateway.live.wire import Hello, pair_of_sockets, pieces

#: Where the page is unless that is taken, and how many further ports are tried.
PORT: Final = 8460
FURTHER: Final = 20
PROGRAM: Final = "gateway.live.page_process"
#: How long the process may take to end after the last word, before it is ended [s].
PATIENCE_S: Final = 3.0


class LivePage:
    """The page while it is served.

    Parameters
    ----------
    title : str
        What is being done.
    port : int or None
        Where; None = `PORT`, or the next one that is free.
    stops : bool
        The button of the page is heard by somebody.

    Attributes
    ----------
    feed : Feed
    address : str
        What a person opens in a browser.

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
            self._process = _started(there.fileno(), listener.fileno())
        self.address = door.address
        self.feed = Feed(here)
        for piece in pieces(Hello(door.port, door.token, title, stops)):
            here.send(piece)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def close(self, reason: str) -> None:
        """Tell every page that the command is ending, and end the process."""
        self.feed.close(reason)
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _listener(port: int | None) -> socket.socket:
    """A socket on this computer alone."""
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
                raise ConfigError(f"--port {port}: {what}; name another one, or leave --port out") from error
            continue
        listener.setblocking(False)
        return listener
    raise ConfigError(f"no port from {PORT} to {PORT + FURTHER - 1} is free for the live page; name one with --port")


def _started(channel: int, listener: int) -> subprocess.Popen[bytes]:
    """The process, in a session of its own: Ctrl-C in a terminal does not reach it."""
    # the same modules are found there as here, wherever this process was started
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    # a terminal or a service manager sends these to all processes; the page ends when the command does
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", PROGRAM, str(channel), str(listener)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            pass_fds=(channel, listener),
            start_new_session=True,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def live_page(title: str, port: int | None = None, *, stops: bool = True) -> Generator[LivePage]:
    """The page while something is done; it is told how that ended."""
    page = LivePage(title, port, stops=stops)
    reason = "The command has ended."
    try:
        yield page
    except BaseException as error:
        reason = f"The command has ended: {str(error) or type(error).__name__}"
        raise
    finally:
        with contextlib.suppress(Exception):
            page.close(reason)
