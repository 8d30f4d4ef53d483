"""What the commands that move arms do, as functions of a Python program: without the command line."""

from __future__ import annotations

from typing import Final

#: Speed override [%] of transfer motions: people may be closer to the arm than during a measurement.
SLOW_PERCENT: Final = 10
