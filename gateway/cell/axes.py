"""How many axes an arm may have."""

from __future__ import annotations

from typing import Final

#: Fewer cannot tell a mass from its place; more is more than the numerics are tried with.
FEWEST_AXES: Final = 2
MOST_AXES: Final = 8
