"""A feed with a clock of its own, and what comes out at the other end."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from gateway.live.drawing import shown_arm
from gateway.live.feed import Feed
from gateway.live.page_content import Show
from gateway.live.page_process import Channel
from gateway.live.wire import MOST_BYTES, Hello, ShownCell, Unpacker, pair_of_sockets
from gateway.motion.arms import Arms
from gateway.motion.state import StateTracker
from gateway.motion.stops import StopRequest
from gateway.motion.workspace import Workspace
from tests.data.observed import PERIOD_S


@dataclass
class Rig:
    """A feed and the end at which the page listens."""

    feed: Feed
    page: socket.socket
    now_s: list[float]
    unpacker: Unpacker = field(default_factory=Unpacker)

    def later(self, seconds: float) -> None:
        self.now_s[0] += seconds

    def run(self, seconds: float, *, answered: bool) -> StopRequest | None:
        """SYNCs for a time; the first stop request. The page process answers heartbeat requests, or is frozen."""
        channel, show = Channel(self.page), Show(Hello(8460, "word", "servo-gateway record", stops=True))
        for _ in range(round(seconds / PERIOD_S)):
            self.later(PERIOD_S)
            if wish := self.feed.pressed():
                return wish
            if answered:
                channel.drain(show)
        return None

    def received(self) -> list[Any]:
        """Rows and messages that have come."""
        received = []
        while True:
            try:
                datagram = self.page.recv(MOST_BYTES)
            except BlockingIOError:
                return received
            if not datagram:
                return received
            message = self.unpacker.take(datagram)
            if message is not None:
                received.append(message)


@pytest.fixture
def rig() -> Iterator[Rig]:
    here, there = pair_of_sockets()
    now_s = [100.0]
    with here, there:
        yield Rig(Feed(here, lambda: now_s[0]), there, now_s)


@pytest.fixture
def began(arm, workspace) -> tuple[Arms, tuple[Workspace, ...], float, StateTracker]:
    """Arguments of `Observer.began`."""
    return Arms((arm,), "lockstep"), (workspace,), PERIOD_S, StateTracker("main", lambda state: None)


@pytest.fixture
def shown(workspace) -> ShownCell:
    return ShownCell((shown_arm("main", workspace),), PERIOD_S)
