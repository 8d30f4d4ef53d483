"""The last seconds are on disk while they happen, whichever process is killed; nothing waits, old files are removed."""

import os
import signal
from pathlib import Path

import can
import numpy as np
import pytest

from drives.frame_log import ERROR, EXTENDED, FRAME, RECEIVED, REMOTE, read_frames, write_blf
from gateway.data.blackbox import ring_buffer
from gateway.data.blackbox.box import read_box, write_box
from gateway.data.blackbox.part import FIELDS, BoxHeader, pack, unpack, width_of
from gateway.data.blackbox.recorder import BoxRecorder
from gateway.data.blackbox.ring_buffer import BOTH_KILLED, Ring, box_of, folder_of, parts_in, recover_box
from gateway.data.disk import PROGRAM
from gateway.errors import InputError
from tests.support.processes import pid_of, wait_until


def box_header(path: Path, *axes: int) -> BoxHeader:
    arms = tuple((f"arm{number}", count) for number, count in enumerate(axes or (2,)))
    return BoxHeader(path, arms, "cell", "now", "test")


@pytest.fixture
def recorder(disk, tmp_path) -> BoxRecorder:
    return BoxRecorder(disk, box_header(tmp_path / "run.h5"))


def stored(run: Path) -> Ring:
    """One part on disk; once the ring is closed, as after a kill of both."""
    ring = Ring(box_header(run))
    ring.add(1, pack(np.full((1, width_of(2)), 7.0), b"", 1.0, 2.0))
    return ring


def test_the_next_run_makes_a_box_of_what_both_killed_have_left(disk, tmp_path):
    run = tmp_path / "run.h5"
    stored(run).close()
    box_recorder = BoxRecorder(disk, box_header(run))
    assert read_box(box_of(run)).sync_index.tolist() == [7]
    assert box_recorder.close(None) == ""
    assert read_box(box_of(run)).reason == BOTH_KILLED


def test_parts_that_are_still_kept_are_left_alone(tmp_path):
    run = tmp_path / "run.h5"
    live = stored(run)
    recover_box(run)
    assert len(parts_in(folder_of(run))) == 1
    assert not box_of(run).exists()
    live.close()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"arms": 3}'])
def test_parts_of_an_unknown_owner_are_removed(tmp_path, text):
    run = tmp_path / "run.h5"
    stored(run).close()
    (folder_of(run) / ring_buffer.HEADER).write_text(text)
    recover_box(run)
    assert list(tmp_path.iterdir()) == []
    recover_box(run)


def test_what_is_kept_is_half_a_minute_of_the_run(tmp_path):
    ring = Ring(box_header(tmp_path / "run.h5", 1))
    for number in range(200):
        ring.add(number, pack(np.full((1, width_of(1)), float(number)), b"", 0.5 * number, 1000.0))
    kept = parts_in(folder_of(tmp_path / "run.h5"))
    assert kept[-1].time_s - kept[0].time_s == ring_buffer.KEPT_S
    for number in range(200):
        ring.add(200 + number, pack(np.empty((0, width_of(1))), b"", 99.5, 1000.0 + number))
    ring.close()
    kept = parts_in(folder_of(tmp_path / "run.h5"))
    assert kept[-1].wall_s - kept[0].wall_s == ring_buffer.MOST_WALL_S


def test_a_part_that_was_cut_off_or_changed_is_left_out(tmp_path):
    stored(tmp_path / "run.h5").close()
    (path,) = folder_of(tmp_path / "run.h5").glob("*.part")
    content = path.read_bytes()
    assert len(parts_in(path.parent)) == 1
    changed = [content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :] for at in range(len(content))]
    for wrong in (*(content[:length] for length in range(len(content))), *changed):
        path.write_bytes(wrong)
        assert parts_in(path.parent) == []


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
    write_box(tmp_path / "b.h5", box_header(tmp_path / "run.h5", 4, 7), [part], "why")
    box = read_box(tmp_path / "b.h5")
    together = [box.wall_s[:, None], box.time_s[:, None], box.sync_index[:, None]]
    together += [arm.values[name] for arm in box.arms for name, _ in FIELDS]
    assert np.concatenate(together, axis=1).tobytes() == rows.tobytes()
    assert box.frames.tobytes() == frames
    logged = read_frames(tmp_path / "b.blf")
    assert [each.arbitration_id for each in logged] == [0x80, 0x81, 0x82, 0x83, 0x84]
    assert [each.is_remote_frame for each in logged] == [False, False, False, True, False]
    assert [each.is_error_frame for each in logged] == [False, False, False, False, True]
    assert [each.is_rx for each in logged][:2] == [True, False]
    assert logged[1].data == bytes(range(3))


def test_a_run_that_ends_well_leaves_nothing(recorder, tmp_path):
    recorder.row(1.0, 1)[:] = 0.0
    assert recorder.close(None) == ""
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_said_and_ends_nothing(disk, tmp_path):
    box_recorder = BoxRecorder(disk, box_header(tmp_path / "no" / "such" / "\0".replace("\0", "x" * 300) / "run.h5"))
    box_recorder.row(1.0, 1)[:] = 0.0
    assert "cannot be written" in box_recorder.close("a stop")


def test_the_loop_never_waits_for_a_stopped_process(recorder, tmp_path):
    os.kill(pid_of(PROGRAM), signal.SIGSTOP)
    try:
        for sync in range(20 * 1024):
            recorder.row(0.01 * sync, sync)[:] = sync
    finally:
        os.kill(pid_of(PROGRAM), signal.SIGCONT)
    assert recorder.close("a stop") == ""
    box = read_box(box_of(tmp_path / "run.h5"))
    assert box.sync_index[-1] == 20 * 1024 - 1
    assert (np.diff(box.sync_index) == 1).all()


def test_a_delayed_process_goes_on_and_its_box_comes(recorder, tmp_path, monkeypatch):
    monkeypatch.setattr("gateway.data.blackbox.recorder.CLOSING_S", 0.05)
    recorder.row(0.01, 1)[:] = 1.0
    os.kill(pid_of(PROGRAM), signal.SIGSTOP)
    assert "not complete after" in recorder.close("a stop")
    assert not box_of(tmp_path / "run.h5").exists()
    os.kill(pid_of(PROGRAM), signal.SIGCONT)
    wait_until(box_of(tmp_path / "run.h5").with_suffix(".blf").exists)
    box = read_box(box_of(tmp_path / "run.h5"))
    assert (box.reason, box.sync_index.tolist()) == ("a stop", [1])


def test_a_frame_that_comes_while_it_closes_is_left_out_and_harms_nothing(recorder, tmp_path):
    recorder.row(0.01, 1)[:] = 1.0
    frame = can.Message(0.0, 0x181, data=b"1")
    recorder.frame(frame, True)
    assert recorder.close("a stop") == ""
    recorder.frame(frame, True)
    assert len(read_box(box_of(tmp_path / "run.h5")).frames) == 1
    assert not folder_of(tmp_path / "run.h5").exists()


def test_what_is_no_black_box_is_said(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_box(tmp_path / "none.h5")
    (tmp_path / "x.h5").write_bytes(b"no")
    with pytest.raises(InputError, match="not an HDF5 file"):
        read_box(tmp_path / "x.h5")
    write_blf(tmp_path / "f.blf", [can.Message(timestamp=1.0, arbitration_id=1)])
