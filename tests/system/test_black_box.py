"""The last seconds before a stop are stored beside the recording: samples, and the frame that was the reason."""

from pathlib import Path

import can
import numpy as np
import pytest

from drives.frame_log import RECEIVED
from gateway.data.blackbox.box import read_box
from gateway.data.blackbox.ring_buffer import box_of, folder_of

pytestmark = pytest.mark.usefixtures("fast_cell")
AT_SYNC = 225


@pytest.mark.slow
def test_a_drive_fault_is_in_the_black_box(place, gateway, serve):
    drives = serve(fault=f'[[fault]]\nkind = "drive_fault"\nnode = 4\nat_sync = {AT_SYNC}\nsyncs = 0\n')
    arguments = ["record", place.cell, "--load", "none", "-o", place.run, "--bus", drives.bus, "--yes", "-q"]
    done = gateway(*arguments, "--poses", "0.3,-0.2,0.3,0.2,0.3,0.2")
    assert done.exit_code == 4, done.output
    path = box_of(place.run)
    assert str(path) in done.stderr
    box = read_box(path)
    (arm,) = box.arms
    assert "FAULT" in box.reason
    assert box.recording == "run.h5"
    assert box.time_s[-1] - box.time_s[0] > 2.0
    assert (np.diff(box.sync_index) > 0).all()
    frames = box.frames
    faulted = (frames["can_id"] == 0x184) & (frames["data"][:, 0] & 0x4F == 0x08)
    assert faulted.any()
    emergency = frames[frames["can_id"] == 0x084]
    assert bytes(emergency["data"][0][:2]) == (0x7305).to_bytes(2, "little")
    assert (frames["can_id"] == 0x080).sum() >= len(box.time_s)
    assert not (frames["flags"][frames["can_id"] == 0x080] & RECEIVED).any()
    assert np.isfinite(arm.values["q_rad"]).all()
    assert (arm.values["statusword"][:-1].astype(int) & 0x6F == 0x27).all()
    with can.BLFReader(path.with_suffix(".blf")) as log:
        assert [message.arbitration_id for message in log] == frames["can_id"].tolist()
    assert not folder_of(place.run).exists()


def boxes(place) -> list[Path]:
    return sorted((place.folder / "state" / "servo-gateway").glob("*.blackbox.h5"))


@pytest.mark.slow
@pytest.mark.parametrize("at_sync", [75, 250])
def test_a_move_that_is_stopped_leaves_one_beside_the_ledger(place, gateway, serve, at_sync):
    """At 75 the stop of the drives is still being proven, at 250 the arm is in motion."""
    drives = serve(fault=f'[[fault]]\nkind = "drive_fault"\nnode = 4\nat_sync = {at_sync}\nsyncs = 0\n')
    done = gateway("move", place.cell, "--bus", drives.bus, "--to", "0.3,-0.2,0.3,0.2,0.3,0.2", "--yes")
    assert done.exit_code == 4, done.output
    (path,) = boxes(place)
    assert path.name.startswith("small-main.20")
    assert str(path) in done.stderr.replace("\n", "")
    box = read_box(path)
    (arm,) = box.arms
    assert "FAULT" in box.reason
    assert (np.diff(box.sync_index) > 0).all()
    assert np.isfinite(arm.values["q_rad"]).all()
    assert (box.frames["can_id"] == 0x084).any()
    page = gateway("report", path, "-o", place.folder / "stop.html")
    assert page.exit_code == 0, page.output
    assert "FAULT" in (place.folder / "stop.html").read_text()
    assert not folder_of(path).exists()


@pytest.mark.slow
def test_a_check_that_is_stopped_leaves_one(place, gateway, serve):
    drives = serve(fault='[[fault]]\nkind = "drive_fault"\nnode = 4\nat_sync = 75\nsyncs = 0\n')
    done = gateway("check", place.cell, "--bus", drives.bus, "--move", "--yes")
    assert done.exit_code == 4, done.output
    (path,) = boxes(place)
    assert str(path) in done.stderr.replace("\n", "")
    assert "FAULT" in read_box(path).reason
