"""Who may ask for the page: a browser on this computer that was given the address, and no page of anybody else.

A foreign page can have its name resolve to 127.0.0.1 and then speak to what listens there (DNS rebinding): the Host
that it asks for, and the Origin that a browser says of it, give it away. The word in the address keeps out other users
of the computer.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from typing import Final

from starlette.requests import HTTPConnection

HOST: Final = "127.0.0.1"
NAMES: Final = (HOST, "localhost")
WRONG_HOST: Final = "This page is for a browser on the computer that runs the command: open the address it has printed."
WRONG_TOKEN: Final = "The word at the end of the address is missing or of another run: open the address as printed."


@dataclass(frozen=True, slots=True)
class Door:
    """Where the page is, and the word that its address ends with."""

    port: int
    token: str

    @property
    def address(self) -> str:
        """What a person opens."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def refused(self, asked: HTTPConnection) -> str:
        """Why a request is not answered; empty = it is.

        Parameters
        ----------
        asked : HTTPConnection
            A request or a WebSocket that is being opened.
        """
        places = [f"{name}:{self.port}" for name in NAMES]
        if asked.headers.get("host", "") not in places:
            return WRONG_HOST
        origin = asked.headers.get("origin")
        if origin is not None and origin not in [f"http://{place}" for place in places]:
            return WRONG_HOST
        token = asked.query_params.get("token", "")
        return "" if hmac.compare_digest(token.encode(), self.token.encode()) else WRONG_TOKEN
