"""The last seconds are on disk while they happen, whichever process is killed; nothing waits, old files are removed."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drives.frame_log import LoggedFrame, read_frames, write_blf
from gateway.data.blackbox.box import read_box, write_box
from gateway.data.blackbox.part import (
    ERROR,
    EXTENDED,
    FIELDS,
    FRAME,
    HEAD,
    RECEIVED,
    REMOTE,
    BoxHeader,
    pack,
    unpack,
    width_of,
)
from gateway.data.blackbox.recorder import PROGRAM, BoxRecorder
from gateway.data.blackbox.recorder_process import KILLED
from gateway.data.blackbox.recovery import BOTH_KILLED, recover_box
from gateway.data.blackbox.ring_buffer import HEADER, KEPT_S, MOST_WALL_S, Ring, box_of, folder_of, parts_in
from gateway.errors import InputError
from tests.support.processes import pid_of, wait_until

ROOT = Path(__file__).parents[4]
#: Steps as the motion loop does, prints the time of each, and never ends.
LOOP = """
import sys, time
from pathlib import Path
from types import SimpleNamespace
from gateway.data.blackbox.recorder import PROGRAM, BoxRecorder
from gateway.data.blackbox.part import BoxHeader

box = BoxRecorder(BoxHeader(Path(sys.argv[1]), (("main", 2),), "cell", "now", "test"))
box.wait_until_kept()
frame = SimpleNamespace(arbitration_id=0x181, data=b"12345", is_extended_id=False, is_remote_frame=False,
                        is_error_frame=False)
for sync in range(10**6):
    box.row(time.time(), sync)[:] = sync
    box.frame(frame, True)
    print(time.time(), flush=True)
    time.sleep(0.01)
"""


def header(path: Path, *axes: int) -> BoxHeader:
    return BoxHeader(
        path, tuple((f"arm{number}", count) for number, count in enumerate(axes or (2,))), "cell", "now", "test"
    )


def loop(path: Path) -> subprocess.Popen[str]:
    """The loop in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(LOOP), str(path)], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )


def seconds(process: subprocess.Popen[str], duration_s: float) -> float:
    """Run the recorder for a time; return the last time that it printed."""
    begun_s, reported_s = None, 0.0
    assert process.stdout is not None
    while begun_s is None or reported_s - begun_s < duration_s:
        reported_s = float(process.stdout.readline())
        begun_s = reported_s if begun_s is None else begun_s
    return reported_s


def part() -> bytes:
    return pack(np.full((1, width_of(2)), 7.0), b"", 1.0, 2.0)


def left_by_killed(run: Path) -> None:
    """What is on disk after a kill of both."""
    ring = Ring(folder_of(run), header(run))
    ring.add(part(), 1.0, 2.0)
    ring.close()


def test_a_kill_leaves_what_was_there_up_to_a_second_before(tmp_path):
    run = tmp_path / "run.h5"
    process = loop(run)
    last_s = seconds(process, 1.4)
    process.kill()
    process.wait()
    process.stdout.close()
    wait_until(box_of(run).with_suffix(".blf").exists)
    wait_until(lambda: not folder_of(run).exists())
    box = read_box(box_of(run))
    assert box.reason == KILLED
    assert 0.0 <= last_s - box.time_s[-1] < 1.0
    assert 0.0 <= last_s - box.frames["time_s"][-1] < 1.0
    assert np.array_equal(box.sync_index, np.arange(len(box.sync_index)))
    assert np.array_equal(box.arms[0].values["q_rad"][:, 1], box.sync_index)


def test_both_killed_leave_their_parts(tmp_path):
    run = tmp_path / "run.h5"
    process = loop(run)
    last_s = seconds(process, 1.4)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for pid in children:
        os.kill(int(pid), signal.SIGKILL)
    process.kill()
    process.wait()
    process.stdout.close()
    parts = parts_in(folder_of(run))
    assert 0.0 <= last_s - parts[-1].rows[-1, 0] < 1.0
    assert not box_of(run).exists()
    wait_until(
        lambda: recover_box(run) or box_of(run).with_suffix(".blf").exists()
    )  # a process that is killed dies in its time
    box = read_box(box_of(run))
    assert box.reason == BOTH_KILLED
    assert (box.recording, box.cell, box.arms[0].name) == ("run.h5", "cell", "main")
    assert box.wall_s[-1] == parts[-1].rows[-1, 0]
    assert not folder_of(run).exists()


def test_the_next_run_makes_a_box_of_what_both_killed_have_left(tmp_path):
    run = tmp_path / "run.h5"
    left_by_killed(run)
    box_recorder = BoxRecorder(header(run))
    box_recorder.wait_until_kept()
    assert read_box(box_of(run)).sync_index.tolist() == [7]
    assert box_recorder.close(None) == ""
    assert read_box(box_of(run)).reason == BOTH_KILLED


def test_parts_that_are_still_kept_are_left_alone(tmp_path):
    run = tmp_path / "run.h5"
    live = Ring(folder_of(run), header(run))
    live.add(part(), 1.0, 2.0)
    recover_box(run)
    assert len(parts_in(folder_of(run))) == 1
    assert not box_of(run).exists()
    live.close()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"arms": 3}'])
def test_parts_of_an_unknown_owner_are_removed(tmp_path, text):
    run = tmp_path / "run.h5"
    left_by_killed(run)
    (folder_of(run) / HEADER).write_text(text)
    recover_box(run)
    assert list(tmp_path.iterdir()) == []
    recover_box(run)


