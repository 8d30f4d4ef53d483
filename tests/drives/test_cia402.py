"""The state machine against the tables of CiA 402-2 (statusword masks, transitions 0 to 16)."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import drives
import gateway
from drives import cia402
from drives.cia402 import (
    Mode,
    NoRoute,
    State,
    decode_state,
    describe,
    disabling_controlword,
    enabling_controlword,
    stopping_controlword,
)

MASKS = {  # statusword bits: mask, value (CiA 402-2, table of the states)
    State.NOT_READY: (0x4F, 0x00),
    State.SWITCH_ON_DISABLED: (0x4F, 0x40),
    State.READY_TO_SWITCH_ON: (0x6F, 0x21),
    State.SWITCHED_ON: (0x6F, 0x23),
    State.OPERATION_ENABLED: (0x6F, 0x27),
    State.QUICK_STOP_ACTIVE: (0x6F, 0x07),
    State.FAULT_REACTION_ACTIVE: (0x4F, 0x0F),
    State.FAULT: (0x4F, 0x08),
}
REAL = [state for state in State if state is not State.UNDEFINED]


def standard(state: State, word: int) -> State:
    """The state a drive takes after a controlword: commands by their bits, transitions by their numbers."""
    if state in (State.NOT_READY, State.FAULT_REACTION_ACTIVE):
        return state
    if state is State.FAULT:
        return State.SWITCH_ON_DISABLED if word & 0x80 else state  # 15
    if not word & 0x02:  # disable voltage: 7, 9, 10, 12
        return State.SWITCH_ON_DISABLED
    if not word & 0x04:  # quick stop: 7, 10, 11
        return {State.OPERATION_ENABLED: State.QUICK_STOP_ACTIVE, State.QUICK_STOP_ACTIVE: state}.get(
            state, State.SWITCH_ON_DISABLED
        )
    if not word & 0x01:  # shutdown: 2, 6, 8
        return state if state is State.QUICK_STOP_ACTIVE else State.READY_TO_SWITCH_ON
    if not word & 0x08:  # switch on 3, disable operation 5
        return {State.READY_TO_SWITCH_ON: State.SWITCHED_ON, State.OPERATION_ENABLED: State.SWITCHED_ON}.get(
            state, state
        )
    return {  # enable operation: 3 + 4, 4, 16
        State.READY_TO_SWITCH_ON: State.OPERATION_ENABLED,
        State.SWITCHED_ON: State.OPERATION_ENABLED,
        State.QUICK_STOP_ACTIVE: State.OPERATION_ENABLED,
    }.get(state, state)


def test_every_statusword_is_read_as_the_standard_reads_it():
    for word in range(0x10000):
        fitting = [state for state, (mask, value) in MASKS.items() if word & mask == value]
        assert len(fitting) <= 1
        assert decode_state(word) is (fitting[0] if fitting else State.UNDEFINED), hex(word)


@pytest.mark.parametrize("start", [state for state in REAL if state not in cia402.FAULTED])
def test_enabling_follows_the_transitions_and_never_leaves_a_quick_stop(start):
    if start is State.QUICK_STOP_ACTIVE:
        with pytest.raises(NoRoute):
            enabling_controlword(start)
        return
    path = [start]
    while path[-1] is not State.OPERATION_ENABLED and start is not State.NOT_READY:
        path.append(standard(path[-1], enabling_controlword(path[-1])))
        assert len(path) < 8, f"no end: {path}"
    assert path == REAL[REAL.index(start) :][: len(path)]
    assert standard(path[-1], enabling_controlword(path[-1])) is path[-1]


@pytest.mark.parametrize("start", list(State))
def test_no_controlword_has_the_reset_bit_and_only_enabling_has_the_enable_bit(start):
    for closes in (False, True):
        assert not disabling_controlword(start, brake_closes=closes) & 0x88
    if start in (State.FAULT, State.FAULT_REACTION_ACTIVE, State.UNDEFINED):
        with pytest.raises(NoRoute):
            enabling_controlword(start)
    elif start is not State.QUICK_STOP_ACTIVE:
        assert not enabling_controlword(start) & cia402.FAULT_RESET


@pytest.mark.parametrize("state", list(State))
def test_stopping_never_energises(state):
    word = stopping_controlword(state)
    assert not word & 0x88
    if state is not State.UNDEFINED:
        assert standard(state, word) in (state, State.SWITCH_ON_DISABLED, State.QUICK_STOP_ACTIVE)


def test_a_brake_that_closes_keeps_the_state_that_holds_its_axis():
    for state in (State.SWITCHED_ON, State.QUICK_STOP_ACTIVE):
        assert standard(state, disabling_controlword(state, brake_closes=True)) is state
        assert standard(state, disabling_controlword(state)) is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("state", [state for state in State if state is not State.OPERATION_ENABLED])
def test_disabling_ends_without_voltage(state):
    assert disabling_controlword(state) == cia402.DISABLE_VOLTAGE


@pytest.mark.parametrize("closes", [False, True])
def test_an_enabled_axis_closes_its_brake_before_its_voltage_goes(closes):
    word = disabling_controlword(State.OPERATION_ENABLED, brake_closes=closes)
    assert standard(State.OPERATION_ENABLED, word) is State.SWITCHED_ON


#: What of the controlwords a module may use beside `cia402`, which decides them.
USERS = {
    "drives/enabling.py": {"enabling_controlword"},
    "drives/stopping.py": {"disabling_controlword", "stopping_controlword"},
    "drives/proof.py": {"ENABLE_OPERATION", "disabling_controlword", "enabling_controlword", "stopping_controlword"},
    "drives/drive.py": {"ENABLE_OPERATION", "RESET"},  # the one that sends them
    "drives/exchange.py": {"ENABLE_OPERATION"},  # whether an axis is under power, and moves
    "drives/group.py": {"ENABLE_OPERATION"},  # keeps the state in a motion
    "gateway/drivetest/answers.py": {"DISABLE_VOLTAGE", "SHUTDOWN"},  # to disabled axes, whose answers are timed
}
WORDS = {
    *("DISABLE_VOLTAGE", "QUICK_STOP", "SHUTDOWN", "SWITCH_ON", "DISABLE_OPERATION", "ENABLE_OPERATION"),
    *("FAULT_RESET", "RESET", "enabling_controlword", "stopping_controlword", "disabling_controlword"),
}


def test_controlwords_are_decided_in_one_module_and_written_by_one():
    users: dict[str, set[str]] = {}
    writers: set[str] = set()
    for package in (drives, gateway):
        top = Path(package.__file__ or "").parent
        for path in top.rglob("*.py"):
            name = path.relative_to(top.parent).as_posix()
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ImportFrom) and node.module == "drives.cia402":
                    users.setdefault(name, set()).update(alias.name for alias in node.names if alias.name in WORDS)
                if isinstance(node, ast.ImportFrom) and node.module == "drives":
                    assert "cia402" not in {alias.name for alias in node.names}, name
                if isinstance(node, ast.Subscript) and ast.unparse(node) == "OBJECTS['controlword']":
                    writers.add(name)
    assert {name: names for name, names in users.items() if names} == USERS
    assert writers == {"drives/drive.py"}


def test_modes_of_0x6502():
    """Bit number = mode - 1 (CiA 402-2, 0x6502): 0x1A0 = HM, CSP, CSV."""
    supported = {mode for mode in Mode if cia402.mode_supported(0x1A0, mode)}
    assert supported == {Mode.HOMING, Mode.CYCLIC_SYNC_POSITION, Mode.CYCLIC_SYNC_VELOCITY}


def test_a_statusword_in_words():
    assert describe(0x0A37) == "OPERATION ENABLED, internal limit"
    assert describe(0x2008) == "FAULT, following error, not under remote control"
