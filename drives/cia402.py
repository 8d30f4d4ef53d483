"""CiA 402 state machine: pure tables and functions (CiA 402-2, clause 8: finite state automaton and statusword).

Which controlword follows from which state is decided here, for each goal: `enabling_controlword` (enable),
`stopping_controlword` (quick stop), `disabling_controlword` (disable) and `RESET` (fault reset).

Only enabling leads to OPERATION ENABLED. Transition 16 (QUICK STOP ACTIVE to OPERATION
ENABLED) is never used. Only `RESET` has the fault reset bit: a fault is reset on request.
"""

from __future__ import annotations

from enum import Enum
from typing import Final


class State(Enum):
    """States of the power drive system (PDS) of CiA 402."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"
    UNDEFINED = "no state of CiA 402"

    def __str__(self) -> str:
        return self.value.upper()


class Mode(Enum):
    """Modes of operation, 0x6060 (CiA 402-2, 0x6060)."""

    PROFILE_POSITION = 1
    VELOCITY = 2
    PROFILE_VELOCITY = 3
    PROFILE_TORQUE = 4
    HOMING = 6
    INTERPOLATED_POSITION = 7
    CYCLIC_SYNC_POSITION = 8
    CYCLIC_SYNC_VELOCITY = 9
    CYCLIC_SYNC_TORQUE = 10

    def __str__(self) -> str:
        return self.name.lower().replace("_sync_", " synchronous ").replace("_", " ")


# Controlword commands: bits 0 switch on, 1 enable voltage, 2 quick stop (low active), 3 enable operation.
DISABLE_VOLTAGE: Final = 0x0000
QUICK_STOP: Final = 0x0002
SHUTDOWN: Final = 0x0006
SWITCH_ON: Final = 0x0007
DISABLE_OPERATION: Final = 0x0007
ENABLE_OPERATION: Final = 0x000F
#: Rising edge resets a fault. No table of this module uses it.
FAULT_RESET: Final = 0x0080
#: Controlwords that reset a fault, in their order.
RESET: Final = (DISABLE_VOLTAGE, FAULT_RESET, DISABLE_VOLTAGE)

#: Bit of the controlword that lets an enabled axis follow the setpoints, by mode in which the master streams them (CiA
#: 402-2, interpolated position mode: enable interpolation). The drive takes it in OPERATION ENABLED only.
FOLLOWING: Final = {Mode.INTERPOLATED_POSITION: 1 << 4, Mode.CYCLIC_SYNC_POSITION: 0}

# Statusword bits outside the state.
VOLTAGE_ENABLED: Final = 1 << 4
WARNING: Final = 1 << 7
REMOTE: Final = 1 << 9
TARGET_REACHED: Final = 1 << 10
INTERNAL_LIMIT: Final = 1 << 11
FOLLOWS_COMMAND: Final = 1 << 12
FOLLOWING_ERROR: Final = 1 << 13

#: Bits of the statusword that carry the state.
STATE_MASK: Final = 0x006F
#: Statusword and mask of OPERATION ENABLED, for the cyclic test.
ENABLED_PATTERN: Final = 0x0027

_PATTERNS: Final = (
    (0x4F, 0x00, State.NOT_READY),
    (0x4F, 0x40, State.SWITCH_ON_DISABLED),
    (0x6F, 0x21, State.READY_TO_SWITCH_ON),
    (0x6F, 0x23, State.SWITCHED_ON),
    (0x6F, 0x27, State.OPERATION_ENABLED),
    (0x6F, 0x07, State.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, State.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, State.FAULT),
)


def _match(word: int) -> State:
    return next((state for mask, value, state in _PATTERNS if word & mask == value), State.UNDEFINED)


_STATES: Final = tuple(_match(word) for word in range(0x80))

#: Controlword towards OPERATION ENABLED by present state; from a state that is absent there is no route.
_ENABLING: Final = {
    State.NOT_READY: DISABLE_VOLTAGE,
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY_TO_SWITCH_ON: SWITCH_ON,
    State.SWITCHED_ON: ENABLE_OPERATION,
    State.OPERATION_ENABLED: ENABLE_OPERATION,
}

#: States in which the drive exerts no torque of its own will, or will not without a new command.
AT_REST: Final = frozenset(
    {State.NOT_READY, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.FAULT}
)
FAULTED: Final = frozenset({State.FAULT, State.FAULT_REACTION_ACTIVE, State.UNDEFINED})


class NoRoute(ValueError):  # noqa: N818 - reads as what happened
    """No permitted transitions lead from the present state to OPERATION ENABLED; a person has to act."""


def decode_state(statusword: int) -> State:
    """Return the state in a statusword; UNDEFINED for a bit pattern that is not in the standard."""
    return _STATES[statusword & STATE_MASK]


def enabling_controlword(state: State) -> int:
    """Return the controlword of the next transition towards OPERATION ENABLED, or that keeps it; no fault reset bit.

    Raises
    ------
    NoRoute
        From a fault, or from QUICK STOP ACTIVE.
    """
    word = _ENABLING.get(state)
    if word is None:
        raise NoRoute(f"there is no route from {state} to {State.OPERATION_ENABLED}")
    return word


def stopping_controlword(state: State) -> int:
    """Return the controlword that stops an axis: quick stop if it is enabled; SWITCHED ON is kept, so that a brake
    that is closing gets its time.
    """
    if state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
        return QUICK_STOP
    return DISABLE_OPERATION if state is State.SWITCHED_ON else DISABLE_VOLTAGE


def disabling_controlword(state: State, *, brake_closes: bool = False) -> int:
    """Return the controlword towards SWITCH ON DISABLED; in a fault one without effect.

    Parameters
    ----------
    state : State
    brake_closes : bool
        The brake is closing: the axis keeps SWITCHED ON or QUICK STOP ACTIVE, because a drive without voltage cannot
        hold it.
    """
    if brake_closes and state in (State.SWITCHED_ON, State.QUICK_STOP_ACTIVE):
        return stopping_controlword(state)
    return DISABLE_OPERATION if state is State.OPERATION_ENABLED else DISABLE_VOLTAGE


def mode_supported(supported_modes: int, mode: Mode) -> bool:
    """Return whether 0x6502 (supported drive modes) includes the mode (bit number = mode - 1)."""
    return bool(supported_modes >> (mode.value - 1) & 1)


def describe(statusword: int) -> str:
    """Describe a statusword, e.g. ``OPERATION ENABLED, internal limit``."""
    words = [str(decode_state(statusword))]
    for bit, text in ((WARNING, "warning"), (INTERNAL_LIMIT, "internal limit"), (FOLLOWING_ERROR, "following error")):
        if statusword & bit:
            words.append(text)
    if not statusword & REMOTE:
        words.append("not under remote control")
    return ", ".join(words)
