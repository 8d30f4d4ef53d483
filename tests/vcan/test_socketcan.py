"""What a real SocketCAN does and the in-process bus hides; each fact here is one that the master has to live with."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

import can
import pytest

pytestmark = pytest.mark.vcan


def sync_frame(number: int = 0) -> can.Message:
    return can.Message(arbitration_id=0x80, data=bytes([number]) if number else b"", is_extended_id=False)


def burst(bus: can.BusABC, frames: int) -> None:
    """Send without waiting, as fast as it goes."""
    for number in range(frames):
        bus.send(sync_frame(number % 250 + 1))


def test_frame_sent_by_one_socket_arrives_at_another(vcan: str) -> None:
    with (
        can.Bus(interface="socketcan", channel=vcan) as here,
        can.Bus(interface="socketcan", channel=vcan) as there,
    ):
        here.send(can.Message(arbitration_id=0x181, data=b"\x01\x02\x03", is_extended_id=False))
        frame = there.recv(timeout=2.0)
        assert frame is not None
        assert (frame.arbitration_id, bytes(frame.data)) == (0x181, b"\x01\x02\x03")
        assert here.recv(timeout=0.05) is None


def test_cyclic_sync_of_the_kernel_echoes_to_the_sender(vcan: str) -> None:
    """The kernel's broadcast manager sends from a socket of its own, so the sender's raw socket sees its own SYNC."""
    with can.Bus(interface="socketcan", channel=vcan) as bus:
        task = bus.send_periodic(sync_frame(), 0.02)
        try:
            frames = [bus.recv(timeout=2.0) for _ in range(3)]
        finally:
            task.stop()
        assert all(frame is not None and frame.arbitration_id == 0x80 for frame in frames)


def test_burst_into_a_full_queue_fails_with_enobufs(
    vcan: str, short_queue: Callable[[int, int], AbstractContextManager[None]]
) -> None:
    with (
        can.Bus(interface="socketcan", channel=vcan) as bus,
        short_queue(4, 20),
        pytest.raises(can.CanOperationError) as refused,
    ):
        burst(bus, 64)
    assert refused.value.error_code == errno.ENOBUFS


def test_kernel_timestamps_follow_the_wall_clock(vcan: str) -> None:
    """They are CLOCK_REALTIME, which steps when the clock is set: nothing may be timed by their difference."""
    with (
        can.Bus(interface="socketcan", channel=vcan) as here,
        can.Bus(interface="socketcan", channel=vcan) as there,
    ):
        before_s = time.time()
        here.send(sync_frame())
        frame = there.recv(timeout=2.0)
        assert frame is not None
        assert before_s - 0.01 <= frame.timestamp <= time.time() + 0.01
