"""Short forms of the benchmarks in real time: one of each kind, at 20 ms."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.chaos.heartbeats import heartbeats_after_refused_stop
from benchmarks.chaos.interrupting import ACTIONS, interrupt_commands
from benchmarks.chaos.programs import COMMANDS
from benchmarks.chaos.slow_disk import record_on_slow_disk
from benchmarks.chaos.stalling import MEASURING, stall_masters
from benchmarks.chaos.unbuffered import fastest_unbuffered

pytestmark = [pytest.mark.slow, pytest.mark.clock]

PERIOD_S = 0.02
RECORD, MOVING = (
    [replace(command, window_s=2.0) for command in COMMANDS if command.name == name]
    for name in ("record", "record --plan")
)


@pytest.mark.slow
def test_a_master_that_was_held_up_stops_the_arm_and_does_not_chase_its_set_points():
    stalls = stall_masters(1, period_s=PERIOD_S)
    assert (stalls.stalls, stalls.fast, stalls.foreign) == (1, 0, 0)
    assert stalls.moving == 1
    assert stalls.delayed == 0, stalls.complaints
    assert stalls.share <= MEASURING


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM", "closed stdout and stderr"])
def test_a_command_that_is_interrupted_comes_to_rest_and_lets_go(how):
    assert how in ACTIONS
    seen = interrupt_commands(how, 1, PERIOD_S, only=MOVING if how == "SIGTERM" else RECORD)
    assert seen.complaints == []
    assert seen.runs == 1


@pytest.mark.slow
def test_a_slow_disk_stops_the_arm_along_its_path_and_loses_nothing():
    slow = record_on_slow_disk(2.5, PERIOD_S, capacity=2, visits=8)
    assert slow.complaints == []
    assert slow.full, slow.said
    assert 2 <= slow.taken < 8
    assert slow.lost == 0


@pytest.mark.slow
def test_drives_that_do_not_buffer_are_not_driven_beyond_their_speed():
    fastest = fastest_unbuffered(PERIOD_S, [command for command in COMMANDS if command.name == "check --prove-stop"])
    assert fastest.complaints == []
    assert 0.0 < max(fastest.shares.values()) <= MEASURING


@pytest.mark.slow
def test_no_heartbeat_goes_out_once_a_stop_is_not_confirmed():
    assert heartbeats_after_refused_stop(1, PERIOD_S).delayed == 0
