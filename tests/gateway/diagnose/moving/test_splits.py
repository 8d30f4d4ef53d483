"""Which rows choose and which judge: parts of every run, whole runs only where another shows their load too."""

from __future__ import annotations

import numpy as np

from gateway.data.rows import concatenate
from gateway.diagnose.moving.moving_rows import blocks, choosing, judging
from gateway.model.motion import prepare
from tests.data.moving_arm import GRAVITY
from tests.gateway.diagnose.moving.conftest import random_rows

BARE = frozenset({"none"})


def runs(robot, loads, label=None):
    tables = [random_rows(k, n=120, run=str(k), load=load) for k, load in enumerate(loads)]
    held = None if label is None else random_rows(99, n=60, run="held", load=label)
    return prepare(concatenate(tables), held, robot, GRAVITY)


def unsplit(motion, splits):
    """Runs of which a split leaves nothing to fit."""
    return {
        int(number)
        for train, _ in splits
        for number in np.unique(motion.run[~motion.held_out])
        if not train[motion.run == number].any()
    }


def test_a_load_mounted_in_one_run_alone_is_seen_by_every_choice(robot):
    motion = runs(robot, ["none", "a", "b", "c", "d", "e", "f"])
    splits = choosing(motion, 6, BARE)
    for train, _ in splits:
        assert set(motion.load[train]) >= {"a", "b", "c", "d", "e", "f"}
    assert unsplit(motion, splits) == {0}, "the bare run alone says nothing that the others do not need"


def test_runs_that_share_a_load_are_held_out_whole(robot):
    motion = runs(robot, ["a", "a", "b", "b", "c"])
    splits = choosing(motion, 6, BARE)
    assert unsplit(motion, splits) == {0, 1, 2, 3}
    assert np.sum([test for _, test in splits], axis=0).tolist() == [1] * len(motion)
    assert not unsplit(motion, blocks(motion, 6))


def test_two_runs_are_held_out_in_blocks(robot):
    motion = runs(robot, ["none", "none"])
    assert not unsplit(motion, choosing(motion, 6, BARE))


def test_rows_that_judge_are_in_no_split_that_chooses(robot):
    motion = runs(robot, ["none", "a"], label="a")
    for train, test in choosing(motion, 6, BARE):
        assert not (motion.held_out & (train | test)).any()
    assert judging(motion, 4) == (motion,)


def test_outer_blocks_judge_every_row_once_and_no_fit_comes_near(robot):
    motion = runs(robot, ["none", "a"])
    parts = judging(motion, 4)
    assert np.sum([part.held_out for part in parts], axis=0).tolist() == [1] * len(motion)
    for part in parts:
        assert set(part.run[part.held_out]) == {0, 1}, "a block of every run"
        for train, test in choosing(part, 6, BARE):
            assert not (part.held_out & (train | test)).any()
        for number in (0, 1):
            mine = part.run == number
            fitted = mine & ~part.held_out & part.judged.any(axis=1)
            gap = np.abs(part.time_s[fitted][:, None] - part.time_s[mine & part.held_out]).min()
            assert gap > 0.17, "3 % of 6 s"
