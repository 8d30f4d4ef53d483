"""Every constant of the torque arithmetic is listed with its source."""

from pathlib import Path

import pytest

from drives.profile_file import list_profiles, load_profile
from gateway.cell.config import load_cell
from gateway.pipeline.finalize import provenance

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.parametrize("name", list_profiles())
def test_every_profile_of_the_package_is_covered(name):
    arm = load_cell(EXAMPLES / "large" / "cell.toml").cell.arm[0]
    tree = provenance(arm, [load_profile(name)] * 6)
    assert list(tree) == [f"J{joint}" for joint in range(1, 7)]
    for entry in tree["J2"].values():
        assert entry["source"]
    assert tree["J2"]["gear_ratio"]["value"] == arm.axis[1].gear_ratio.value
    assert tree["J2"]["gear_ratio"]["source"] == arm.axis[1].gear_ratio.source


def test_a_torque_constant_that_is_not_used_says_so():
    arm = load_cell(EXAMPLES / "small" / "cell.toml").cell.arm[0]
    tree = provenance(arm, [load_profile("generic-cia402")] * 6)
    assert "not used" in tree["J1"]["torque_constant"]["source"]
    tree = provenance(arm, [load_profile("kollmorgen-akd-x00606")] * 6)
    assert "not used" not in tree["J1"]["torque_constant"]["source"]
