"""Buses of one plant that one thread serves in real time: whose frame is acted on first, and at which time."""

from __future__ import annotations

import socket
import time

import can
import pytest

from sim.multicast import QuietMulticastBus
from sim.serve import free_bus
from sim.server import can_be_waited_for, serve_together


class Wire:
    """Frames that were received at stated times, and a socket that says whether one is there."""

    def __init__(self, stamps_s: list[float]) -> None:
        self.reader, self.writer = socket.socketpair()
        self.frames = [can.Message(arbitration_id=0x80, timestamp=stamp) for stamp in stamps_s]
        self.writer.send(bytes(len(stamps_s)))

    def fileno(self) -> int:
        return self.reader.fileno()

    def recv(self, timeout: float) -> can.Message | None:
        assert timeout == 0.0
        if not self.frames:
            return None
        self.reader.recv(1)
        return self.frames.pop(0)


class Served:
    """As much of a server as the thread asks for; it stops once all have ended."""

    step_s = 0.001

    def __init__(self, name: str, stamps_s: list[float], log: list[tuple]) -> None:
        self.name, self.bus, self.log = name, Wire(stamps_s), log
        self.stopped = self.ended = False
        self.at_s = -1.0

    def boot(self) -> None:
        self.log.append((self.name, "boot"))

    def pass_until(self, now_s: float) -> None:
        self.at_s = max(self.at_s, now_s)

    def serve(self, message: can.Message | None) -> None:
        self.log.append((self.name, message, self.at_s))
        self.stopped = message is None

    def end(self) -> None:
        self.ended = True
        self.bus.reader.close()
        self.bus.writer.close()


def test_frames_are_acted_on_in_the_order_in_which_they_came_and_time_is_the_same_on_all_buses():
    now_s, wall_s = time.monotonic(), time.time()
    log: list[tuple] = []
    left_s, right_s = [0.001, 0.002, 0.007], [0.0015, 0.0016, 0.006]
    servers = [
        Served(name, [wall_s - 0.5 + each for each in stamps], log)
        for name, stamps in (("left", left_s), ("right", right_s))
    ]
    serve_together(servers)  # type: ignore[arg-type]
    acted = [each for each in log if each[1] not in ("boot", None)]
    assert [name for name, *_ in acted] == ["left", "right", "right", "left", "right", "left"]
    came_s = [at_s - now_s + 0.5 for *_, at_s in acted]
    assert came_s == pytest.approx(sorted(left_s + right_s), abs=2e-3)
    unresponsive = [each for each in log if each[1] is None]
    assert [name for name, *_ in unresponsive] == ["left", "right"]
    assert unresponsive[0][2] == unresponsive[1][2] > now_s
    assert all(server.ended for server in servers)


def test_a_bus_that_fails_ends_all():
    log: list[tuple] = []
    servers = [Served(name, [], log) for name in ("left", "right")]

    def broken(_timeout: float) -> None:
        raise can.CanOperationError("gone")

    servers[1].bus.recv = broken  # type: ignore[method-assign, assignment]
    with pytest.raises(can.CanOperationError):
        serve_together(servers)  # type: ignore[arg-type]
    assert all(server.ended for server in servers)


def test_what_can_be_waited_for_beside_other_buses():
    channel, _, port = free_bus().removeprefix("udp_multicast:").partition(",port=")
    quiet, virtual = QuietMulticastBus(channel, port=int(port)), can.Bus(interface="virtual", channel="waited")
    try:
        assert can_be_waited_for(quiet)
        assert not can_be_waited_for(virtual)
        assert not can_be_waited_for(object())
    finally:
        quiet.shutdown()
        virtual.shutdown()
