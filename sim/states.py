"""State machine of a simulated drive (power drive system, CiA 402-2, clause 8).

Transitions are numbered as in the standard's figure. Controlword bits: 0 switch on, 1 enable voltage, 2 quick stop (low
active), 3 enable operation, 7 fault reset (rising edge).
"""

from __future__ import annotations

from enum import Enum


class PdsState(Enum):
    """States with their statusword bits 0 to 3, 5 and 6."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


S = PdsState


class Automaton:
    """CiA 402 state machine of one drive.

    Attributes
    ----------
    state : PdsState
    controlword : last one received
    quick_stop_holds : 0x605A is 5 to 8: the drive stays in QUICK STOP ACTIVE, and transition 16 leads back
    """

    def __init__(self) -> None:
        self.state = S.NOT_READY_TO_SWITCH_ON
        self.controlword = 0
        self.quick_stop_holds = False

    def power_up(self) -> None:
        """Make transitions 0 and 1 after the self-test."""
        self.state = S.SWITCH_ON_DISABLED
        self.controlword = 0

    def command(self, word: int) -> None:
        """Process a controlword: one transition per call, except 3 + 4, which the standard combines."""
        reset = bool(word & 0x80) and not self.controlword & 0x80
        self.controlword = word
        if reset and self.state is S.FAULT:
            self.state = S.SWITCH_ON_DISABLED  # 15
            return
        if word & 0x80:
            return
        self.state = self._after(word)

    def _after(self, word: int) -> PdsState:
        state = self.state
        if not word & 0x02:  # disable voltage: 7, 9, 10, 12
            live = (S.READY_TO_SWITCH_ON, S.SWITCHED_ON, S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE)
            return S.SWITCH_ON_DISABLED if state in live else state
        if not word & 0x04:  # quick stop: 7, 10, 11
            if state is S.OPERATION_ENABLED:
                return S.QUICK_STOP_ACTIVE
            return S.SWITCH_ON_DISABLED if state in (S.READY_TO_SWITCH_ON, S.SWITCHED_ON) else state
        if not word & 0x01:  # shutdown: 2, 6, 8
            live = (S.SWITCH_ON_DISABLED, S.SWITCHED_ON, S.OPERATION_ENABLED)
            return S.READY_TO_SWITCH_ON if state in live else state
        if not word & 0x08:  # switch on: 3; disable operation: 5
            return S.SWITCHED_ON if state in (S.READY_TO_SWITCH_ON, S.OPERATION_ENABLED) else state
        if state in (S.READY_TO_SWITCH_ON, S.SWITCHED_ON):  # 3 + 4, 4
            return S.OPERATION_ENABLED
        if state is S.QUICK_STOP_ACTIVE and self.quick_stop_holds:  # 16
            return S.OPERATION_ENABLED
        return state

    def stopped(self) -> None:
        """Notify that the axis is at rest: transition 12 after a quick stop, 14 after a fault reaction."""
        if self.state is S.FAULT_REACTION_ACTIVE:
            self.state = S.FAULT
        elif self.state is S.QUICK_STOP_ACTIVE and not self.quick_stop_holds:
            self.state = S.SWITCH_ON_DISABLED

    def quick_stop(self) -> None:
        """Stop by the drive's own decision (abort connection option 3)."""
        if self.state is S.OPERATION_ENABLED:
            self.state = S.QUICK_STOP_ACTIVE
        elif self.state in (S.READY_TO_SWITCH_ON, S.SWITCHED_ON):
            self.state = S.SWITCH_ON_DISABLED

    def disable_voltage(self) -> None:
        """Power off by the drive's own decision (abort connection option 2)."""
        self.state = self._after(0x0000)

    def fault(self) -> None:
        """Make transition 13: through the fault reaction if enabled, else directly to FAULT (14)."""
        if self.state in (S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE):
            self.state = S.FAULT_REACTION_ACTIVE
        elif self.state is not S.FAULT_REACTION_ACTIVE:
            self.state = S.FAULT

    @property
    def energised(self) -> bool:
        """Return whether the motor is powered; only then the brake may be open."""
        return self.state in (S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE)
