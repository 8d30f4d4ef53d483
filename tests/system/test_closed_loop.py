"""Unstated effects are found over the bus: an effect is built into the arm, and `commission` names it."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.system

# name, joints, parameters of the effect; how far mass and centre of gravity may be off [reported standard deviations]
EFFECTS = {
    "balancer_spring": ([2], "stiffness_n_m = 6000.0"),
    "sign_reversed": ([4], ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_undeclared_effect_is_named_with_its_axis(serve, commission, fast_arm, name):
    joints, parameters = EFFECTS[name]
    effect = f'[[effect]]\nname = "{name}"\njoints = {joints}\nparameters = {{ {parameters} }}\n'
    drives = fast_arm(serve(effect=effect))
    code, result, hands, output = commission(drives)
    assert code == (7 if name == "sign_reversed" else 0), output.err
    found = [(effect["name"], effect["joints"]) for effect in result["effects"]]
    assert (name, joints) in found, (result["verdict"], found)
    assert result["verdict"] in ("explained", "improved", "undecided")
    load = result["loads"][0]
    assert abs(load["mass_kg"] - 6.0) < max(5 * load["mass_std_kg"], 0.03)
    assert hands.asked == ["load"]
