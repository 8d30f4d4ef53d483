"""A frame log that fails asks for a stop along the path."""

from __future__ import annotations

import errno
from types import SimpleNamespace

from gateway.motion.opening import frame_log_watched
from gateway.motion.stops import StopKind


def test_a_frame_log_that_fails_asks_for_a_stop_along_the_path():
    log = SimpleNamespace(failure=None)
    watched = frame_log_watched(SimpleNamespace(group=SimpleNamespace(bus=SimpleNamespace(log=log))))
    assert watched() is None
    log.failure = OSError(errno.ENOSPC, "No space left on device", "trace.blf")
    wish = watched()
    assert wish is not None
    assert (wish.kind, wish.cause) == (StopKind.ALONG_PATH, log.failure)


def test_without_a_frame_log_nothing_is_watched():
    assert frame_log_watched(SimpleNamespace(group=SimpleNamespace(bus=SimpleNamespace(log=None))))() is None
