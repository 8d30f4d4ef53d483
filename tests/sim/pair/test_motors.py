"""Rotors, gears and their friction."""

from __future__ import annotations

import numpy as np
import pytest

from sim.pair.motors import DriveTrain, Motors

STEP_S = 1e-4


def motors() -> Motors:
    one = np.ones(2)
    none = [np.zeros(2)] * 5
    train = DriveTrain(1e4 * one, 2.0 * one, 5.0 * one, 3.0 * one, one, 0.016 * one, *none, 10.0 * one)
    return Motors(train, STEP_S)


@pytest.mark.parametrize(("coulomb", "viscous"), [(1.0, 1.0), (1.2, 0.6), (0.5, 2.0)])
def test_friction_of_another_day_slows_a_free_rotor_down(coulomb, viscous):
    """`J dw = -(c + v w) h` of a rotor whose gear carries nothing yet."""
    found = motors()
    found.rub(np.array([1.0, coulomb]), np.array([1.0, viscous]))
    found.axes[0].free = found.axes[1].free = True
    found.omega[:] = 0.4
    found.control(np.zeros(2), 1.0, 1e-3)
    found.step(np.zeros(2), np.full(2, 0.4))
    own, other = (2.0 * (0.4 - found.omega) / STEP_S).tolist()
    assert own == pytest.approx(5.0 + 3.0 * 0.4)
    assert other == pytest.approx(coulomb * 5.0 + viscous * 3.0 * 0.4)
