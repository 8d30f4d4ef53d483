"""What the frames before and after a stop say in words, in time of the run."""

from dataclasses import replace

import numpy as np
import pytest

from drives.cia402 import State
from drives.frame_log import ERROR
from gateway.data.blackbox.frame_decoder import decoded_events, drives_of, frame_times_s, state_spans
from gateway.data.blackbox.part import FRAME_TYPE
from tests.support.pages.stop import FAULTED, PERIOD_S, SLOW, UNRESPONSIVE, stopped


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return stopped(tmp_path_factory.mktemp("stopped"))


def decoded(box, words):
    return [(each.time_s, each.nodes) for each in decoded_events(box) if words in each.what]


def test_frames_are_reported_in_the_time_of_the_run(box):
    times_s = frame_times_s(box)
    syncs_s = times_s[box.frames["can_id"] == 0x80]
    assert syncs_s[:-3] == pytest.approx(box.time_s - box.time_s[-1], abs=1e-5)
    assert syncs_s[-3:] == pytest.approx([0.01, 0.02, 0.03], abs=1e-5)


def test_frames_before_the_samples_are_reported_by_the_wall_clock(box):
    early = replace(box, wall_s=box.wall_s[100:], time_s=box.time_s[100:], sync_index=box.sync_index[100:])
    first_s = frame_times_s(early)[0]
    assert first_s == pytest.approx(-PERIOD_S * 299 - SLOW * PERIOD_S * 100, abs=1e-5)
    nothing = replace(box, wall_s=box.wall_s[:0], time_s=box.time_s[:0], sync_index=box.sync_index[:0])
    assert frame_times_s(nothing)[-1] == 0.0


def test_every_change_of_state_is_reported_once_for_all_drives_that_share_it(box):
    assert decoded(box, "OPERATION ENABLED > SWITCH ON DISABLED") == [(pytest.approx(0.01, abs=1e-5), (1, 2, 3, 6))]
    assert decoded(box, "OPERATION ENABLED > FAULT") == [(pytest.approx(0.01, abs=1e-5), (FAULTED,))]
    assert decoded(box, "controlword 0x0000 after 0x000F") == [(pytest.approx(0.01, abs=1e-5), (1, 2, 3, 4, 6))]


def test_loss_of_answers_begins_with_the_last_answer(box):
    assert decoded(box, "last answer to a SYNC") == [(pytest.approx(-1.0, abs=1e-5), (UNRESPONSIVE,))]
    (span,) = state_spans(box, UNRESPONSIVE)
    assert span.state is State.OPERATION_ENABLED
    assert (span.begin_s, span.end_s) == pytest.approx((-3.99, -1.0), abs=1e-5)


def test_a_pause_of_the_answers_is_a_gap(box):
    index = np.flatnonzero(box.frames["can_id"] == 0x181)
    paused = replace(box, frames=np.delete(box.frames, index[100:150]))
    first, second, last = state_spans(paused, 1)
    assert first.end_s == pytest.approx(-3.0, abs=1e-5)
    assert second.begin_s == pytest.approx(-2.49, abs=1e-5)
    assert last.state is State.SWITCH_ON_DISABLED
    assert decoded(paused, "no response for 0.510 s, then OPERATION ENABLED") == [(pytest.approx(-3.0, abs=1e-5), (1,))]


def test_what_drives_and_master_say_besides_is_in_words(box):
    assert decoded(box, "EMCY 0x7305") == [(pytest.approx(0.004, abs=1e-5), (FAULTED,))]
    assert decoded(box, "SDO 6041:00 (statusword) reads 0x1237") == [(pytest.approx(-0.99 / SLOW, abs=1e-5), (2,))]
    refused = "SDO 6041:00 (statusword): abort 0x06020000, object does not exist"
    assert decoded(box, refused) == [(pytest.approx(-0.5 / SLOW, abs=1e-5), (3,))]
    assert decoded(box, "is sent NMT reset node") == [(pytest.approx(0.02, abs=1e-5), (6,))]
    assert decoded(box, "NMT boot-up") == [(pytest.approx(0.03, abs=1e-5), (6,))]


def test_a_heartbeat_that_stops_is_reported_and_one_that_goes_on_is_not(box):
    beats = np.zeros(40, FRAME_TYPE)
    beats["time_s"], beats["length"] = box.wall_s[::10], 1
    beats["data"][:, 0], beats["can_id"] = 5, 0x701
    stops = beats[:20].copy()
    stops["can_id"] = 0x702
    with_beats = replace(box, frames=np.concatenate([box.frames[box.frames["can_id"] < 0x700], beats, stops]))
    assert decoded(with_beats, "last heartbeat") == [(pytest.approx(0.1 * 19 - 3.99, abs=1e-5), (2,))]


def test_an_error_frame_is_reported(box):
    frames = box.frames.copy()
    frames["flags"][-1] |= ERROR
    assert len(decoded(replace(box, frames=frames), "error frame")) == 1


def test_a_cell_that_cannot_be_read_leaves_the_nodes(tmp_path):
    box = stopped(tmp_path, "no cell")
    assert drives_of(box) == {}
    assert decoded(box, "EMCY 0x7305") == [(pytest.approx(0.004, abs=1e-5), (FAULTED,))]