def test_what_is_kept_is_half_a_minute_of_the_run(tmp_path):
    ring = Ring(tmp_path / "parts", header(tmp_path / "run.h5"))
    for number in range(200):
        rows = np.full((1, width_of(1)), float(number))
        ring.add(pack(rows, b"", 0.5 * number, 1000.0), 0.5 * number, 1000.0)
    kept = parts_in(tmp_path / "parts")
    assert kept[-1].time_s - kept[0].time_s == KEPT_S
    for number in range(200):
        ring.add(pack(np.empty((0, width_of(1))), b"", 99.5, 1000.0 + number), 99.5, 1000.0 + number)
    ring.close()
    kept = parts_in(tmp_path / "parts")
    assert kept[-1].wall_s - kept[0].wall_s == MOST_WALL_S


def test_a_part_that_was_cut_off_is_left_out(tmp_path):
    packed = pack(np.ones((3, width_of(2))), FRAME.pack(1.0, 0x80, RECEIVED, 0, b""), 1.0, 2.0)
    assert unpack(packed).rows.shape == (3, width_of(2))
    assert all(unpack(packed[:length]) is None for length in range(len(packed)))


def test_every_number_and_every_kind_of_frame_comes_back(tmp_path):
    random = np.random.default_rng(1)
    rows = random.normal(size=(5, width_of(4 + 7)))
    rows[:, 2] = np.arange(5)
    rows[2, 20] = np.nan
    frames = b"".join(
        FRAME.pack(1.7e9 + number, 0x80 + number, flags, length, bytes(range(length)))
        for number, (flags, length) in enumerate(
            [(RECEIVED, 8), (0, 3), (RECEIVED | EXTENDED, 0), (REMOTE, 4), (ERROR, 8)]
        )
    )
    part = unpack(pack(rows, frames, 1.0, 2.0))
    write_box(tmp_path / "b.h5", header(tmp_path / "run.h5", 4, 7), [part], "why")
    box = read_box(tmp_path / "b.h5")
    together = [box.wall_s[:, None], box.time_s[:, None], box.sync_index[:, None]]
    together += [arm.values[name] for arm in box.arms for name, _ in FIELDS]
    assert np.concatenate(together, axis=1).tobytes() == rows.tobytes()
    assert box.frames.tobytes() == frames
    logged = read_frames(tmp_path / "b.blf")
    assert [each.can_id for each in logged] == [0x80, 0x81, 0x82, 0x83, 0x84]
    assert [each.kind for each in logged] == ["data", "data", "data", "remote", "error"]
    assert [each.received for each in logged][:2] == [True, False]
    assert logged[1].data == bytes(range(3))
    assert len(HEAD) == 3


def test_a_run_that_ends_well_leaves_nothing(tmp_path):
    box_recorder = BoxRecorder(header(tmp_path / "run.h5"))
    box_recorder.row(1.0, 1)[:] = 0.0
    assert box_recorder.close(None) == ""
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_said_and_ends_nothing(tmp_path):
    box_recorder = BoxRecorder(header(tmp_path / "no" / "such" / "\0".replace("\0", "x" * 300) / "run.h5"))
    box_recorder.row(1.0, 1)[:] = 0.0
    assert "cannot be written" in box_recorder.close("a stop")


def test_the_loop_never_waits_for_a_stopped_process(tmp_path):
    box_recorder = BoxRecorder(header(tmp_path / "run.h5"))
    os.kill(pid_of(PROGRAM), signal.SIGSTOP)
    try:
        for sync in range(20 * 1024):
            box_recorder.row(0.01 * sync, sync)[:] = sync
    finally:
        os.kill(pid_of(PROGRAM), signal.SIGCONT)
    assert box_recorder.close("a stop") == ""
    box = read_box(box_of(tmp_path / "run.h5"))
    assert box.sync_index[-1] == 20 * 1024 - 1
    assert (np.diff(box.sync_index) == 1).all()


def test_a_delayed_process_goes_on_and_its_box_comes(tmp_path, monkeypatch):
    monkeypatch.setattr("gateway.data.blackbox.recorder.CLOSING_S", 0.05)
    box_recorder = BoxRecorder(header(tmp_path / "run.h5"))
    box_recorder.wait_until_kept()
    box_recorder.row(0.01, 1)[:] = 1.0
    os.kill(pid_of(PROGRAM), signal.SIGSTOP)
    assert "not complete after" in box_recorder.close("a stop")
    assert not box_of(tmp_path / "run.h5").exists()
    os.kill(pid_of(PROGRAM), signal.SIGCONT)
    wait_until(box_of(tmp_path / "run.h5").with_suffix(".blf").exists)
    box = read_box(box_of(tmp_path / "run.h5"))
    assert (box.reason, box.sync_index.tolist()) == ("a stop", [1])


def test_a_frame_that_comes_while_it_closes_is_left_out_and_harms_nothing(tmp_path):
    box_recorder = BoxRecorder(header(tmp_path / "run.h5"))
    box_recorder.row(0.01, 1)[:] = 1.0
    frame = SimpleNamespace(
        arbitration_id=0x181, data=b"1", is_extended_id=False, is_remote_frame=False, is_error_frame=False
    )
    box_recorder.frame(frame, True)
    assert box_recorder.close("a stop") == ""
    box_recorder.frame(frame, True)
    assert len(read_box(box_of(tmp_path / "run.h5")).frames) == 1
    assert not folder_of(tmp_path / "run.h5").exists()


def test_what_is_no_black_box_is_said(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_box(tmp_path / "none.h5")
    (tmp_path / "x.h5").write_bytes(b"no")
    with pytest.raises(InputError, match="not an HDF5 file"):
        read_box(tmp_path / "x.h5")
    write_blf(tmp_path / "f.blf", [LoggedFrame(1.0, 1, b"")])
