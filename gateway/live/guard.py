"""Access control of the page: only a browser on this computer with the printed address, and no other page.

A foreign page can resolve its name to 127.0.0.1 and access local servers (DNS rebinding). The Host and Origin headers
reveal this. The token in the address excludes other users of the computer.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from typing import Final

from starlette.requests import HTTPConnection

HOST: Final = "127.0.0.1"
NAMES: Final = (HOST, "localhost")
WRONG_HOST: Final = "This page is for a browser on the computer that runs the command: open the address it has printed."
WRONG_TOKEN: Final = "The token at the end of the address is missing or of another run: open the address as printed."


@dataclass(frozen=True, slots=True)
class Door:
    """Port of the page and the token of its address."""

    port: int
    token: str

    @property
    def address(self) -> str:
        """Return the address for the browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def refused(self, asked: HTTPConnection) -> str:
        """Return why a request is refused; empty if it is accepted.

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
