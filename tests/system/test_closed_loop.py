"""An unstated effect is found over the bus: it is built into the arm, and `commission` names it with its axis."""

from __future__ import annotations

import pytest

from tests.system.conftest import with_few_poses

EFFECT = '[[effect]]\nname = "sign_reversed"\njoints = [4]\n'


@pytest.mark.slow
def test_a_reversed_sign_is_named_with_its_axis(place, serve, commission, fast_arm):
    with_few_poses(place)
    drives = fast_arm(serve(effect=EFFECT))
    code, result, hands, output = commission(drives)
    assert code == 7, output.err
    found = [(effect["name"], effect["joints"]) for effect in result["effects"]]
    assert ("sign_reversed", [4]) in found, (result["verdict"], found)
    assert result["verdict"] in ("explained", "improved", "undecided")
    load = result["loads"][0]
    assert abs(load["mass_kg"] - 6.0) < max(5 * load["mass_std_kg"], 0.03)
    assert hands.asked == ["load"]
