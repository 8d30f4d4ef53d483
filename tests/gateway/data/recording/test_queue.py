"""Visits in the loop, the disk elsewhere: nothing waits, nothing that was said to be on disk is lost."""

import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gateway.data.disk import PROGRAM, Disk
from gateway.data.recording.queue import VisitQueue
from gateway.data.recording.reader import read
from gateway.data.recording.writer import RecordingHeader, RecordingWriter, sole_writer
from gateway.data.visit import Visit
from gateway.errors import InputError
from tests.data.visits import ARM_HEADER, visit, write_behind, write_slowly
from tests.support.processes import pid_of


@pytest.fixture
def queue(disk, tmp_path, header) -> Iterator[VisitQueue]:
    queue = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None)
    yield queue
    queue.close()


def visits(count: int) -> list[Visit]:
    return [visit(1 + n % 3, -1 if n % 2 else 1, start_s=float(n)) for n in range(count)]


def until(queue: VisitQueue, met: Callable[[], bool], limit_s: float = 5.0) -> list[Visit]:
    """Poll as the loop does; what was written meanwhile."""
    written = []
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        written += queue.written()
        if met():
            return written
        time.sleep(0.002)
    raise TimeoutError


def test_the_file_is_the_one_of_the_writer(queue, tmp_path, header):
    writer = RecordingWriter(tmp_path / "other.h5", header, None)
    writer.begin(ARM_HEADER)
    for each in visits(5):
        assert queue.add("main", each).number == writer.add("main", each).number
    queue.finish("success", "all poses measured", {"cycles": 7})
    writer.finish("main", "success", "all poses measured", {"cycles": 7})
    writer.close()
    assert [each.number for each in queue.written()] == [1, 2, 3, 4, 5]
    assert queue.visits == 5
    assert (queue.waiting, queue.trouble()) == (0, None)
    assert queue.path.read_bytes() == writer.path.read_bytes()


def test_reported_periods_are_on_disk_and_in_order(disk, tmp_path, header):
    queue = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None, write=partial(write_slowly, 0.02))
    messages = []
    for each in visits(4):
        queue.add("main", each)
    while len(messages) < 4:
        new = until(queue, lambda: True)
        messages += [each.number for each in new]
        if new:
            assert {each.number for each in read(queue.path).arms[0].visits} >= set(messages)
    queue.close()
    assert messages == [1, 2, 3, 4]


def test_a_recording_is_gone_on_with(disk, tmp_path, header):
    path = tmp_path / "run.h5"
    for part in range(2):
        queue = VisitQueue(disk, path, header, ARM_HEADER, read(path) if part else None)
        queue.add("main", visit(1 + part, -1))
        queue.add("main", visit(1 + part, 1, start_s=0.7))
        queue.finish("success", "", {})
        queue.close()
    stored = read(path).arms[0].visits
    assert [(each.number, each.pose, each.approach) for each in stored] == [
        (1, 1, -1),
        (2, 1, 1),
        (3, 2, -1),
        (4, 2, 1),
    ]
    assert (np.diff([each.time_s[0] for each in stored]) > 0).all()


def test_a_blocked_disk_fills_the_queue_and_nothing_waits(disk, tmp_path, header):
    """More than a pipe holds is taken in while nothing at all is written."""
    gate = tmp_path / "gate"
    queue = VisitQueue(
        disk, tmp_path / "run.h5", header, ARM_HEADER, None, capacity=4, write=partial(write_behind, gate)
    )
    many = [replace(each, pose=n) for n, each in enumerate([visit(samples=100)] * 8)]
    took_s = []
    for n, each in enumerate(many):
        assert (queue.trouble() is not None) == (n >= 4)
        begin_s = time.perf_counter()
        assert queue.add("main", each).number == n + 1
        assert queue.written() == ()
        took_s.append(time.perf_counter() - begin_s)
    assert np.median(took_s) < 0.002
    with pytest.raises(InputError, match="8 visits are not yet written"):
        queue.add("main", many[0])
    assert (queue.waiting, queue.failed) == (8, None)
    gate.touch()
    queue.finish("abort", "the disk is too slow", {})
    assert [each.pose for each in queue.written()] == list(range(8))
    queue.close()
    recording = read(queue.path)
    assert [each.pose for each in recording.arms[0].visits] == list(range(8))
    assert (recording.exit_status, recording.reason) == ("abort", "the disk is too slow")


