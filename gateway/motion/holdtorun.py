"""Hold to run: the arms move only while a key of the terminal is held.

A terminal sends a held key again and again; no repeat for `RELEASED_S` is a release, which stops the arms along their
path. This is no enabling device in the sense of a standard (IEC 60204-1, ISO 10218-1): it is read by software, and a
terminal that hangs, or a key that sticks, is not told from a key that is held.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from gateway.errors import ConfigError
from gateway.motion.stops import StopKind, StoppedByPerson, StopRequest

#: No repeat for so long is a release; the first repeat of a key may take longer [s].
RELEASED_S: Final = 0.6
FIRST_REPEAT_S: Final = 1.0


class HeldKey:
    """A key that has to be held; a source of wishes to stop.

    Parameters
    ----------
    terminal : int
        File descriptor from which keys are read, without waiting for a line.
    """

    def __init__(self, terminal: int) -> None:
        self._terminal = terminal
        self._last_s = 0.0
        self._repeated = False

    def wait(self) -> None:
        """Wait until a key is pressed."""
        self._read(None)
        self._repeated = False

    def __call__(self) -> StopRequest | None:
        """A wish to stop once the key was released."""
        self._read(0.0)
        allowed_s = RELEASED_S if self._repeated else FIRST_REPEAT_S
        if time.monotonic() - self._last_s <= allowed_s:
            return None
        return StopRequest(StopKind.ALONG_PATH, StoppedByPerson("stopped: the hold-to-run key was released"))

    def _read(self, timeout_s: float | None) -> None:
        while select.select([self._terminal], [], [], timeout_s)[0]:
            if not os.read(self._terminal, 4096):
                return
            self._repeated = self._last_s > 0.0
            self._last_s = time.monotonic()
            timeout_s = 0.0


@contextmanager
def held_key() -> Iterator[HeldKey]:
    """The keyboard of the terminal, key by key, and without showing them.

    Raises
    ------
    ConfigError
        Standard input is no terminal.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise ConfigError("--hold-to-run needs a terminal whose keys can be held: standard input is none")
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield HeldKey(terminal)
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
