"""Blind cells in motion: mechanisms do what they are named for, and their strength is beyond the nuisances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.moving.blind import drawn, run_cell, strength
from benchmarks.moving.cells import draw_cell
from benchmarks.nature.moving_effects import MAKERS, MovingEffect

CELL = draw_cell(4, "stated", periods=2, rate_hz=20.0)


def test_the_torque_of_a_balancer_is_the_derivative_of_its_energy():
    """The motor gives what the energy of the spring takes; the energy is summed up over a sweep of axis 2."""
    effect = MAKERS["balancer_spring"](CELL.arm, np.random.default_rng(1))[0](1.0)
    q = np.zeros((2001, 6))
    q[:, 1] = np.linspace(-np.pi, np.pi, 2001)
    torque = effect.joint_nm(q, np.zeros_like(q))[:, 1]
    assert np.abs(torque).max() > 1.0
    # a closed turn takes no energy
    assert np.trapezoid(torque, q[:, 1]) == pytest.approx(0.0, abs=1e-9 * np.abs(torque).max())


@pytest.mark.parametrize("name", list(MAKERS))
def test_a_larger_mechanism_is_stronger(name: str):
    build, limit = MAKERS[name](CELL.arm, np.random.default_rng(2))
    small, large = (strength(CELL, build(share * (limit or 1.0))) for share in (0.01, 0.03))
    assert small > 0.0
    assert large > small if limit else large == small


def test_what_a_nuisance_explains_has_no_strength():
    """A heavier rotor is a rotor without a prior; in one period alone it is none."""

    def heavier(arm, _period):
        return replace(arm, rotor_inertia_kg_m2=1.2 * arm.rotor_inertia_kg_m2)

    always = strength(CELL, MovingEffect("rotor", (), arm=heavier))
    once = strength(CELL, MovingEffect("rotor", (), arm=lambda arm, k: heavier(arm, k) if k == 0 else arm))
    assert always < 0.05 * once


@pytest.mark.slow
def test_a_cell_is_drawn_measured_and_scored():
    assert drawn(0)[1] == 0.0
    record = run_cell(22)
    assert record["mechanism"] == "axes_swapped"
    assert record["right"]
    assert len(record["inside"]) == 4
