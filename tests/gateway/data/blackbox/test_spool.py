"""Black boxes of what is not recorded: the newest ones stay, and what a kill has left becomes one."""

from datetime import UTC, datetime, timedelta

import numpy as np

from gateway.data.blackbox.box import read_box
from gateway.data.blackbox.part import BoxHeader, pack, width_of
from gateway.data.blackbox.ring_buffer import BOTH_KILLED, MOST_BOXES, Ring, box_of, folder_of, place_in, recording_of

NOW = datetime(2026, 11, 23, 4, 5, 6, tzinfo=UTC)


def test_the_name_says_whose_it_is_and_when(tmp_path):
    assert place_in(tmp_path / "new", "big cell/a-main", NOW).name == "big_cell_a-main.20261123T040506Z.blackbox.h5"


def test_the_oldest_ones_go_and_others_stay(tmp_path):
    for hour in range(MOST_BOXES + 3):
        path = place_in(tmp_path, "cell-main", NOW + timedelta(hours=hour))
        path.touch()
        path.with_suffix(".blf").touch()
    other = place_in(tmp_path, "cell-mainly", NOW)
    other.touch()
    newest = place_in(tmp_path, "cell-main", NOW + timedelta(days=9))
    kept = sorted(path.name for path in tmp_path.glob("cell-main.*.h5"))
    assert len(kept) == MOST_BOXES - 1  # and the one that comes
    assert kept[-1] < newest.name
    assert kept[0].startswith("cell-main.20261123T08")
    assert len(list(tmp_path.glob("cell-main.*.blf"))) == MOST_BOXES - 1
    assert other.exists()


def test_what_a_kill_has_left_becomes_a_box(tmp_path):
    path = place_in(tmp_path, "cell-main", NOW)
    assert recording_of(folder_of(path)) == path
    ring = Ring(BoxHeader(path, (("main", 2),), "cell", "now", "test"))
    ring.add(1, pack(np.full((1, width_of(2)), 7.0), b"", 1.0, 2.0))
    ring.close()
    place_in(tmp_path, "cell-main", NOW + timedelta(hours=1))
    assert read_box(box_of(path)).reason == BOTH_KILLED
    assert not folder_of(path).exists()
