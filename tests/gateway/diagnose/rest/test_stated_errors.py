"""Effects against wrong statements on links and constants: whichever the visits of a drawn arm support."""

from __future__ import annotations

import pytest

from benchmarks.blind.nature import first_diagnosis
from benchmarks.nature.nature_cell import draw_cell, draw_effect_cell

LINKS_AND_CONSTANTS = ("link_mass", "balancer_spring", "thermal_drift", "torque_constant_scale", "torque_offset")


@pytest.mark.slow
def test_a_body_that_free_links_could_absorb_is_named() -> None:
    """22 kg on a link: it leaves 0.7 of the noise where links are free, and 3 % of the CAD cannot explain it.

    The torque constant of J4 happens to be 13 % off, 2.6 of its stated standard deviations: it may be named too.
    """
    cell = draw_effect_cell(323)
    assert [(effect.mechanism, effect.joints) for effect in cell.effects] == [("dressed_link", (4,))]
    found = {(effect.name, effect.joints) for effect in first_diagnosis(cell, *LINKS_AND_CONSTANTS).effects}
    assert ("link_mass", (4,)) in found
    assert found <= {("link_mass", (4,)), ("torque_constant_scale", (4,))}


@pytest.mark.slow
def test_three_effects_on_links_and_constants_are_no_wrong_statement() -> None:
    result = first_diagnosis(draw_effect_cell(1037), *LINKS_AND_CONSTANTS)
    assert {(effect.name, effect.joints) for effect in result.effects} == {
        ("link_mass", (4,)),
        ("thermal_drift", (2,)),
        ("torque_constant_scale", (4,)),
    }


@pytest.mark.slow
def test_links_that_differ_by_more_than_stated_are_reported_instead_of_a_body() -> None:
    """193 kg on a link, beside a CAD stated to 9 %: not named, but the CAD is not used either."""
    result = first_diagnosis(draw_effect_cell(261), *LINKS_AND_CONSTANTS)
    assert not result.effects
    assert any("link masses of the robot model are contradicted" in finding.what for finding in result.findings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9, 64, 87])
def test_constants_twice_as_wrong_as_stated_are_no_effect(seed: int) -> None:
    cell = draw_cell(seed, "all")
    assert cell.stated.misstated
    assert not first_diagnosis(cell).effects
