"""Allowed number of axes of an arm."""

from __future__ import annotations

from typing import Final

#: One axis determines mass times distance, and with a weighed load its torque constant; more than 8 are not tested.
FEWEST_AXES: Final = 1
MOST_AXES: Final = 8
