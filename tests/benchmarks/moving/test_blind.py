"""Blind cells in motion: mechanisms do what they are named for, and their strength is beyond the nuisances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.moving.blind import drawn, run_cell, strength
from benchmarks.moving.cells import draw_cell
from benchmarks.nature.moving_effects import MAKERS, MovingEffect

CELL = draw_cell(4, "stated", periods=2, rate_hz=20.0)


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
