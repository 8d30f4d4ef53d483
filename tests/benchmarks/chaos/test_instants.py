"""Torque without a monitor is measured from the last SYNC; torque at a prompt is seen."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.chaos.instants import SYNC_ID, energised_in, unmonitored
from benchmarks.chaos.witness import Track


def _track(energised_s: tuple[float, float], sync_s: list[float]) -> Track:
    time_s = np.round(np.arange(0.0, 2.0, 0.01), 6)
    energised = ((time_s >= energised_s[0]) & (time_s <= energised_s[1]))[:, None]
    still = np.zeros((len(time_s), 1))
    frames = [(at, SYNC_ID, b"") for at in sync_s] + [(1.9, 0x700, b"\x05")]
    return Track(np.ones(1), time_s, still, still, energised, energised, frames, len(sync_s))


@pytest.mark.parametrize(
    ("energised_s", "sync_s", "longest_s"),
    [
        ((0.5, 1.0), [0.5, 0.6, 0.7], 0.3),
        ((0.5, 1.0), [0.45, 0.95], 0.49),
        ((0.5, 1.0), [], 0.5),
        ((3.0, 4.0), [0.1], 0.0),
    ],
)
def test_torque_counts_from_the_last_sync_before_it(energised_s, sync_s, longest_s):
    assert unmonitored(_track(energised_s, sync_s)) == pytest.approx(longest_s)


def test_torque_is_seen_in_the_time_of_a_question_alone():
    track = _track((0.5, 1.0), [])
    assert energised_in(track, 0.9, 1.4)
    assert not energised_in(track, 1.1, 1.4)
