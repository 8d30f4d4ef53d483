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
