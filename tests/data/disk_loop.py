"""Steps as a motion loop that records, with black box and frame log, and never ends: `python -m tests.data.disk_loop`.

Argument: a folder. After each step the time and the number of visits that were reported as written are printed.
"""

import sys
import time
from functools import partial
from pathlib import Path

import can

from gateway.cell.config import load_cell
from gateway.data.blackbox.part import BoxHeader
from gateway.data.blackbox.recorder import BoxRecorder
from gateway.data.disk import Disk
from gateway.data.recording.bus_log import FrameLog
from gateway.data.recording.queue import VisitQueue
from tests.data.visits import ARM_HEADER, CELL, header_of, visit, write_slowly

folder, disk, reported = Path(sys.argv[1]), Disk(), 0
log = FrameLog(disk, folder / "trace.log")
write = partial(write_slowly, 0.02)
queue = VisitQueue(disk, folder / "run.h5", header_of(load_cell(CELL)), ARM_HEADER, None, write=write)
box = BoxRecorder(disk, BoxHeader(folder / "run.h5", (("main", 2),), "cell", "now", "test"))
for sync in range(10**6):
    frame = can.Message(time.time(), 0x181, False, data=b"12345", channel="trace")
    box.row(time.time(), sync)[:] = sync
    box.frame(frame, True)
    log.take(frame, True)
    if queue.trouble() is None:
        queue.add("main", visit(1 + sync % 3, -1, seed=sync, samples=100))
    reported += len(queue.written())
    print(time.time(), reported, flush=True)
    time.sleep(0.01)
