"""Arms for the tests: random ones as URDF text, and the example cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gateway.cell.config import load_cell
from gateway.model.robot import robot_from_urdf
from tests.data.arms import body_on_link_6, urdf_of

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture
def random_urdf():
    """Factory: seed, text of an <inertial> fixed to link 6 -> URDF text of a random arm."""
    return lambda seed, load="": urdf_of(np.random.default_rng(seed), body_on_link_6(load) if load else "")


@pytest.fixture
def large():
    """The large example cell, loaded."""
    return load_cell(EXAMPLES / "large" / "cell.toml")


@pytest.fixture
def qh165():
    """Its robot."""
    return robot_from_urdf((EXAMPLES / "large" / "robot.urdf").read_text(), "robot.urdf")
