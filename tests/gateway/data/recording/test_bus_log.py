"""Frame log of a bus: every frame is in it, and a disk that fails or blocks delays no frame and is reported."""

import errno
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from drives.bus import Bus, BusSpec, open_bus
from drives.errors import BusError
from drives.frame_log import read_frames
from gateway.data.disk import PROGRAM
from gateway.data.recording.bus_log import FrameLog
from gateway.motion.opening import frame_log_watched, logged
from gateway.motion.stops import StopKind
from tests.support.processes import pid_of, wait_until


@pytest.fixture
def bus() -> Iterator[Bus]:
    with open_bus(BusSpec("virtual", "trace")) as bus:
        yield bus


def full(folder: Path, suffix: str) -> Path:
    """A log on a disk that takes no byte."""
    path = folder / f"trace.{suffix}"
    path.symlink_to("/dev/full")
    return path


def test_a_trace_holds_what_was_sent_and_received(disk, bus, tmp_path):
    path = tmp_path / "new" / "trace.log"
    with logged(bus, path, disk), can.Bus(interface="virtual", channel="trace") as other:
        bus.send(0x123, b"\x01")
        other.send(can.Message(arbitration_id=0x456, data=b"\x02", is_extended_id=False))
        other.send(can.Message(arbitration_id=0x1ABCDEF0, is_remote_frame=True, dlc=3, is_extended_id=True))
        bus.drain()
    sent, received, remote = read_frames(path)
    assert (sent.arbitration_id, sent.data, sent.is_rx, sent.channel) == (0x123, b"\x01", False, "vcan0")
    assert (received.arbitration_id, received.data, received.is_rx, received.channel) == (0x456, b"\x02", True, "trace")
    assert (remote.arbitration_id, remote.is_remote_frame, remote.is_extended_id) == (0x1ABCDEF0, True, True)
    assert sent.timestamp <= received.timestamp <= remote.timestamp


@pytest.mark.parametrize("name", ["file/trace.log", "trace.unknown"])
def test_a_trace_that_cannot_be_written_is_an_error(disk, bus, tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(BusError, match="frame trace .* cannot be written"), logged(bus, tmp_path / name, disk):
        pass


@pytest.mark.parametrize("suffix", ["log", "asc", "blf"])
def test_a_disk_that_is_full_switches_the_frame_log_off_and_raises_nowhere_else(disk, bus, tmp_path, suffix):
    """Frames go on in both directions; the failure is raised once everything is closed, unless an error passes."""
    trace = full(tmp_path, suffix)

    def run(frames: int, error: BaseException | None = None) -> None:
        with logged(bus, trace, disk):
            for _ in range(frames):
                bus.send(0x123, bytes(8))
            if error is not None:
                raise error

    with pytest.raises(OSError, match="No space left") as caught:
        run(3000)
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(trace))
    with pytest.raises(BusError) as first:
        run(1, BusError("the first error"))
    assert any("frame log is incomplete" in note for note in first.value.__notes__)


def test_a_blocked_disk_delays_no_frame_and_the_frames_that_are_missing_are_counted(disk, bus, tmp_path, monkeypatch):
    """The process is stopped; 100 kB may wait for it."""
    monkeypatch.setattr("gateway.data.recording.bus_log.PART_S", 0.0)
    disk.most_bytes = 100_000
    log = FrameLog(disk, tmp_path / "trace.log")
    bus.add_tap(log.take)
    os.kill(pid_of(PROGRAM), signal.SIGSTOP)
    try:
        for number in range(2_000):
            bus.send(0x200, number.to_bytes(4, "little"))
    finally:
        os.kill(pid_of(PROGRAM), signal.SIGCONT)
    assert 0 < log.dropped < 2_000
    assert log.failure is None
    log.close()
    assert f"{log.dropped} frames are missing: the disk was too slow" in str(log.failure)
    numbers = [int.from_bytes(each.data, "little") for each in read_frames(tmp_path / "trace.log")]
    assert numbers == list(range(2_000 - log.dropped))


def test_a_frame_log_that_fails_asks_for_a_stop_along_the_path(disk, bus, tmp_path, monkeypatch):
    monkeypatch.setattr("gateway.data.recording.bus_log.PART_S", 0.0)
    log = FrameLog(disk, full(tmp_path, "log"))
    watched = frame_log_watched(SimpleNamespace(log=log))
    bus.add_tap(log.take)
    assert watched() is None
    wait_until(lambda: bus.send(0x123, bytes(8)) or watched() is not None)
    assert (watched().kind, watched().cause) == (StopKind.ALONG_PATH, log.failure)
    assert frame_log_watched(SimpleNamespace(log=None))() is None
