"""What no rest pose can distinguish, or show at all, when links and load are unknown."""

from __future__ import annotations

import pytest

from benchmarks.blind.pairs import confusable_pairs

VERTICAL = {("joint_zero_offset", (1,)), ("torque_constant_scale", (1,)), ("load_dependent_friction", (1,))}
VERTICAL |= {("joint_elasticity", (1,))}
LUMPED = {("link_mass", (link,)) for link in (2, 3, 4)} | {("joint_zero_offset", (6,))}


@pytest.mark.parametrize(("seed", "lossless"), [(1, False), (3, True)])
def test_what_rest_poses_cannot_show(seed, lossless):
    found = confusable_pairs(seed, 60)
    # a vertical axis carries no gravity; a mass on a link is a heavier link; a turned flange is a turned load
    assert set(found.unseen) == VERTICAL | LUMPED
    # a cable wound up from an unknown angle holds a constant; losses of a gear by direction distinguish the two
    constant = {(("cable_torque", (joint,)), ("torque_offset", (joint,))) for joint in (4, 5, 6)}
    assert set(found.same) == (constant if lossless else set())
    # the two zeros differ by the weight of the upper arm alone
    assert [pair[:2] for pair in found.near] == [(("joint_zero_offset", (2,)), ("joint_zero_offset", (3,)))]
