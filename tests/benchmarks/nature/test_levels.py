"""What a condition raises, and what it leaves alone."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from benchmarks.nature.levels import CONDITIONS, MILD, RAISED, levels_of

#: A low number of degrees of freedom means heavy tails.
FALLING = {"tail_freedom", "efficiency"}


@pytest.mark.parametrize("condition", sorted(set(CONDITIONS) - {"base", "all"}))
def test_a_condition_raises_what_it_names_and_nothing_else(condition):
    levels = levels_of(condition)
    changed = {field.name for field in fields(MILD) if getattr(levels, field.name) != getattr(MILD, field.name)}
    assert changed == set(RAISED[condition])
    for name in changed:
        mild, harsh = np.mean(getattr(MILD, name)), np.mean(getattr(levels, name))
        assert harsh < mild if name in FALLING else harsh > 1.9 * mild


def test_all_together_is_everything_at_half_size():
    levels = levels_of("all")
    assert levels.gain_std == pytest.approx(((0.005 + 0.02) / 2, (0.01 + 0.05) / 2))
    assert levels.outlier_share == pytest.approx(((0.0 + 0.02) / 2, (0.004 + 0.05) / 2))
    assert all(getattr(levels, field.name) != getattr(MILD, field.name) for field in fields(MILD))


def test_an_unknown_condition_is_refused():
    with pytest.raises(KeyError):
        levels_of("rain")