def test_a_slow_disk_empties_the_queue_again(disk, tmp_path, header):
    gate = tmp_path / "gate"
    queue = VisitQueue(
        disk, tmp_path / "run.h5", header, ARM_HEADER, None, capacity=2, write=partial(write_behind, gate)
    )
    queue.add("main", visit(1, -1))
    queue.add("main", visit(1, 1))
    assert "too slow" in str(queue.trouble())
    gate.touch()
    assert [each.number for each in until(queue, lambda: not queue.waiting)] == [1, 2]
    assert queue.trouble() is None
    queue.close()


def test_close_alone_writes_what_is_waiting(disk, tmp_path, header):
    queue = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None, write=partial(write_slowly, 0.02))
    for each in [visit(samples=100)] * 5:
        queue.add("main", each)
    queue.close()
    queue.close()
    assert [each.number for each in queue.written()] == [1, 2, 3, 4, 5]
    recording = read(queue.path)
    assert len(recording.arms[0].visits) == 5
    assert "not finished" in recording.reason


def test_a_full_disk_is_reported_and_the_file_before_stays(queue):
    queue.add("main", visit(1, -1))
    until(queue, lambda: not queue.waiting)
    before = queue.path.read_bytes()
    endless = resource.prlimit(pid_of(PROGRAM), resource.RLIMIT_FSIZE)
    resource.prlimit(pid_of(PROGRAM), resource.RLIMIT_FSIZE, (len(before) + 100, endless[1]))
    queue.add("main", visit(1, 1))
    assert until(queue, lambda: queue.failed is not None) == []
    assert "cannot be written: File too large" in str(queue.failed)
    assert queue.path.read_bytes() == before
    with pytest.raises(InputError, match="File too large"):
        queue.finish("fail", "disk full", {})
    assert queue.written() == ()
    assert queue.path.read_bytes() == before
    resource.prlimit(pid_of(PROGRAM), resource.RLIMIT_FSIZE, endless)
    queue.finish("fail", "disk full", {})
    assert [each.number for each in queue.written()] == [2]
    assert [each.number for each in read(queue.path).arms[0].visits] == [1, 2]


def test_a_missing_folder_is_made_and_nothing_measured_leaves_no_file(disk, tmp_path, header):
    VisitQueue(disk, tmp_path / "new" / "run.h5", header, ARM_HEADER, None).close()
    assert list(tmp_path.rglob("*")) == [tmp_path / "new"]


@pytest.mark.slow
def test_a_run_that_is_still_written_is_waited_for(disk, tmp_path, header):
    """The next run has read a file to which the writer of the one before still adds."""
    gate = tmp_path / "gate"
    gate.touch()
    before = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None, write=partial(write_behind, gate))
    before.add("main", visit(1, -1))
    until(before, lambda: not before.waiting)
    earlier = read(before.path)
    gate.unlink()
    before.add("main", visit(1, 1))
    with pytest.raises(InputError, match="another run is writing it"), sole_writer(before.path, 0.0):
        pass
    end = threading.Timer(0.1, lambda: (gate.touch(), before.close()))
    end.start()
    with Disk() as other, pytest.raises(InputError, match="an earlier run was still writing it"):
        VisitQueue(other, before.path, header, ARM_HEADER, earlier)
    end.join()
    queue = VisitQueue(disk, before.path, header, ARM_HEADER, read(before.path))
    assert queue.add("main", visit(2, 1)).number == 3
    queue.close()
    assert len(read(before.path).arms[0].visits) == 3


