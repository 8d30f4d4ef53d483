"""Allowed number of axes of an arm."""

from __future__ import annotations

from typing import Final

#: Fewer cannot separate mass and centre of gravity; more is not tested.
FEWEST_AXES: Final = 2
MOST_AXES: Final = 8
