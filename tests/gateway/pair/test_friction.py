"""Torque offset for friction: by hand, late by the servos' lag."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.pair.friction import FrictionOffset

COULOMB, VISCOUS = np.array([18.0, 27, 15, 3.6, 3, 1.8]), np.array([12.0, 18, 10, 2.4, 2, 1.2])


def test_friction_of_a_target_comes_when_the_servo_reaches_it() -> None:
    arm = SimpleNamespace(coulomb_nm=COULOMB, viscous_nm_s_rad=VISCOUS)
    offset = FrictionOffset(arm, 0.004, 0.016)  # type: ignore[arg-type]
    at_rest, moving = np.zeros(6), np.full(6, -0.5 * 0.004)
    for _ in range(10):
        assert not offset.at(at_rest).any()
    given = [offset.at((step + 1) * moving) for step in range(6)]
    assert not any(early.any() for early in given[:4])
    assert given[4] == pytest.approx(-COULOMB - 0.5 * VISCOUS)
    assert given[5] == pytest.approx(given[4])
