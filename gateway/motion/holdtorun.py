"""Hold-to-run control: the arms move only while a key of the terminal, or a digital input of the cell, is held.

A terminal sends a held key again and again. A hold begins with the first repeat of a key that was pressed after the
prompt: earlier input is dropped, and a short press does not count. No repeat for `RELEASED_S` is a release, which stops
the arms along their path. This is not an enabling device as defined by IEC 60204-1 or ISO 10218-1. It is read by
software, and a blocked terminal or a stuck key cannot be distinguished from a held key.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from drives.bus import Bus
from drives.sdo import Posted, SdoClient
from gateway.cell.config import HoldToRun
from gateway.errors import ConfigError, PlanRefused
from gateway.motion.opening import OpenArm
from gateway.motion.stops import StopKind, StoppedByPerson, StopRequest, terminal_mode
from gateway.motion.stream import MoveOptions

#: Time without a repeat that counts as a release, and longest time until the first repeat [s].
RELEASED_S: Final = 0.6
FIRST_REPEAT_S: Final = 1.0
#: Polling interval of a digital input, and longest wait for a hold [s].
POLL_S: Final = 0.1
PATIENCE_S: Final = 60.0


class HeldKey:
    """Key that has to be held; a source of stop requests.

    Parameters
    ----------
    terminal : int
        File descriptor from which keys are read, without waiting for a line.
    """

    def __init__(self, terminal: int) -> None:
        self._terminal = terminal
        self._last_s = self._asked_s = -math.inf
        self._repeated = False
        #: Lock of the terminal: a second reading thread would wait for a key that the first one has read.
        self._reading = threading.Lock()

    def wait(self) -> None:
        """Read key by key without echo from now on, drop earlier input, wait for a key, and for its first repeat.

        Without a repeat within `FIRST_REPEAT_S` the key counts as released.

        Raises
        ------
        PlanRefused
            No key was pressed within `PATIENCE_S`.
        """
        import termios  # of Linux and macOS
        import tty

        with self._reading:
            with contextlib.suppress(termios.error):  # no terminal: nothing is typed ahead
                tty.setcbreak(self._terminal)
                termios.tcflush(self._terminal, termios.TCIFLUSH)
            self._last_s, self._repeated = -math.inf, False
            if not self._read(PATIENCE_S):
                raise PlanRefused(f"no key was held within {PATIENCE_S:g} s (--hold-to-run); hold it and start again")
            self._asked_s = self._last_s = time.monotonic()
            if self._read(FIRST_REPEAT_S):
                self._asked_s = self._last_s = time.monotonic()
                self._repeated = True

    def __call__(self) -> StopRequest | None:
        """Return a stop request once the key was released."""
        if self._reading.acquire(blocking=False):
            try:
                self._look()
            finally:
                self._reading.release()
        allowed_s = RELEASED_S if self._repeated else FIRST_REPEAT_S
        if time.monotonic() - self._last_s < allowed_s:
            return None
        return StopRequest(StopKind.ALONG_PATH, StoppedByPerson("stopped: the hold-to-run key was released"))

    def _look(self) -> None:
        """Read the keys since the last call; after a long pause the time of the key presses is unknown."""
        now_s = time.monotonic()
        unseen_s, self._asked_s = now_s - self._asked_s, now_s
        if self._read(0.0):
            self._last_s = now_s if unseen_s <= RELEASED_S else now_s - RELEASED_S / 2.0
            self._repeated = True

    def _read(self, timeout_s: float) -> bool:
        """Return True if a key was received within a time."""
        came = False
        while select.select([self._terminal], [], [], timeout_s)[0] and os.read(self._terminal, 4096):
            came, timeout_s = True, 0.0
        return came


class HeldInput:
    """Digital input that has to be held; a source of stop requests.

    It is read by SDO repeatedly, without waiting. It counts as released when the last request answered as held was sent
    more than `RELEASED_S` ago.

    Parameters
    ----------
    bus : Bus
    sdo : SdoClient
        SDO client of the node with the input.
    config : HoldToRun
    """

    def __init__(self, bus: Bus, sdo: SdoClient, config: HoldToRun) -> None:
        self._bus, self._sdo, self._config = bus, sdo, config
        self._posted: Posted | None = None
        self._asked_s = self._held_s = -math.inf

    def wait(self) -> None:
        """Wait until the input is held.

        Raises
        ------
        PlanRefused
            The input was not held within `PATIENCE_S`.
        """
        until_s = time.monotonic() + PATIENCE_S
        while not self._held():
            if time.monotonic() > until_s:
                at = self._config.object
                raise PlanRefused(
                    f"the hold-to-run input, node {self._config.node_id}:{at.index:04X}:{at.subindex:02X}, was not "
                    f"held within {PATIENCE_S:g} s; hold it and start again"
                )
            self._bus.listen(POLL_S / 2.0)

    def __call__(self) -> StopRequest | None:
        """Return a stop request once the input was released."""
        if self._held():
            return None
        return StopRequest(StopKind.ALONG_PATH, StoppedByPerson("stopped: the hold-to-run input was released"))

    def _held(self) -> bool:
        now, posted, config = time.monotonic(), self._posted, self._config
        if posted is not None and posted.answered:
            self._posted = None
            if posted.value is not None and posted.value & config.mask == config.good:
                self._held_s = max(self._held_s, min(now, posted.requested_s))
        if now - self._asked_s >= POLL_S:
            self._asked_s = now
            self._posted = self._sdo.post(config.object.index, config.object.subindex, "u32")
        return now - self._held_s <= RELEASED_S


def with_held_input(opened: OpenArm, options: MoveOptions) -> MoveOptions:
    """Return the motion options with the hold-to-run input of the cell file, if it names one."""
    config = opened.config.hold_to_run
    if config is None:
        return options
    own = {access.node_id: access.sdo for access in opened.group.access}
    sdo = own.get(config.node_id) or SdoClient(opened.group.bus, config.node_id)
    held, desk, ready = HeldInput(opened.group.bus, sdo, config), options.desk, options.ready
    desk.watch(lambda: held() if desk.under_power else None)

    def both_ready() -> None:
        ready()
        held.wait()

    return replace(options, ready=both_ready)


def line_entered(terminal: int) -> Callable[[], bool]:
    """Return a function that reports whether a line has been entered since; it never waits.

    Parameters
    ----------
    terminal : int
        File descriptor; earlier input is dropped.
    """
    import termios

    termios.tcflush(terminal, termios.TCIFLUSH)

    def entered() -> bool:
        return bool(select.select([terminal], [], [], 0.0)[0]) and b"\n" in os.read(terminal, 4096)

    return entered


@contextmanager
def held_key() -> Generator[HeldKey]:
    """Yield the key of the terminal, whose settings are as before at the end; `HeldKey.wait` changes them.

    Raises
    ------
    ConfigError
        Standard input is not a terminal.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise ConfigError("--hold-to-run needs a terminal: standard input is not one; start the command in a terminal")
    terminal = sys.stdin.fileno()
    with terminal_mode(terminal):
        yield HeldKey(terminal)