def test_two_runs_do_not_write_one_recording(tmp_path):
    path = tmp_path / "run.h5"
    with sole_writer(path, 0.0), pytest.raises(InputError, match="another run is writing it"), sole_writer(path, 0.03):
        pass
    (tmp_path / "run.h5.lock").touch()
    with sole_writer(path, 0.0):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_process_leaves_real_time(disk, tmp_path, header):
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        pytest.skip("no real-time priority here")
    try:
        queue = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None)
    finally:
        os.sched_setscheduler(0, before, os.sched_param(0))
    assert os.sched_getscheduler(pid_of(PROGRAM)) == os.SCHED_OTHER
    queue.close()


def test_files_that_are_not_gone_on_with(disk, queue, header):
    queue.add("main", visit())
    queue.finish("success", "", {})
    queue.close()
    content = queue.path.read_bytes()
    with pytest.raises(InputError, match="--resume"):
        VisitQueue(disk, queue.path, header, ARM_HEADER, None)
    with pytest.raises(InputError, match="another cell file"):
        VisitQueue(disk, queue.path, replace(header, cell=header.cell + "\n"), ARM_HEADER, read(queue.path))
    assert queue.path.read_bytes() == content


def test_signals_to_everybody_do_not_end_the_process(queue):
    process = pid_of(PROGRAM)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(process, number)
    assert os.getsid(process) != os.getsid(0)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == set()
    queue.add("main", visit())
    queue.finish("success", "", {})
    assert len(read(queue.path).arms[0].visits) == 1
    assert pid_of(PROGRAM) == process
    assert queue.failed is None


def test_a_process_that_is_killed_is_replaced_once_the_arm_is_at_rest(disk, tmp_path, header):
    gate = tmp_path / "gate"
    gate.touch()
    queue = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None, write=partial(write_behind, gate))
    queue.add("main", visit(1, -1))
    assert len(until(queue, lambda: not queue.waiting)) == 1
    gate.unlink()
    queue.add("main", visit(1, 1))
    os.kill(pid_of(PROGRAM), signal.SIGKILL)
    until(queue, lambda: queue.failed is not None)
    assert "ended early; 1 visits were not yet written" in str(queue.failed)
    queue.add("main", visit(2, 1))
    assert queue.written() == ()
    gate.touch()
    queue.finish("fail", "stopped", {})
    assert [each.number for each in queue.written()] == [2, 3]
    queue.close()
    recording = read(queue.path)
    assert [each.number for each in recording.arms[0].visits] == [1, 2, 3]
    assert recording.reason == "stopped"


def test_a_wait_that_was_interrupted_is_asked_for_again(disk, tmp_path, header, monkeypatch):
    gate = tmp_path / "gate"
    queue = VisitQueue(disk, tmp_path / "run.h5", header, ARM_HEADER, None, write=partial(write_behind, gate))
    queue.add("main", visit())

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(disk, "wait", interrupt)
    with pytest.raises(KeyboardInterrupt):
        queue.finish("success", "first", {})
    assert queue.waiting == 1
    monkeypatch.undo()
    gate.touch()
    queue.finish("abort", "second", {})
    assert read(queue.path).reason == "second"
    queue.close()


def test_other_modules_in_the_folder_are_not_taken(disk, tmp_path, header, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("gateway", "json"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(9)")
    queue = VisitQueue(disk, Path("run.h5"), header, ARM_HEADER, None)
    queue.add("main", visit())
    queue.finish("success", "", {})
    queue.close()
    assert len(read(tmp_path / "run.h5").arms[0].visits) == 1


def _forked(path: Path, header: RecordingHeader, closed: tuple[int, ...]) -> None:
    for stream in closed:
        os.close(stream)
    queue = VisitQueue(Disk(), path, header, ARM_HEADER, None)
    queue.add("main", visit())
    for stream in closed:
        with suppress(OSError):
            os.write(stream, b"noise")
    queue.finish("success", "", {})
    queue.close()
    os._exit(0)


@pytest.mark.parametrize("closed", [(), (0, 1, 2)])
def test_a_forked_master_records_with_closed_standard_streams_too(tmp_path, header, closed):
    master = multiprocessing.get_context("fork").Process(target=_forked, args=(tmp_path / "run.h5", header, closed))
    master.start()
    master.join(10.0)
    assert master.exitcode == 0
    assert len(read(tmp_path / "run.h5").arms[0].visits) == 1
