"""Two dozen kinds of faults, once each, in both modes and pacings; `make chaos` plays all of them several times."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from benchmarks.chaos.remote import Remote, remote
from benchmarks.chaos.rig import Rig, rig
from benchmarks.chaos.scenarios import ELSEWHERE, kinds, play_again
from benchmarks.chaos.stated import STATED
from sim.faults import KINDS

IN_LOCKSTEP = (
    "tpdo_lost",
    "tpdo_gone",
    "tpdo_torn",
    "tpdo_stuck",
    "rpdo_gone",
    "sdo_other_object",
    "power_cycle",
    "emcy_storm",
    "drive_fault",
    "internal_limit",
    "warning",
    "start_refused",
    "cycle_period_set",
    "enables_and_drops",
    "second_master_sync",
    "bus_off",
    "node_missing",
    "wrong_rated",
    "write_ignored",
    "drive_exchanged",
    "reboot_keeps_nothing",
    "second_master_slow",
    "nmt_preoperational",
)
BY_THE_CLOCK = ("tpdo_gone", "burst", "drive_fault", "tpdo3_on", "second_master_nmt", "estop_pressed")


@pytest.fixture(scope="module", params=[8, 7], ids="mode {}".format)
def running(request) -> Iterator[Rig]:
    with rig(mode=request.param) as made:
        yield made


@pytest.fixture(scope="module", params=[8, 7], ids="mode {}".format)
def by_the_clock(request) -> Iterator[Remote]:
    with remote(0.02, request.param) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize("kind", IN_LOCKSTEP)
def test_fault_ends_as_stated_in_lockstep(running: Rig, kind: str) -> None:
    outcome = play_again(running, kind, seed=1)
    assert outcome.fine, outcome.complaints


@pytest.mark.slow
@pytest.mark.clock
@pytest.mark.parametrize("kind", BY_THE_CLOCK)
def test_fault_ends_as_stated_by_the_clock(by_the_clock: Remote, kind: str) -> None:
    outcome = play_again(by_the_clock, kind, seed=1)
    if not outcome.fine and outcome.held_up:
        pytest.skip("a sleeper on the same core saw longer stalls than this fault allows")
    assert outcome.fine, outcome.complaints


@pytest.mark.slow
@pytest.mark.parametrize("pacing", ["lockstep", pytest.param("real", marks=pytest.mark.clock)])
def test_axes_in_mode_7_follow_their_targets_as_closely_as_in_mode_8(pacing: str) -> None:
    behind = {}
    for mode in (7, 8):
        with remote(0.02, mode) if pacing == "real" else rig(mode=mode) as drives:
            outcome = play_again(drives, "object_value", seed=1)
        assert outcome.fine, outcome.complaints
        behind[mode] = outcome.behind
    assert 0 < behind[7] < 1.2 * behind[8], behind


def test_every_kind_is_played_here_or_in_a_process_of_its_own() -> None:
    assert {KINDS[kind].reaction for kind in set(KINDS) - set(kinds())} == ELSEWHERE
    assert set(STATED) == set(kinds())
    assert len(KINDS) >= 40


def test_what_goes_on_says_what_is_counted_and_what_ends_says_why() -> None:
    for kind in kinds():
        stated = STATED[kind]
        if KINDS[kind].reaction in ("goes on", "retried"):
            assert stated.error is None
            assert stated.counts_in("lockstep"), kind
        else:
            assert stated.says, kind
