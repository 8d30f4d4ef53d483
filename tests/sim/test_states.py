"""Finite state automaton of CiA 402-2, figure of the power drive system: every transition, and nothing else."""

from __future__ import annotations

import pytest

from sim.states import Automaton, PdsState

S = PdsState
DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, RESET = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80

# (from, controlword) -> to; what is not listed leaves the state alone
TRANSITIONS = {
    (S.SWITCH_ON_DISABLED, SHUTDOWN): S.READY_TO_SWITCH_ON,  # 2
    (S.READY_TO_SWITCH_ON, SWITCH_ON): S.SWITCHED_ON,  # 3
    (S.READY_TO_SWITCH_ON, ENABLE): S.OPERATION_ENABLED,  # 3 + 4
    (S.SWITCHED_ON, ENABLE): S.OPERATION_ENABLED,  # 4
    (S.OPERATION_ENABLED, SWITCH_ON): S.SWITCHED_ON,  # 5
    (S.SWITCHED_ON, SHUTDOWN): S.READY_TO_SWITCH_ON,  # 6
    (S.READY_TO_SWITCH_ON, QUICK_STOP): S.SWITCH_ON_DISABLED,  # 7
    (S.READY_TO_SWITCH_ON, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 7
    (S.OPERATION_ENABLED, SHUTDOWN): S.READY_TO_SWITCH_ON,  # 8
    (S.OPERATION_ENABLED, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 9
    (S.SWITCHED_ON, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 10
    (S.SWITCHED_ON, QUICK_STOP): S.SWITCH_ON_DISABLED,  # 10
    (S.OPERATION_ENABLED, QUICK_STOP): S.QUICK_STOP_ACTIVE,  # 11
    (S.QUICK_STOP_ACTIVE, DISABLE_VOLTAGE): S.SWITCH_ON_DISABLED,  # 12
    (S.FAULT, RESET): S.SWITCH_ON_DISABLED,  # 15
}


@pytest.mark.parametrize("state", list(S))
@pytest.mark.parametrize("word", [DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, RESET])
def test_controlword_does_what_the_standard_says(state, word):
    automaton = Automaton()
    automaton.state = state
    automaton.command(word)
    assert automaton.state is TRANSITIONS.get((state, word), state)


@pytest.mark.parametrize("state", list(S))
def test_statusword_bits_show_the_state(state):
    masks = {0x00: 0x4F, 0x40: 0x4F, 0x0F: 0x4F, 0x08: 0x4F}
    mask = masks.get(state.value, 0x6F)
    shown = [
        other for other in S if other.value & masks.get(other.value, 0x6F) == state.value & mask and other is state
    ]
    assert shown == [state]


def test_fault_reset_needs_a_rising_edge():
    automaton = Automaton()
    automaton.state = S.SWITCHED_ON
    automaton.command(RESET)
    automaton.fault()
    automaton.command(RESET)
    assert automaton.state is S.FAULT
    automaton.command(0x00)
    automaton.command(RESET)
    assert automaton.state is S.SWITCH_ON_DISABLED


def test_quick_stop_returns_only_where_the_option_says_so():
    automaton = Automaton()
    automaton.state = S.QUICK_STOP_ACTIVE
    automaton.command(ENABLE)
    assert automaton.state is S.QUICK_STOP_ACTIVE
    automaton.quick_stop_holds = True
    automaton.stopped()
    assert automaton.state is S.QUICK_STOP_ACTIVE
    automaton.command(ENABLE)  # 16
    assert automaton.state is S.OPERATION_ENABLED


@pytest.mark.parametrize(
    ("state", "then"),
    [
        (S.OPERATION_ENABLED, S.FAULT_REACTION_ACTIVE),
        (S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE),
        (S.SWITCHED_ON, S.FAULT),
        (S.SWITCH_ON_DISABLED, S.FAULT),
    ],
)
def test_a_fault_stops_the_axis_first_if_it_is_fed(state, then):
    automaton = Automaton()
    automaton.state = state
    automaton.fault()
    assert automaton.state is then
    automaton.stopped()
    assert automaton.state is S.FAULT
    assert not automaton.energised
