"""The arm of the large example cell."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.model.robot import robot_from_urdf

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture
def qh165():
    """Robot of the large example cell."""
    return robot_from_urdf((EXAMPLES / "large" / "robot.urdf").read_text(), "robot.urdf")
