"""Effects without a name: each changes one thing of the model, by the formula that is written here."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.model import unnamed
from gateway.model.rest import neutral

Q = np.random.default_rng(5).uniform(-2.0, 2.0, (7, 6))
ROWS = SimpleNamespace(q_rad=Q)
ANGLE = Q[:, 2]


def changed(term, theta):
    """What a term puts in place of the neutral model."""
    before, after = neutral(len(Q), 6), term.apply(neutral(len(Q), 6), np.array(theta), ROWS)
    names = [name for name in before.__slots__ if not np.array_equal(getattr(before, name), getattr(after, name))]
    assert len(names) == 1
    return names[0], getattr(after, names[0])


def test_position_torque_is_three_harmonics():
    name, value = changed(unnamed.PositionTorque(4, joint=2), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    expected = np.zeros((7, 6))
    for k, (cosine, sine) in enumerate([(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)], start=1):
        expected[:, 4] += cosine * np.cos(k * ANGLE) + sine * np.sin(k * ANGLE)
    assert name == "passive_nm"
    assert value == pytest.approx(expected)


def test_uneven_band_is_two_harmonics_of_the_band():
    name, value = changed(unnamed.UnevenBand(1, joint=2), [0.1, 0.2, 0.3, 0.4])
    swing = 0.1 * np.cos(ANGLE) + 0.2 * np.sin(ANGLE) + 0.3 * np.cos(2 * ANGLE) + 0.4 * np.sin(2 * ANGLE)
    assert name == "band_gain"
    assert value[:, 1] == pytest.approx(1.0 + swing)
    assert (np.delete(value, 1, axis=1) == 1.0).all()


def test_bent_gain_grows_with_the_torque():
    name, value = changed(unnamed.BentGain(3, largest_nm=200.0), [0.1])
    assert name == "gain_per_nm"
    assert value.tolist() == [0.0, 0.0, 0.0, 0.1 / 200.0, 0.0, 0.0]
