"""Fixtures for the tests on a real SocketCAN: the interface, a queue that is full."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import can
import pytest

CHANNEL = "vcan0"
REQUIRED = os.environ.get("SERVO_GATEWAY_REQUIRE_VCAN") == "1"


def skip_or_fail(reason: str) -> None:
    """Skip with the reason; where SocketCAN is required that is a failure."""
    if REQUIRED:
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def vcan() -> str:
    """Name of the SocketCAN interface; skipped with the reason where there is none."""
    try:
        can.Bus(interface="socketcan", channel=CHANNEL).shutdown()
    except OSError as error:
        skip_or_fail(f"no {CHANNEL} here ({error}); `make vcan` brings its own")
    return CHANNEL


@pytest.fixture
def short_queue(vcan: str) -> Callable[[int, int], AbstractContextManager[None]]:
    """Context in which the interface holds at most so many frames, each for so many ms, as a busy bus does."""

    @contextmanager
    def shape(frames: int, delay_ms: int) -> Iterator[None]:
        words = ["tc", "qdisc", "replace", "dev", vcan, "root", "netem", "limit", str(frames), "delay", f"{delay_ms}ms"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            skip_or_fail(f"the transmit queue cannot be shortened: {done.stderr.strip()}")
        try:
            yield
        finally:
            subprocess.run(["tc", "qdisc", "del", "dev", vcan, "root"], capture_output=True, check=True)

    return shape
