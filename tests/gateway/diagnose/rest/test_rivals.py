"""Which hypotheses are rivals of each other: those that explain the same thing, and only those."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from benchmarks.blind.nature import first_diagnosis
from benchmarks.nature.nature_cell import draw_effect_cell
from gateway.diagnose.rest.verdict import _instead
from gateway.model.effects.joint_zero_offset import JointZeroOffset

FIRST, SECOND = JointZeroOffset(1), JointZeroOffset(2)


@pytest.mark.parametrize(("together", "rivals"), [(4.0, False), (2.5, True)])
def test_two_effects_are_rivals_unless_both_together_say_more(together: float, rivals: bool) -> None:
    scores = {(FIRST,): 3.0, (SECOND,): 2.8, (FIRST, SECOND): together}
    search = SimpleNamespace(
        fitted=lambda terms, start: SimpleNamespace(terms=tuple(terms)), score=lambda fit: scores[fit.terms]
    )
    named, rival = SimpleNamespace(terms=(FIRST,)), SimpleNamespace(terms=(SECOND,))
    assert _instead(search, named, rival) is rivals  # type: ignore[arg-type]


def test_a_smaller_set_is_the_rival_of_a_larger_one() -> None:
    named, rival = SimpleNamespace(terms=(FIRST, SECOND)), SimpleNamespace(terms=(FIRST,))
    assert _instead(SimpleNamespace(), named, rival)  # type: ignore[arg-type]


@pytest.mark.slow
def test_two_effects_that_replace_each_other_end_the_search_for_a_smaller_set() -> None:
    """Without the one the other is strong: the smaller set of either is the other one, without end."""
    cell = draw_effect_cell(171)
    named = {(effect.name, effect.joints) for effect in first_diagnosis(cell).effects}
    assert named <= {("thermal_drift", (2,)), ("torque_constant_scale", (2,))}


@pytest.mark.slow
def test_a_constant_that_drifts_is_no_wrong_constant_besides() -> None:
    """Magnets that weaken as they warm up are off from the first visit on, since the constant was stated cold."""
    cell = draw_effect_cell(25)
    assert [(effect.mechanism, effect.joints) for effect in cell.effects] == [("weak_magnets", (2,))]
    result = first_diagnosis(cell, "thermal_drift", "torque_constant_scale")
    assert [(effect.name, effect.joints) for effect in result.effects] == [("thermal_drift", (2,))]
