"""One process writes all files of a command: no file delays another, and no kill costs more than a second."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest

from drives.frame_log import read_frames
from gateway.data.blackbox.box import read_box
from gateway.data.blackbox.part import BoxHeader
from gateway.data.blackbox.recorder import BoxRecorder
from gateway.data.blackbox.ring_buffer import BOTH_KILLED, KILLED, box_of, folder_of, parts_in, recover_box
from gateway.data.disk import PROGRAM
from gateway.data.recording.bus_log import FrameLog
from gateway.data.recording.queue import VisitQueue
from gateway.data.recording.reader import read
from tests.data.visits import ARM_HEADER, visit, write_behind
from tests.support.processes import pid_of, wait_until

ROOT = Path(__file__).parents[3]
FRAME = can.Message(1.0, 0x181, False, data=b"1")


@pytest.mark.parametrize("both", [False, True])
def test_a_kill_leaves_every_reported_visit_and_the_rest_up_to_a_second_before(tmp_path, both):
    run = tmp_path / "run.h5"
    command = [sys.executable, "-m", "tests.data.disk_loop", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    with process.stdout as steps:
        begun_s, last_s, reported = float(steps.readline().split()[0]), 0.0, 0
        while last_s - begun_s < 1.4 or reported < 6:
            last_s, reported = map(float, steps.readline().split())
        beside = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        assert len(beside) == 1
        for pid in (*beside, process.pid)[not both :]:
            os.kill(int(pid), signal.SIGKILL)
        last_s, reported = max((tuple(map(float, line.split())) for line in steps), default=(last_s, reported))
    process.wait()
    if both:  # a process that is killed dies in its time
        assert 0.0 <= last_s - parts_in(folder_of(run))[-1].rows[-1, 0] < 1.0
        wait_until(lambda: recover_box(run).with_suffix(".blf").exists())
    wait_until(lambda: box_of(run).with_suffix(".blf").exists() and not folder_of(run).exists())
    wait_until(lambda: both or not (tmp_path / "run.h5.lock").exists())
    box = read_box(box_of(run))
    assert (box.reason, box.recording, box.cell) == (BOTH_KILLED if both else KILLED, "run.h5", "cell")
    assert 0.0 <= last_s - box.time_s[-1] < 1.0
    assert 0.0 <= last_s - box.frames["time_s"][-1] < 1.0
    assert np.array_equal(box.sync_index, np.arange(len(box.sync_index)))
    assert np.array_equal(box.arms[0].values["q_rad"][:, 1], box.sync_index)
    numbers = [each.number for each in read(run).arms[0].visits]
    assert len(numbers) >= reported
    assert numbers == list(range(1, len(numbers) + 1))
    if not both:
        assert 0.0 <= last_s - read_frames(tmp_path / "trace.log")[-1].timestamp < 1.0


def test_a_blocked_file_delays_no_other_and_a_killed_process_is_replaced(disk, tmp_path, header):
    """Only the frame log ends with the process: what it held for the disk is lost."""
    run, gate = tmp_path / "run.h5", tmp_path / "gate"
    queue = VisitQueue(disk, run, header, ARM_HEADER, None, write=partial(write_behind, gate))
    box = BoxRecorder(disk, BoxHeader(run, (("main", 2),), "cell", "now", "test"))
    log = FrameLog(disk, tmp_path / "first.log")
    queue.add("main", visit(1, -1))
    log.take(FRAME, True)
    log.close()
    assert (log.failure, len(read_frames(tmp_path / "first.log"))) == (None, 1)
    log = FrameLog(disk, tmp_path / "second.log")
    for sync in range(1500):  # more than a part
        box.row(0.01 * sync, sync)[:] = sync
    wait_until(lambda: queue.written() or parts_in(folder_of(run)))
    assert (queue.waiting, queue.trouble()) == (1, None)
    os.kill(pid_of(PROGRAM), signal.SIGKILL)
    wait_until(lambda: log.failure)
    box.row(15.0, 1500)[:] = 1500
    assert "ended early; 1 visits were not yet written" in str(queue.trouble())
    gate.touch()
    queue.finish("fail", "stopped", {})
    assert [each.number for each in queue.written()] == [1]
    assert box.close("a stop") == ""
    queue.close()
    assert read_box(box_of(run)).sync_index.tolist() == list(range(1501))
    assert read(run).reason == "stopped"
    assert "the frame log is incomplete: the process that writes it ended early" in str(log.failure)
