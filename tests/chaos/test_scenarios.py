"""A dozen kinds of faults, once each; `python -m tests.chaos` plays all of them several times."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from sim.faults import KINDS
from tests.chaos.rig import Rig, rig
from tests.chaos.scenarios import ELSEWHERE, kinds, play

DOZEN = (
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
    "second_master_sync",
    "bus_off",
    "node_missing",
    "wrong_rated",
)


@pytest.fixture(scope="module")
def running() -> Iterator[Rig]:
    with rig() as made:
        yield made


@pytest.mark.parametrize("kind", DOZEN)
def test_fault_ends_in_its_stated_reaction(running: Rig, kind: str) -> None:
    outcome = play(running, kind, seed=1)
    assert outcome.fine, outcome.complaints


def test_every_kind_is_played_here_or_in_a_process_of_its_own() -> None:
    assert set(kinds()) | ELSEWHERE == set(KINDS)
    assert len(KINDS) >= 40
