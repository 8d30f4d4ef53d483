"""Robots and rest tables for the model tests."""

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.model.robot import Robot, robot_from_dh
from tests.support.rigs.tables import make_table


@pytest.fixture
def qh165_dh() -> SimpleNamespace:
    """The QH165 paper's Table 1, modified Denavit-Hartenberg."""
    quarter = np.pi / 2
    return SimpleNamespace(
        convention="modified",
        alpha_rad=(0.0, -quarter, 0.0, -quarter, quarter, -quarter),
        a_m=(0.0, 0.400, 1.100, 0.230, 0.0, 0.0),
        d_m=(0.0, 0.0, 0.0, 1.13456, 0.0, 0.244),
        theta_offset_rad=(0.0, -quarter, 0.0, 0.0, 0.0, 0.0),
    )


@pytest.fixture
def six_axes() -> Robot:
    """An arm by standard Denavit-Hartenberg parameters, without a parallel link."""
    quarter = np.pi / 2
    return robot_from_dh(
        SimpleNamespace(
            convention="standard",
            alpha_rad=(quarter, 0.0, -quarter, quarter, -quarter, 0.0),
            a_m=(0.15, 0.6, 0.1, 0.0, 0.0, 0.0),
            d_m=(0.45, 0.0, 0.0, 0.64, 0.0, 0.1),
            theta_offset_rad=(0.0,) * 6,
        ),
        "six axes",
    )


def make_rest_table(load, pose, direction, tau, **columns):
    """Rest rows; the arm is at zero where `q` is not given."""
    q = columns.pop("q", np.zeros((len(load), 6)))
    return make_table(load, pose, q, tau, direction=direction, **columns)


@pytest.fixture
def rest_table():
    """Factory of rest tables."""
    return make_rest_table
